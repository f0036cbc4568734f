"""Links whose bottleneck is the sender's interface or lies between the hosts, and their courses."""

from __future__ import annotations

import socket
import subprocess
from bisect import bisect_right
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from pyroute2 import IPRoute, netns

from arpd.model.wire import MTU_BYTES
from scripts.netns import link_end
from scripts.netns.link_end import Bucket
from scripts.netns.namespaces import executable, inside
from scripts.netns.simlink import MIN_BURST_BYTES, SimLink

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from scripts.netns.namespaces import HostName
    from scripts.netns.simlink import Host

MBIT = 125_000.0  # bytes/s
STALLED = 0.0  # bytes/s
_OUT_S = 3.0
_FAST = Bucket(rate_bytes_per_second=1000 * MBIT, burst_bytes=14_000, queue_bytes=1_000_000)  # a host's cable
_FIRST_INDEX = 77  # `SimLink._build` says why
_DISCARD_PORT = 9
#: Both directions from each time on: begin (s), rate (bytes/s), loss (0..1); the first begins at 0.
Course = list[tuple[float, float, float]]


def at(course: Course, now_s: float) -> tuple[float, float]:
    """Return rate (bytes/s) and loss (0..1) of a time (s)."""
    return course[max(0, bisect_right(course, now_s, key=lambda step: step[0]) - 1)][1:]


def courses(whole_s: float, stall_s: float) -> dict[str, Course]:
    """Return the course of every link by its name, over so many seconds."""
    fast, slow = 20 * MBIT, 5 * MBIT

    def middle(for_s: float, rate: float, loss: float) -> Course:
        begin_s = (whole_s - for_s) / 2
        return [(0.0, fast, 0.0), (begin_s, rate, loss), (begin_s + for_s, fast, 0.0)]

    return {
        "steady20": [(0.0, fast, 0.0)],
        "steady5": [(0.0, slow, 0.0)],
        "drop": middle(whole_s / 3, slow, 0.0),
        "out": middle(_OUT_S, fast, 1.0),
        "stalled": middle(stall_s, STALLED, 0.0),
        "loss2": [(0.0, fast, 0.02)],
        "loss5": [(0.0, fast, 0.05)],
    }


class SenderLink(SimLink):
    """A link whose bucket is on the sender's interface, so that a full queue pushes back on its sockets.

    Parameters
    ----------
    memory : folder in memory; each host has its own shared memory there
    is_memory_private : each process has its own; two of them with TCP could else use one port of the other host
    """

    def __init__(self, run_id: str, *, memory: Path, is_memory_private: bool, **options: Any) -> None:
        super().__init__(run_id, **options)
        self._memory, self._is_memory_private = memory, is_memory_private

    def popen(self, host: Host | HostName, argv: Sequence[str], **options: Any) -> subprocess.Popen[Any]:
        """Start a command as `SimLink.popen` does; `ip netns exec` has given it mounts of its own."""
        shared = self._memory / (host if isinstance(host, str) else host.name)
        shared.mkdir(exist_ok=True)
        mount = "mount -t tmpfs tmpfs" if self._is_memory_private else 'mount --bind "$0"'
        return super().popen(host, ["sh", "-c", f'{mount} /dev/shm && exec "$@"', str(shared), *argv], **options)

    def set_rate(self, rate_bytes_per_second: float) -> None:
        """Change the rate of both directions; queued packets stay, at STALLED all of them."""
        self._rate_bytes_per_second = rate_bytes_per_second
        for end in self._shaped():
            if rate_bytes_per_second == STALLED:
                _stall(end, self._queue_bytes)
            else:
                inside(end.namespace, partial(link_end.reshape, end, self._bucket()))
        for host in self.hosts:
            inside(host.namespace, partial(_knock, host))

    def _shaped(self) -> list[Host]:
        """Return the interfaces that have the buckets."""
        return list(self.hosts)


class MiddleLink(SenderLink):
    """A link whose buckets are in a namespace between the hosts, where no socket of theirs is pushed back."""

    @property
    def _middle(self) -> str:
        return f"arpd-{self.run_id}-middle"

    def _shaped(self) -> list[Host]:
        """Return the middle's ends of the cables, named after the hosts."""
        return [replace(host, namespace=self._middle, interface=host.name) for host in self.hosts]

    def _build(self) -> None:
        for stale in set(netns.listnetns()):  # of links that were killed
            is_middle = stale.startswith("arpd-") and stale.endswith("-middle")
            if is_middle and stale.removesuffix("middle") + "robot" not in netns.listnetns():
                netns.remove(stale)
        netns.create(self._middle)
        for namespace in (self._middle, *(host.namespace for host in self.hosts)):
            inside(namespace, link_end.disable_ipv6)
        with IPRoute() as outside:
            for k, host in enumerate(self.hosts):
                own = {"ifname": host.interface, "net_ns_fd": host.namespace, "address": host.mac, "mtu": MTU_BYTES}
                port = {"ifname": host.name, "net_ns_fd": self._middle, "mtu": MTU_BYTES}
                outside.link("add", kind="veth", index=_FIRST_INDEX + k, peer=port, **own)
        for host in self.hosts:
            inside(host.namespace, partial(link_end.raise_up, host, _FAST))
        inside(self._middle, self._join)
        self.set_loss(self._loss)
        self._await_carrier()

    def _join(self) -> None:
        """Bridge the two cables, with a bucket towards each host."""
        with IPRoute() as route:
            route.link("add", ifname="bridge", kind="bridge", br_mcast_snooping=0)
            bridge = route.link_lookup(ifname="bridge")[0]
            route.link("set", index=bridge, state="up")
            for port in self._shaped():
                link_end.disable_offloads(port.interface)
                index = route.link_lookup(ifname=port.interface)[0]
                link_end.shape(route, "add", index, self._bucket())
                route.link("set", index=index, master=bridge, state="up")

    def _tear_down(self) -> None:
        super()._tear_down()
        with suppress(OSError):
            netns.remove(self._middle)


def link_of(bottleneck: str, run_id: str, **options: Any) -> SenderLink:
    """Return a link with this bottleneck, ``sender`` or ``middle``."""
    return (MiddleLink if bottleneck == "middle" else SenderLink)(run_id, **options)


def _stall(end: Host, queue_bytes: int) -> None:
    """Let a bucket pass a frame every half hour; pyroute2 cannot say so, and the kernel would drop what comes."""
    bucket = ("rate", "8bit", "burst", str(MIN_BURST_BYTES), "limit", str(queue_bytes))
    change = ("qdisc", "change", "dev", end.interface, "root", "handle", "1:", "tbf", *bucket)
    subprocess.run([executable("tc"), "-n", end.namespace, *change], check=True)


def _knock(host: Host) -> None:
    """Send a packet: the kernel looks at a queue that stands when one comes."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as knocking, suppress(OSError):
        knocking.setblocking(False)  # noqa: FBT003 - its own signature
        knocking.sendto(b"", (host.peer_address, _DISCARD_PORT))
