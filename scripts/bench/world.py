"""A robot on a link under one side: its processes, arpd's processes, and what both cost."""

from __future__ import annotations

import json
import os
import sys
import tempfile
import threading
import time
import urllib.request
from collections import Counter
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil

from arpd.ros.runtime import FASTDDS_PROFILE
from scripts.bench.account import Account
from scripts.bench.child import Child, ChildError, becomes_true
from scripts.bench.links import Course, at
from scripts.bench.nodes import BASE_SINK, CALLER, ROBOT_SINK
from scripts.bench.oracle import write_truth
from scripts.bench.report import REPO
from scripts.bench.samples import BASE
from scripts.bench.sides import PREFIX, Robot, Side
from scripts.netns.namespaces import HOST_NAMES, HostName, inside
from scripts.netns.simlink import Bottleneck, SimLink

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Callable, Iterator, Sequence

_STATUS_URL = "http://127.0.0.1:9464/api/v1/status"
_MATCH_S, DRAIN_S, _LEAD_S = 40.0, 4.0, 1.0
_TICK_S, _FOOTPRINT_S = 0.02, 0.5
TREE = "ARPD_BENCH_TREE"  # source tree of arpd's processes
_LINK_DOMAIN = 102  # SimLink takes lower ones


class World:
    """One robot on one link, under one side.

    Parameters
    ----------
    workdir : folder for configuration and logs
    slow : called with the name and process id of every process on the robot
    nodes : module that the processes of the robot's nodes run
    """

    def __init__(
        self,
        robot: Robot,
        side: Side,
        link: SimLink,
        workdir: Path,
        *,
        slow: Callable[[str, int], None] = lambda _name, _pid: None,
        nodes: str = "scripts.bench.nodes",
    ) -> None:
        self.robot, self.side, self.link = robot, side, link
        self.workdir, self._slow, self._nodes = workdir, slow, nodes
        self.children: dict[str, Child] = {}
        self.daemons: dict[str, subprocess.Popen[Any]] = {}
        self.ended: list[str] = []
        self._withheld: dict[tuple[str, str], list[tuple[float, int]]] = {}
        self._truth = workdir / "truth.json"

    def start(self, stack: ExitStack) -> list[str]:
        """Start everything and wait until writers and readers have found each other; return those that have not."""
        self._start_nodes(stack)
        daemons = ["peer", "run"] if self.side.is_governed else []
        daemons += {"one": ["relay"], "two": ["relay", "relay_far"]}.get(self.side.ends, [])
        if daemons:
            self.configure()
        for name in daemons:
            self.start_daemon(name)
        for child in self.children.values():
            child.receive()
        becomes_true(lambda: not any(self._unmatched()), _MATCH_S, poll_s=0.3)
        return list(self._unmatched())

    def begin(self, seconds: float) -> dict[str, float]:
        """Let the nodes publish; return when they begin, and from and until when samples count (monotonic s)."""
        begin_s = time.monotonic() + _LEAD_S
        from_s = begin_s + self.side.warm_up_s
        times = {"begin_s": begin_s, "from_s": from_s, "until_s": from_s + seconds}
        for child in self.children.values():
            child.ask(do="begin", **times)
        return times

    def report(self, times: dict[str, float], drain_s: float = DRAIN_S) -> Account:
        """Wait for what is under way, and return what became of every sample."""
        time.sleep(drain_s)
        found = {name: child.ask(do="report") for name, child in self.children.items()}
        return Account(
            self.robot, found, times["from_s"], times["until_s"], withheld=self._withheld_since(times["from_s"])
        )

    def play(
        self,
        course: Course,
        seconds: float,
        *,
        events: Sequence[tuple[float, Callable[[], None]]] = (),
        drain_s: float = DRAIN_S,
    ) -> tuple[Account, dict[str, Any]]:
        """Play the link's course, and return the account, and what it all cost."""
        rate, loss = course[0][1:]
        with ExitStack() as stack:
            write_truth(self._truth, course)
            unmatched = self.start(stack)
            self.link.set_loss(loss)
            times = self.begin(seconds)
            write_truth(self._truth, course, times["from_s"])
            spent = self.follow(course, times["from_s"], seconds, events=events)
            if spent["ended"] and not events:  # who lets processes end counts those that end by themselves
                raise ChildError(f"{' and '.join(spent['ended'])} ended by itself in the round")
            self.link.set_rate(rate)
            self.link.set_loss(0.0)
            account = self.report(times, drain_s)
        return account, {"unmatched": unmatched, **spent}

    def follow(
        self, course: Course, from_s: float, seconds: float, *, events: Sequence[tuple[float, Callable[[], None]]] = ()
    ) -> dict[str, Any]:
        """Let the link follow its course, and return what it carried and what the processes took."""
        time.sleep(max(0.0, from_s - time.monotonic()))
        waiting = sorted(events, key=lambda event: -event[0])
        self._note_withheld()
        cpu_before_s, carried_before = self._footprints("cpu_s"), self._carried()
        rss_bytes: Counter[str] = Counter()
        first_rss: dict[str, int] = {}
        now, next_s = at(course, 0.0), 0.0
        while (elapsed_s := time.monotonic() - from_s) < seconds:
            if (wanted := at(course, elapsed_s)) != now:
                now = wanted
                self.link.set_rate(now[0])
                self.link.set_loss(now[1])
            while waiting and waiting[-1][0] <= elapsed_s:
                waiting.pop()[1]()
            if elapsed_s >= next_s:
                next_s = elapsed_s + _FOOTPRINT_S
                self._note_withheld()
                rss_bytes |= Counter(found := self._footprints("rss_bytes"))  # the greater of each
                first_rss = {**found, **first_rss}
            time.sleep(_TICK_S)
        carried = self._carried()
        return {
            "to_base_mbit": (carried["base"] - carried_before["base"]) * 8e-6 / seconds,
            "to_robot_mbit": (carried["robot"] - carried_before["robot"]) * 8e-6 / seconds,
            "cpu_s": {name: cpu_s - cpu_before_s.get(name, 0.0) for name, cpu_s in self._footprints("cpu_s").items()},
            "first_rss_bytes": first_rss,
            "max_rss_bytes": rss_bytes,
            "ended": [*self.ended, *(name for name, process in self.daemons.items() if process.poll() is not None)],
        }

    def status(self) -> dict[str, Any] | None:
        """Return arpd's status document; None while it does not answer."""
        with suppress(OSError, ValueError):
            return inside(self.link.robot.namespace, _asked)
        return None

    def _note_withheld(self) -> None:
        """Note how many samples of each publisher pacing has withheld, and when it said so."""
        now_s, status = time.monotonic(), self.status() if self.side.is_governed else None
        for topic in status["topics"] if status else []:
            at_s = now_s - (status["age_s"] or 0.0) - (topic["age_s"] or 0.0) if status else now_s
            name = topic["topic"].removeprefix(self.side.way.prefix)
            self._withheld.setdefault((topic["node"], name), []).append((at_s, topic["confirmed"]["withheld"]))

    def _withheld_since(self, from_s: float) -> Counter[str]:
        """Return the samples of each topic that pacing has withheld since then."""
        self._note_withheld()
        found: Counter[str] = Counter()
        for (_, name), notes in self._withheld.items():
            times_s, counts = zip(*notes, strict=True)
            before = float(np.interp(from_s, times_s, counts)) if self.side.warm_up_s else 0.0
            found[name] += round(counts[-1] - before)
        return found

    def _start_nodes(self, stack: ExitStack) -> None:
        world = self.workdir / "world.json"
        service = self.robot.service
        about = {"topics": list(map(asdict, self.robot.topics)), "way": asdict(self.side.way)}
        world.write_text(json.dumps({**about, "service": asdict(service) if service else None}), "utf-8")
        names = dict.fromkeys(topic.node for topic in self.robot.topics if not topic.answers)
        hosts: dict[str, HostName] = {name: "base" if name == BASE else "robot" for name in names}
        hosts |= {ROBOT_SINK: "robot", BASE_SINK: "base"} if names else {}
        if service:
            hosts |= {service.node: "robot", CALLER: "base"}
        for name, host in hosts.items():
            self.children[name] = self.child(stack, host, str(world), name)
        if self.side.ends == "bare":
            self.daemons["relay"] = self.child(stack, "robot", "bare", str(world)).process
        for end in HOST_NAMES if self.side.ends == "zenoh" else ():
            argv = str(world), end, self.link.robot.address, self.side.name
            self.daemons[f"zenoh_{end}"] = self.child(stack, end, *argv, module="scripts.bench.zenoh_ends").process

    def child(self, stack: ExitStack, host: HostName, *argv: str, module: str = "") -> Child:
        """Start a process of a module, by default the nodes'."""
        environment = {
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(FASTDDS_PROFILE) if self.side.has_profile else "",
            **self.side.transports,
        }
        child = Child(self.link, host, module or self._nodes, *argv, environment=environment)
        stack.callback(child.end)
        if host == "robot":
            self._slow(argv[-1], child.process.pid)
        return child

    def configure(self) -> None:
        """Write what arpd needs to know; nothing of the robot's rates and sizes but of what nobody may thin."""
        kept: dict[str, float] = {}
        for topic in self.robot.topics:
            kept[topic.name] = kept.get(topic.name, 0.0) + topic.rate_hz * topic.publishers * topic.is_kept
        relay: dict[str, Any] = {}
        queued = [{"name": name, "overflow": "queue", "depth": 1000} for name, rate_hz in kept.items() if rate_hz]
        if self.side.ends == "two":
            relay = {
                "link_domain": _LINK_DOMAIN,
                "robot": self.link.robot.address,
                "base": self.link.base.address,
                "to_robot": [topic.name for topic in self.robot.topics if topic.node == BASE],
                **({"topics": queued} if queued else {}),
            }
            if self.robot.service:
                relay["services"] = [self.robot.service.name]
            if self.robot.groups:
                relay["groups"] = [{"topics": list(self.robot.groups)}]
        elif self.side.ends == "one":
            relay = {
                "prefix": PREFIX,
                "topics": [{"name": topic.name} for topic in self.robot.topics if topic.node != BASE],
            }
        document: dict[str, Any] = {**(self.robot.settings or {}), **({"relay": relay} if relay else {})}
        deep = {"weight": 10, "latency_budget": "none", "min_depth": 1000, "max_depth": 1000}
        own = [
            {"name": name, "min_rate_hz": 1.2 * rate_hz, "max_rate_hz": 2.0 * rate_hz, **deep}
            for name, rate_hz in kept.items()
            if rate_hz
        ]
        if own:
            document["topics"] = [*document.get("topics", []), *own]
        (self.workdir / "arpd.yaml").write_text(json.dumps(document), "utf-8")  # JSON is YAML

    def start_daemon(self, name: str) -> None:
        """Start one of arpd's processes."""
        host: HostName = "base" if name in {"peer", "relay_far"} else "robot"
        command = {
            "peer": ("arpd.cli", "peer", "--interface", self.link.base.interface, "--name", "base"),
            "run": ("arpd.cli", "run"),
            "relay": ("arpd.cli", "relay"),
            "relay_far": ("arpd.cli", "relay", "--far"),
        }[name]
        if self.side.is_told and name == "run":
            command = ("scripts.bench.oracle", "--truth", str(self._truth))
        # Without the safe path, `-m` would take the arpd of the working directory.
        environment = {"PYTHONPATH": os.environ.get(TREE, str(REPO)), "PYTHONSAFEPATH": "1", **self.side.transports}
        argv = [sys.executable, "-u", "-m", *command, "--config", str(self.workdir / "arpd.yaml")]
        with (self.workdir / f"{name}.log").open("a") as log:
            self.daemons[name] = self.link.popen(
                host,
                ["env", *(f"{key}={value}" for key, value in environment.items()), *argv],
                stdout=log,
                stderr=log,
                cwd=self.workdir,
            )
        if host == "robot":
            self._slow(name, self.daemons[name].pid)

    def _unmatched(self) -> Iterator[str]:
        for name, child in self.children.items():
            said = child.ask(do="matched")
            yield from said["unmatched"]
            if not said["is_read"]:
                yield name

    def _carried(self) -> dict[str, int]:
        return {name: counters.rx_bytes for name, counters in self.link.counters().items()}

    def _footprints(self, what: str) -> dict[str, Any]:
        """Return the CPU time (s) or the resident memory (bytes) of all processes."""
        found: dict[str, Any] = {}
        nodes = {name: child.process for name, child in self.children.items()}
        for name, process in {**nodes, **self.daemons}.items():
            with suppress(psutil.Error):
                one = psutil.Process(process.pid)
                found[name] = sum(one.cpu_times()[:2]) if what == "cpu_s" else one.memory_info().rss
        return found


def _asked() -> dict[str, Any]:
    with urllib.request.urlopen(_STATUS_URL, timeout=3.0) as answer:
        document: dict[str, Any] = json.load(answer)
        return document


@contextmanager
def world_of(
    robot: Robot,
    side: Side,
    *,
    bottleneck: Bottleneck = "sender",
    rate: float,
    queue_bytes: int = 256_000,
    logs: Path | None = None,
    **options: Any,
) -> Iterator[World]:
    """Yield a world on a link of its own."""
    with (
        tempfile.TemporaryDirectory(prefix="arpd-bench-", dir="/dev/shm") as memory,
        tempfile.TemporaryDirectory(prefix="arpd-bench-") as temporary,
    ):
        workdir = logs or Path(temporary)
        workdir.mkdir(parents=True, exist_ok=True)
        link = SimLink(
            f"bench-{os.getpid()}-{threading.get_native_id()}",
            bottleneck=bottleneck,
            memory=Path(memory),
            is_memory_private=side.name.startswith("large_data"),
            congestion=side.congestion,
            rate_bytes_per_second=rate,
            queue_bytes=queue_bytes,
        )
        with link:
            yield World(robot, side, link, workdir, **options)
