"""Measure what a link carries at rest: plain ROS 2 beside arpd's relay with two ends, by number of the robot's nodes.

Usage: .venv/bin/python scripts/bench/discovery.py [--quick] [--side SIDE] [--nodes N …] [--json FILE]

Needs root, as the simulated link does.

Each node of the robot has a participant of DDS of its own, as a process with one node has it, and rclpy's defaults:
two publishers, /rosout, parameter services. Twenty-five of them share a Python process to save memory. Nobody
publishes, and the far host has one node without a topic of its own.

Plain ROS 2 has all of them in one domain, with multicast over the link. With the relay, both hosts keep that domain to
themselves (ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST), and `arpd run`, `arpd relay`, `arpd peer` and `arpd relay --far`
share a domain of their own on the link. They start first: in the range LOCALHOST, Fast DDS announces a participant to
the first 32 of its host only, so one that starts later does not find all of a larger number.

Once the far node knows every topic of the robot, a packet socket on the robot's interface counts every frame, with its
Ethernet header; the port it goes to says which kind it is, and its RTPS header which participant sent it. The result is
that of the first three periods of announcements in a row with as many packets of discovery each: the start of many
nodes keeps the link busy for longer. Fast DDS uses UDP alone here, for its shared memory ignores namespaces.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from arpd.model.errors import ArpdError
from scripts.bench.child import Child, ChildError
from scripts.bench.discovery_nodes import TOPICS_PER_NODE
from scripts.bench.discovery_packets import KINDS, Capture, is_steady
from scripts.bench.discovery_packets import document as counted
from scripts.bench.overhead_robot import STATUS_URL
from scripts.bench.record import REPO, conditions, keep, options_of
from scripts.bench.report import about, paragraphs, table
from scripts.netns.namespaces import inside
from scripts.netns.simlink import SimLink

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from arpd.cli.progress import Progress
    from scripts.bench.discovery_packets import Tally
    from scripts.netns.namespaces import HostName

PLAIN, RELAY = SIDES = ("plain ROS 2", "two-ended relay")
NODES = (10, 50, 100)
DOMAIN, LINK_DOMAIN = 0, 77
_NODES_MODULE = "scripts.bench.discovery_nodes"
_NODES_PER_PROCESS = 25
_RANGES = {PLAIN: "SUBNET", RELAY: "LOCALHOST"}
_START_S, _DISCOVER_S = 60.0, 240.0
_ANNOUNCEMENT_S = 9.0  # arpd's own participants with two ends announce themselves that often, others three times


@dataclass(frozen=True, kw_only=True, slots=True)
class Times:
    """Durations of a measurement.

    Parameters
    ----------
    periods : length of the measurement, in times between two announcements
    most_settle_s : longest wait for a steady link (s)
    """

    periods: int = 3
    most_settle_s: float = 180.0


QUICK = Times(periods=2, most_settle_s=60.0)


class DiscoveryError(ArpdError):
    """A part of the run did not work."""


@dataclass(slots=True)
class Hosts:
    """The processes on both hosts.

    Parameters
    ----------
    workdir : folder for the configuration and the logs
    """

    side: str
    link: SimLink
    workdir: Path
    stack: ExitStack
    arpd: dict[str, subprocess.Popen[Any]] = field(default_factory=dict)
    robot: list[Child] = field(default_factory=list)

    @property
    def _environment(self) -> Mapping[str, str]:
        # An empty name is no profile: the nodes are not arpd's, and have the defaults.
        return {"ROS_AUTOMATIC_DISCOVERY_RANGE": _RANGES[self.side], "FASTRTPS_DEFAULT_PROFILES_FILE": ""}

    def start_arpd(self) -> None:
        """Start arpd's four processes; wait until the daemon has a report of its peer.

        Raises
        ------
        DiscoveryError
            If a process ends, or no report arrives.
        """
        robot, ceddp = self.link.hosts
        config = self.workdir / "arpd.yaml"
        relay = {"link_domain": LINK_DOMAIN, "robot": robot.address, "ceddp": ceddp.address}
        config.write_text(json.dumps({"relay": relay}), encoding="utf-8")  # JSON is YAML
        self._start("robot", "run", "--config", str(config))
        self._start("robot", "relay", "--config", str(config))
        self._start("ceddp", "peer", "--config", str(config))
        self._start("ceddp", "relay", "--far", "--config", str(config))
        self._await(self._has_peer, "arpd run has no report of arpd peer", _START_S)

    def start_far(self) -> Child:
        """Start the node of the far host."""
        far = self._child("ceddp", "far")
        far.receive(_START_S)
        return far

    def start_robot(self, nodes: int) -> None:
        """Start the robot's nodes, all at once, as a robot does."""
        firsts = range(0, nodes, _NODES_PER_PROCESS)
        self.robot = [
            self._child("robot", "robot", str(first), str(min(_NODES_PER_PROCESS, nodes - first))) for first in firsts
        ]
        for child in self.robot:
            child.receive(_DISCOVER_S)

    def await_topics(self, far: Child, wanted: int) -> None:
        """Wait until the far node knows all of the robot's topics.

        Raises
        ------
        DiscoveryError
            If it does not, or a process ends.
        """
        known = 0

        def is_known() -> bool:
            nonlocal known
            known = int(far.ask(topics=wanted, timeout_s=1.0)["topics"])
            return known >= wanted

        self._await(is_known, lambda: f"the far node knows {known} of {wanted} topics", _DISCOVER_S)

    def sent_bytes(self) -> int:
        """Return the bytes that both ends of the link have sent since it was made."""
        return sum(counters.tx_bytes for counters in self.link.counters().values())

    def check(self) -> None:
        """Raise an error if a process has ended.

        Raises
        ------
        DiscoveryError
            It names the process, and what it said last.
        """
        for name, process in self.arpd.items():
            if process.poll() is not None:
                said = self._log(name).read_text(encoding="utf-8", errors="replace").strip().splitlines() or ["nothing"]
                raise DiscoveryError(f"{name} ended with code {process.returncode}; it said last: {said[-1][:200]}")
        for child in self.robot:
            if child.process.poll() is not None:
                raise DiscoveryError(f"{child.name} ended with code {child.process.returncode}")

    def rss_bytes(self) -> int:
        """Return the memory of the robot's nodes."""
        return sum(psutil.Process(child.process.pid).memory_info().rss for child in self.robot)

    def _child(self, host: HostName, *argv: str) -> Child:
        child = Child(self.link, host, _NODES_MODULE, *argv, environment=dict(self._environment))
        self.stack.callback(child.end)
        return child

    def _start(self, host: HostName, *argv: str) -> None:
        name = "arpd " + " ".join(argv[: 2 if argv[1] == "--far" else 1])
        local = f"ROS_AUTOMATIC_DISCOVERY_RANGE={_RANGES[self.side]}"  # `env`, because the link sets it, too
        with self._log(name).open("w") as log:
            self.arpd[name] = self.link.popen(
                host,
                ["env", local, sys.executable, "-m", "arpd.cli", *argv],
                env={**os.environ, "PYTHONPATH": str(REPO)},
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd=REPO,
            )

    def _log(self, name: str) -> Path:
        return self.workdir / f"{name.replace(' ', '-')}.log"

    def _has_peer(self) -> bool:
        def ask() -> bool:
            with urllib.request.urlopen(STATUS_URL, timeout=5.0) as answer:
                return bool(json.load(answer)["peers"])

        has_peer = False
        with suppress(OSError, json.JSONDecodeError):
            has_peer = inside(self.link.robot.namespace, ask)
        return has_peer

    def _await(self, condition: Callable[[], bool], complaint: str | Callable[[], str], timeout_s: float) -> None:
        until_s = time.monotonic() + timeout_s
        while not condition():
            self.check()
            if time.monotonic() > until_s:
                said = complaint if isinstance(complaint, str) else complaint()
                raise DiscoveryError(f"{said} after {timeout_s:.0f} s")
            time.sleep(0.2)


