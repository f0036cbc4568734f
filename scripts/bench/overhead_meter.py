"""The cost of processes: CPU and memory from /proc, and bytes on the link from the kernel's count of every flow."""

from __future__ import annotations

import json
import re
import subprocess
import time
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from arpd.model.wire import ETHERNET_BYTES
from scripts.bench.relay import cpu_by_thread
from scripts.netns.namespaces import executable, inside

if TYPE_CHECKING:
    from collections.abc import Mapping

    from scripts.netns.namespaces import HostName
    from scripts.netns.simlink import SimLink

CONTROL = ("run", "peer")
DISCOVERY, PROBES, REPORTS, ORDERS, ANSWERS = KINDS = ("discovery", "probes", "reports", "orders", "answers")
_PORT_BASE, _DOMAIN_GAIN, _MULTICAST_OFFSET, _UNICAST_OFFSET = 7400, 250, 0, 10  # OMG DDSI-RTPS 2.3, 9.6.1
_TABLE, _LINK, _LOCAL = "arpd_overhead", "flows", "local"
_SOCKET = re.compile(r"socket:\[(\d+)\]")


@dataclass(frozen=True, kw_only=True, slots=True)
class Reading:
    """The cost so far.

    Parameters
    ----------
    at_s : monotonic clock (s)
    cpu_s : CPU time by process (s)
    interface_bytes : bytes that both ends of the link have sent
    control_bytes : those of arpd's control plane, both ways, by kind
    discovery_bytes : those of DDS discovery, of all processes, both ways
    listener_bytes : discovery that one process of the robot has received from others of the robot
    """

    at_s: float
    cpu_s: Mapping[str, float]
    interface_bytes: int
    control_bytes: Mapping[str, int]
    discovery_bytes: int
    listener_bytes: int


class Meter:
    """Measures the cost of a robot's processes.

    Fast DDS gives every process ports of its own, so the ports of a datagram name its sender and its receiver. All that
    `arpd run` or `arpd peer` sends or receives is control plane, discovery included.

    Parameters
    ----------
    link : its flows are counted from now on
    listener : process on the robot whose received discovery counts
    """

    def __init__(self, link: SimLink, listener: str) -> None:
        self._link = link
        self._listener = listener
        for host in link.hosts:
            inside(host.namespace, partial(_count_flows, host.interface))

    def read(self, processes: Mapping[str, tuple[HostName, int]]) -> Reading:
        """Return the cost so far.

        Parameters
        ----------
        processes : host and process id by name
        """
        control = Counter(dict.fromkeys(KINDS, 0))
        cpu_s = {name: sum(cpu_by_thread(pid).values()) for name, (_, pid) in processes.items()}
        at_s = time.monotonic()
        owners = {
            host.name: {
                port: name for name, (at, pid) in processes.items() if at == host.name for port in udp_ports(pid)
            }
            for host in self._link.hosts
        }
        domain_id, discovery_bytes, listener_bytes = self._link.domain_id, 0, 0
        for here, there in (self._link.hosts, self._link.hosts[::-1]):
            for (source, target), sent in inside(here.namespace, partial(_flows, _LINK)).items():
                sender, receiver = owners[here.name].get(source, ""), owners[there.name].get(target, "")
                if kind := kind_of(sender, receiver, target, domain_id=domain_id):
                    control[kind] += sent
                discovery_bytes += sent * is_discovery(target, domain_id=domain_id)
        for (_, target), sent in inside(self._link.robot.namespace, partial(_flows, _LOCAL)).items():
            if owners["robot"].get(target) == self._listener and is_discovery(target, domain_id=domain_id):
                listener_bytes += sent
        return Reading(
            at_s=at_s,
            cpu_s=cpu_s,
            interface_bytes=sum(counters.tx_bytes for counters in self._link.counters().values()),
            control_bytes=control,
            discovery_bytes=discovery_bytes,
            listener_bytes=listener_bytes,
        )


def kind_of(sender: str, receiver: str, port: int, *, domain_id: int) -> str:
    """Return the kind of a control-plane datagram; empty for any other.

    Parameters
    ----------
    sender, receiver : processes at its two ends; the receiver of a multicast means nothing
    port : its destination
    """
    is_multicast = _offset(port, domain_id) == _MULTICAST_OFFSET
    if sender not in CONTROL and (is_multicast or receiver not in CONTROL):
        return ""
    if is_discovery(port, domain_id=domain_id):
        return DISCOVERY
    if sender == "run":
        return PROBES if receiver == "peer" else ORDERS
    return REPORTS if sender == "peer" else ANSWERS


def is_discovery(port: int, *, domain_id: int) -> bool:
    """Return whether DDS receives discovery at this port."""
    offset = _offset(port, domain_id)
    # From 7000 on, below all ports of the standard, rmw_fastrtps receives ROS's graph: ros_discovery_info.
    return offset == _MULTICAST_OFFSET or port < _PORT_BASE or (offset >= _UNICAST_OFFSET and offset % 2 == 0)


def _offset(port: int, domain_id: int) -> int:
    return port - _PORT_BASE - _DOMAIN_GAIN * domain_id


def udp_ports(pid: int) -> set[int]:
    """Return the UDP ports a process has bound."""
    inodes = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        try:
            found = _SOCKET.fullmatch(str(descriptor.readlink()))
        except OSError:
            continue  # the file was closed
        if found:
            inodes.add(found[1])
    lines = Path(f"/proc/{pid}/net/udp").read_text(encoding="utf-8").splitlines()[1:]
    return {int(field[1].rpartition(":")[2], 16) for field in map(str.split, lines) if field[9] in inodes}


def has_cvxpy(pid: int) -> bool:
    """Return whether a process has loaded cvxpy: an import maps its compiled core."""
    return "/cvxpy/" in Path(f"/proc/{pid}/maps").read_text(encoding="utf-8")


def _count_flows(interface: str) -> None:
    # At the output hook datagrams are still whole; fragments have no ports.
    _nft(
        f"""
        table inet {_TABLE} {{
            set {_LINK} {{ type inet_service . inet_service; flags dynamic; size 65535; counter; }}
            set {_LOCAL} {{ type inet_service . inet_service; flags dynamic; size 65535; counter; }}
            chain out {{
                type filter hook output priority 0;
                oifname "{interface}" update @{_LINK} {{ udp sport . udp dport }};
                oifname "lo" update @{_LOCAL} {{ udp sport . udp dport }};
            }}
        }}"""
    )


def _flows(name: str) -> dict[tuple[int, int], int]:
    """Return the bytes of a set of flows by source and destination port, with Ethernet headers."""
    listed: list[dict[str, Any]] = json.loads(_nft("", "-j", "list", "set", "inet", _TABLE, name))["nftables"]
    (found,) = (item["set"] for item in listed if "set" in item)
    flows = {}
    for item in found.get("elem", []):
        counter, (source, target) = item["elem"]["counter"], item["elem"]["val"]["concat"]
        flows[source, target] = counter["bytes"] + ETHERNET_BYTES * counter["packets"]
    return flows


def _nft(script: str, *argv: str) -> str:
    command = [executable("nft"), *(argv or ("-f", "-"))]
    return subprocess.run(command, input=script, capture_output=True, text=True, check=True).stdout
