"""The part of `two_ends.py` that changes the address of each end."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from pyroute2 import IPRoute

from scripts.bench.two_ends_nodes import STREAMS
from scripts.netns.namespaces import inside
from scripts.netns.simlink import SimLink

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from scripts.bench.child import Child
    from scripts.netns.namespaces import HostName
    from scripts.netns.simlink import Host
    from scripts.robot.run import Side

_NEW_ADDRESS = "10.77.0.10"
_PREFIX = 24  # SimLink's own network has room for two addresses only
_WATCHED_S = 30.0  # after each change
_SILENT_S = 1.0  # a topic without a sample for so long does not flow
_RESTART_S = 1.0  # RestartSec= of the units
_POLL_S = 0.1
_CALM_S = 5.0


class SharingHosts(SimLink):
    """A link whose hosts have a shared memory each, and use it as Fast DDS does by default.

    Parameters
    ----------
    folder : has a folder for each host, on a file system in memory
    """

    def __init__(self, run_id: str, folder: Path, *, rate_bytes_per_second: float) -> None:
        super().__init__(run_id, rate_bytes_per_second=rate_bytes_per_second)
        self._folder = folder

    def popen(self, host: Host | HostName, argv: Sequence[str], **options: Any) -> subprocess.Popen[Any]:
        """Start a command as `SimLink.popen` does; `ip netns exec` has given it mounts of its own."""
        shared = self._folder / (host if isinstance(host, str) else host.name)
        shared.mkdir(exist_ok=True)
        mounted = ["sh", "-c", 'mount --bind "$0" /dev/shm && exec "$@"', str(shared)]
        return super().popen(host, [*mounted, "env", "FASTDDS_BUILTIN_TRANSPORTS=DEFAULT", *argv], **options)


@dataclass(slots=True)
class Flow:
    """The newest number of each stream, and when it came (monotonic s)."""

    newest: dict[str, int] = field(default_factory=dict)
    at_s: dict[str, float] = field(default_factory=dict)

    def note(self, newest: dict[str, int], now_s: float) -> None:
        for name, number in newest.items():
            if number != self.newest.get(name):
                self.newest[name], self.at_s[name] = number, now_s

    def silent(self, now_s: float) -> list[str]:
        """Name the streams that do not flow."""
        return [stream.name for stream in STREAMS if now_s - self.at_s.get(stream.name, 0.0) > _SILENT_S]


def widen(hosts: Sequence[Host]) -> None:
    """Give both hosts a network with room for more addresses."""
    for host in hosts:
        inside(host.namespace, partial(_replace, host, host.address, host.address))


class Addresses:
    """Changes the address of a host, restarts what ends itself, and notes when the topics flow again.

    Parameters
    ----------
    side : arpd's processes
    nodes : the plain nodes of each host
    start : starts one of arpd's processes
    start_nodes : starts the plain nodes of a host again, and lets them publish
    processes : names of arpd's processes
    """

    def __init__(
        self,
        side: Side,
        nodes: dict[str, Child],
        *,
        start: Callable[[str], None],
        start_nodes: Callable[[str], None],
        processes: Sequence[str],
    ) -> None:
        self._side = side
        self._nodes = nodes
        self._start = start
        self._start_nodes = start_nodes
        self._processes = processes

    def change(self, host: Host) -> dict[str, Any]:
        """Change the address of a host; if topics stay silent, start its plain nodes again."""
        time.sleep(_CALM_S)
        began_s = time.monotonic()
        inside(host.namespace, partial(_replace, host, host.address, _NEW_ADDRESS))
        found = {"host": host.name, **self._watched(began_s), "is_visible": sees_nodes(self._side, host)}
        if found["silent"]:
            began_s = time.monotonic()
            self._start_nodes(host.name)
            found["after_nodes"] = self._watched(began_s)
        return found

    def _watched(self, began_s: float) -> dict[str, Any]:
        """Return when each process ended itself, and when the last topic began to flow again (s after the change)."""
        flow = Flow(at_s={stream.name: began_s for stream in STREAMS})
        ended: dict[str, float] = {}
        due_s: dict[str, float] = {}
        silent: list[str] = []
        again_s = 0.0
        while (now_s := time.monotonic()) - began_s < _WATCHED_S:
            for name in self._processes:
                if name not in due_s and self._side.processes[name].poll() is not None:
                    ended[name], due_s[name] = now_s - began_s, now_s + _RESTART_S
            for name in [name for name, at_s in due_s.items() if at_s <= now_s]:
                del due_s[name]
                self._start(name)
            for child in self._nodes.values():
                flow.note(child.ask(do="newest")["newest"], time.monotonic())
            if silent := flow.silent(time.monotonic()):
                again_s = time.monotonic() - began_s
            time.sleep(_POLL_S)
        return {"again_s": None if silent else again_s, "silent": silent, "ended_s": ended}


_LOOK = """
import time, rclpy
rclpy.init()
node = rclpy.create_node("looker")
time.sleep(5.0)
print(int("{name}" in node.get_node_names()))
"""


def sees_nodes(side: Side, host: Host) -> bool:
    """Return whether a new plain process, without arpd, finds the plain nodes of its host."""
    process = side.link.popen(
        host,
        [
            "env",
            "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST",
            sys.executable,
            "-c",
            _LOOK.format(name=f"nodes_{host.name}"),
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    printed, _ = process.communicate(timeout=60.0)
    return int(printed) > 0


def _replace(host: Host, old: str, new: str) -> None:
    """Replace the host's address, and restore what the kernel removes with it."""
    with IPRoute() as route:
        index = route.link_lookup(ifname=host.interface)[0]
        for each in route.get_addr(index=index):
            if each.get_attr("IFA_ADDRESS") == old:
                route.addr("del", index=index, address=old, prefixlen=each["prefixlen"])
        route.addr("add", index=index, address=new, prefixlen=_PREFIX)
        # Its removal went with the last address. ARP finds the new addresses.
        route.route("replace", dst="224.0.0.0/4", oif=index, scope="link")