def measure(side: str, nodes: int, times: Times, workdir: Path, show: Callable[[str], None]) -> dict[str, Any]:
    """Return what the link carries at rest with so many nodes."""
    run_id = f"discovery-{os.getpid()}-{nodes}-{SIDES.index(side)}"
    with SimLink(run_id, domain_id=DOMAIN) as link, ExitStack() as stack:
        hosts = Hosts(side, link, workdir, stack)
        if side == RELAY:
            show("starting arpd")
            hosts.start_arpd()
        far = hosts.start_far()
        began_s, before_bytes = time.monotonic(), hosts.sent_bytes()
        show("starting the nodes")
        hosts.start_robot(nodes)
        started_s = time.monotonic() - began_s
        hosts.await_topics(far, TOPICS_PER_NODE * nodes)
        discovered_s = time.monotonic() - began_s
        show("until the link is at rest")
        periods, joined_bytes = _rest(hosts, times)
        return {
            "side": side,
            "nodes": nodes,
            "topics": TOPICS_PER_NODE * nodes,
            "link_bytes_per_second": link.rate_bytes_per_second,
            "node_processes": len(hosts.robot),
            "node_rss_bytes": hosts.rss_bytes(),
            "started_s": started_s,
            "discovered_s": discovered_s,
            "settled_s": time.monotonic() - began_s - sum(period.span_s for period in periods),
            "is_steady": is_steady(periods),
            "joined_bytes": joined_bytes - before_bytes,
            **counted(periods),
        }


