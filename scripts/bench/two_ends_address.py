"""The part of `two_ends.py` that changes the address of each end."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from pyroute2 import IPRoute

from scripts.bench.two_ends_nodes import STREAMS
from scripts.netns.namespaces import inside

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from scripts.bench.child import Child
    from scripts.netns.simlink import Host
    from scripts.robot.run import Side

_PREFIX = 24  # SimLink's own network has room for two addresses only
_WATCHED_S = 40.0  # after each change
_SILENT_S = 1.0  # a topic without a sample for so long does not flow
_RESTART_S = 1.0  # RestartSec= of the units
_POLL_S = 0.1
_CALM_S = 5.0


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


def change_addresses(
    side: Side, nodes: dict[str, Child], start: Callable[[str], None], processes: Sequence[str]
) -> list[dict[str, Any]]:
    """Change the address of each end twice; return of each change when every topic flowed again.

    Parameters
    ----------
    start : starts one of arpd's processes
    processes : their names
    """
    robot, ceddp = side.link.hosts
    now = {host.name: host.address for host in (robot, ceddp)}
    found = []
    for number, host in enumerate((robot, ceddp, robot, ceddp)):
        address = f"10.77.0.{10 + number}"
        time.sleep(_CALM_S)
        began_s = time.monotonic()
        inside(host.namespace, partial(_replace, host, now[host.name], address))
        now[host.name] = address
        found.append({"host": host.name, **_watched(side, nodes, start, processes, began_s)})
    return found


def _watched(
    side: Side, nodes: dict[str, Child], start: Callable[[str], None], processes: Sequence[str], began_s: float
) -> dict[str, Any]:
    """Restart what ends itself, and return when that was and when the last topic began to flow again."""
    flow = Flow(at_s={stream.name: began_s for stream in STREAMS})
    ended: dict[str, float] = {}  # when a process ended itself
    due_s: dict[str, float] = {}
    silent: list[str] = []
    again_s = 0.0
    while (now_s := time.monotonic()) - began_s < _WATCHED_S:
        for name in processes:
            if name not in due_s and side.processes[name].poll() is not None:
                ended[name], due_s[name] = now_s - began_s, now_s + _RESTART_S
        for name in [name for name, at_s in due_s.items() if at_s <= now_s]:
            del due_s[name]
            start(name)
        for child in nodes.values():
            flow.note(child.ask(do="newest")["newest"], time.monotonic())
        if silent := flow.silent(time.monotonic()):
            again_s = time.monotonic() - began_s
        time.sleep(_POLL_S)
    return {"again_s": None if silent else again_s, "silent": silent, "ended_s": ended}


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
