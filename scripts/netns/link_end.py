"""Configures and reads one end of a simulated link, from inside its network namespace."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from ipaddress import ip_interface
from pathlib import Path

from pyroute2 import IPRoute
from pyroute2.ethtool.ioctl import IoctlEthtool, NotSupportedError

from arpd.model.errors import LinkError
from arpd.model.interface import InterfaceState, LinkCounters
from scripts.netns.namespaces import HostName, executable

_ROOT_HANDLE = 0x10000  # "1:"
_PREFIX = 30  # bits of the network of two hosts
_LOSS_STEPS = 1_000_000
_OFFLOADS = ("tcp-segmentation-offload", "generic-segmentation-offload", "generic-receive-offload")


@dataclass(frozen=True, kw_only=True, slots=True)
class Host:
    """One end of the link.

    Parameters
    ----------
    name : ``robot`` or ``base``
    namespace : name of its network namespace
    interface : name of its end of the veth pair
    address, peer_address : IPv4 addresses of this end and of the other
    mac, peer_mac : Ethernet addresses of this end and of the other
    """

    name: HostName
    namespace: str
    interface: str
    address: str
    peer_address: str
    mac: str
    peer_mac: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Bucket:
    """A token bucket and the queue in front of it.

    Parameters
    ----------
    rate_bytes_per_second : rate, Ethernet headers included (bytes/s)
    burst_bytes : size of the bucket (bytes)
    queue_bytes : queue with tail drop (bytes)
    """

    rate_bytes_per_second: float
    burst_bytes: int
    queue_bytes: int


def raise_up(host: Host, bucket: Bucket, congestion: str) -> None:
    """Shape the end, give it its address and switch it on; TCP has this congestion control on it."""
    disable_offloads(host.interface)
    with IPRoute() as route:
        index = route.link_lookup(ifname=host.interface)[0]
        shape(route, "add", index, bucket)
        route.link("set", index=route.link_lookup(ifname="lo")[0], state="up")
        route.addr("add", index=index, address=host.address, prefixlen=_PREFIX)
        route.link("set", index=index, state="up")
        network = str(ip_interface(f"{host.address}/{_PREFIX}").network)
        about = {"scope": "link", "proto": "kernel", "prefsrc": host.address}
        route.route("replace", dst=network, oif=index, metrics={"cc_algo": congestion}, **about)
        # A fixed neighbour keeps ARP off the link, because random loss would hit it, too.
        route.neigh("add", dst=host.peer_address, lladdr=host.peer_mac, ifindex=index, state="permanent")
        route.route("add", dst="224.0.0.0/4", oif=index, scope="link")


def reshape(host: Host, bucket: Bucket) -> None:
    """Change the token bucket; queued packets stay."""
    with IPRoute() as route:
        shape(route, "change", route.link_lookup(ifname=host.interface)[0], bucket)


def set_loss(host: Host, loss: float) -> None:
    """Drop arriving packets with a probability, by a rule set in one nftables transaction."""
    lost_steps = round(loss * _LOSS_STEPS)
    share = f"numgen random mod {_LOSS_STEPS} < {lost_steps}" if lost_steps < _LOSS_STEPS else ""
    script = (
        "add table netdev arpd\n"
        f'add chain netdev arpd loss {{ type filter hook ingress device "{host.interface}" priority 0; }}\n'
        "flush chain netdev arpd loss\n"
        f"add rule netdev arpd loss {share} counter drop\n"
    )
    done = subprocess.run([executable("nft"), "-f", "-"], input=script, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise LinkError(f"{host.namespace}: nftables refuses the rule of random loss: {done.stderr.strip()}")


def read_counters(host: Host) -> LinkCounters:
    """Return the interface counters; ``tx_dropped`` includes the drops of the full queue."""
    with IPRoute() as route:
        link = route.get_links(ifname=host.interface)[0]
        (bucket,) = (q for q in route.get_qdiscs(link["index"]) if q.get("TCA_KIND") == "tbf")
    stats = link.get("IFLA_STATS64")
    queue = bucket.get("TCA_STATS2").get("TCA_STATS_QUEUE")
    return LinkCounters(
        interface=host.interface,
        rx_bytes=stats["rx_bytes"],
        tx_bytes=stats["tx_bytes"],
        rx_packets=stats["rx_packets"],
        tx_packets=stats["tx_packets"],
        tx_dropped=stats["tx_dropped"] + queue["drops"],
        state=InterfaceState.UP if link.get("IFLA_OPERSTATE") == "UP" else InterfaceState.DOWN,
    )


def bridge(ports: list[Host], bucket: Bucket) -> None:
    """Join the cables of both hosts, with a bucket towards each of them."""
    with IPRoute() as route:
        route.link("add", ifname="bridge", kind="bridge", br_mcast_snooping=0)
        joined = route.link_lookup(ifname="bridge")[0]
        route.link("set", index=joined, state="up")
        for port in ports:
            disable_offloads(port.interface)
            index = route.link_lookup(ifname=port.interface)[0]
            shape(route, "add", index, bucket)
            route.link("set", index=index, master=joined, state="up")


def disable_ipv6() -> None:
    """Keep router solicitations and duplicate address detection off the link."""
    for scope in ("all", "default"):
        switch = Path(f"/proc/sys/net/ipv6/conf/{scope}/disable_ipv6")
        if switch.exists():
            switch.write_text("1", encoding="ascii")


def disable_offloads(interface: str) -> None:
    """Switch offloads off, so that the bucket gets packets as on the air instead of bundles of 64 kB."""
    ethtool = IoctlEthtool(interface)
    try:
        for name in _OFFLOADS:
            ethtool.set_offload_flag(name, 0)
    except NotSupportedError as error:
        raise LinkError(f"{interface}: cannot switch offloads off: {error}") from error
    finally:
        ethtool.close()


def shape(route: IPRoute, command: str, index: int, bucket: Bucket) -> None:
    route.tc(
        command,
        "tbf",
        index,
        handle=_ROOT_HANDLE,
        rate=int(bucket.rate_bytes_per_second),
        burst=bucket.burst_bytes,
        limit=bucket.queue_bytes,
    )