def _rest(hosts: Hosts, times: Times) -> tuple[list[Tally], int]:
    """Return the first steady periods in a row, or the last ones before time is up, and the bytes sent before them."""
    periods: list[Tally] = []
    sent_bytes: list[int] = []
    with closing(Capture(hosts.link, (DOMAIN, LINK_DOMAIN))) as capture:
        until_s = time.monotonic() + times.most_settle_s
        while True:
            sent_bytes = [*sent_bytes[1 - times.periods :], hosts.sent_bytes()]
            periods = [*periods[1 - times.periods :], capture.period(_ANNOUNCEMENT_S)]
            hosts.check()
            if len(periods) == times.periods and (is_steady(periods) or time.monotonic() > until_s):
                return periods, sent_bytes[0]


def check(found: dict[str, Any]) -> None:
    """Refuse nonsense: a link that carried nothing, or a plain robot whose nodes do not announce themselves.

    Raises
    ------
    DiscoveryError
        If a figure cannot be true.
    """
    seen = sum(each["from"] == "robot" for each in found["participants"])
    where = f"{found['nodes']} nodes, {found['side']}"
    if not found["flows"]:
        raise DiscoveryError(f"{where}: nothing crossed the link")
    if found["side"] == PLAIN and seen != found["nodes"]:
        raise DiscoveryError(f"{where}: {seen} participants of the robot were on the link")


def report(document: dict[str, Any]) -> str:
    cells = sorted(document["cells"], key=lambda cell: (cell["nodes"], SIDES.index(cell["side"])))
    link = f"a link of {cells[0]['link_bytes_per_second'] * 8e-6:.0f} Mbit/s at rest for {cells[0]['span_s']:.0f} s"
    return paragraphs(
        about(document, f"Packets per second (kB/s with Ethernet headers), both directions together, on {link}"),
        table(
            cells,
            ("nodes", "nodes"),
            ("", lambda cell: cell["side"] + ("" if cell["is_steady"] else " (not steady)")),
            ("participants on the link", lambda cell: len(cell["participants"])),
            ("all", rates),
            *((kind, partial(rates, kind=kind)) for kind in KINDS),
            ("MB until at rest", lambda cell: cell["joined_bytes"] * 1e-6, "{:.2f}"),
            ("far node knows all topics after s", "discovered_s", "{:.1f}"),
        ),
    )


def rates(cell: dict[str, Any], kind: str | None = None) -> str:
    """Return packets and in brackets kilobytes per second, of one kind or of all."""
    flows = [flow for flow in cell["flows"] if kind in (None, flow["kind"])]
    packets, sizes = (sum(flow[what] for flow in flows) / cell["span_s"] for what in ("packets", "bytes"))
    return f"{packets:.1f} ({sizes * 1e-3:.2f})" if packets else "0"


def _telling(shown: Progress, number: int, cell: str) -> Callable[[str], None]:
    return lambda what: shown.reach(number, f"{cell}: {what}")


def main() -> None:
    parser = options_of(__doc__, "discovery", quick="ten nodes, for a shorter time: a minute")
    sides = {"plain": PLAIN, "relay": RELAY}
    parser.add_argument("--side", choices=sides, help="one of the two")
    parser.add_argument("--nodes", type=int, nargs="+", metavar="N", help=f"numbers of nodes (default {NODES})")
    options = parser.parse_args()
    chosen = [sides[options.side]] if options.side else list(SIDES)
    numbers: list[int] = options.nodes or list(NODES[:1] if options.quick else NODES)
    document: dict[str, Any] = {"conditions": conditions(), "cells": [], "failures": []}
    cells = [(nodes, side) for nodes in numbers for side in chosen]
    with progress("measuring", total=len(cells)) as shown:
        for number, (nodes, side) in enumerate(cells):
            cell = f"{nodes} nodes, {side}"
            workdir, began_s = Path(tempfile.mkdtemp(prefix="arpd-discovery-")), time.monotonic()
            try:
                times = QUICK if options.quick else Times()
                found = measure(side, nodes, times, workdir, _telling(shown, number, cell))
                check(found)
            except (ArpdError, ChildError) as error:
                print(f"discovery: {cell}: {error}; logs in {workdir}", file=sys.stderr, flush=True)
                document["failures"].append({"nodes": nodes, "side": side, "why": str(error)})
                continue
            shutil.rmtree(workdir)
            print(f"{cell} in {time.monotonic() - began_s:.0f} s", flush=True)
            document["cells"].append(found)
    if document["cells"]:
        print(report(document))
    keep(document, options, "discovery", is_partial=options.quick or bool(options.side or options.nodes))
    if document["failures"]:
        sys.exit(1)


if __name__ == "__main__":
    main()
