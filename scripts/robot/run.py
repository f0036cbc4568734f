"""One run of the demo robot over the simulated link, with or without arpd."""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import signal
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from arpd.model.errors import ArpdError
from arpd.ros.runtime import FASTDDS_PROFILE
from arpd.sim.demo import COMMAND_TOPIC
from arpd.sim.result import TopicResult
from scripts.robot.proxy import window
from scripts.robot.sensors import BASE_DRIVER, COMMAND_RATE_HZ, SENSORS, node_name

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from arpd.sim.schedule import RateSchedule
    from scripts.netns.namespaces import HostName
    from scripts.netns.simlink import SimLink
    from scripts.robot.manner import Manner

#: Processes that publish, by name.
SOURCES = ("planner", *map(node_name, (*SENSORS, BASE_DRIVER)))
REPO = Path(__file__).resolve().parents[2]
CONFIG = Path(__file__).with_name("arpd.yaml")
PREFIX = "/link"
HTTP_PORT = 9464
_START_S = 40.0
_DRAIN_S = 4.0  # more than a heartbeat of rclpy's default writer, so that late samples still count as delivered
_TICK_S = 0.5
_SHAPE_S = 0.02  # how late the link may follow its schedule


class DemoError(ArpdError):
    """A part of the demo did not start, or has ended."""


@dataclass(slots=True)
class Side:
    """The processes of one run.

    Parameters
    ----------
    workdir : folder for logs and results of the processes
    started_s : monotonic clock when the sources began to publish (s)
    final : arpd's status document when the sources had ended; None before that, and without arpd
    """

    link: SimLink
    workdir: Path
    manner: Manner
    started_s: float = math.inf
    processes: dict[str, subprocess.Popen[str]] = field(default_factory=dict)
    arrivals: dict[str, Any] = field(default_factory=dict)
    final: dict[str, Any] | None = None
    url: str = ""

    @property
    def config(self) -> Path:
        """The run's own copy of the configuration."""
        return self.workdir / "arpd.yaml"

    def start_daemon(self) -> None:
        """Start `arpd run` on the robot."""
        self.start("run", "robot", "arpd.cli", "run", "--config", str(self.config))

    def start_relay(self) -> None:
        """Start `arpd relay` on the robot."""
        self.start("relay", "robot", "arpd.cli", "relay", "--config", str(self.config))

    def start_far_relay(self) -> None:
        """Start `arpd relay --far` on the base computer."""
        self.start("relay_far", "base", "arpd.cli", "relay", "--far", "--config", str(self.config))

    def start_peer(self) -> None:
        """Start `arpd peer` on the base computer."""
        options = ("--interface", self.link.base.interface, "--name", "base", "--config", str(self.config))
        self.start("peer", "base", "arpd.cli", "peer", *options)

    @property
    def prefix(self) -> str:
        """Prefix of the names under which the sensors' topics cross the link."""
        return PREFIX if self.manner.is_managed and not self.manner.has_two_ends else ""

    def result(self, name: str) -> dict[str, Any]:
        """Return the result that a source or the planner wrote at its end."""
        document = json.loads((self.workdir / f"{name}.json").read_text())
        assert isinstance(document, dict)
        return document

    def start(self, name: str, host: HostName, *argv: str, env: dict[str, str] | None = None) -> None:
        """Start one process; its stderr goes to a log in the work folder."""
        # Two ends carry everything, so the nodes of both sides stay on their hosts, as on a real robot.
        confined = ["env", "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"] if self.manner.has_two_ends else []
        with (self.workdir / f"{name}.log").open("a") as log:
            self.processes[name] = self.link.popen(
                host,
                [*confined, sys.executable, "-u", "-m", *argv],
                env={**os.environ, "PYTHONPATH": str(REPO), **(env or {})},
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                cwd=REPO,
            )

    def await_ready(self, name: str) -> None:
        """Wait for the process's line ``ready``, then keep reading its output."""
        process = self.processes[name]
        assert process.stdout is not None
        came, _, _ = select.select([process.stdout], [], [], _START_S)
        if not came or process.stdout.readline().strip() != "ready":
            raise DemoError(f"{name} did not start; see {self.workdir / (name + '.log')}")
        threading.Thread(target=self._read, args=(process,), daemon=True).start()

    def signal(self, number: signal.Signals, *names: str) -> None:
        """Send a signal to processes by name."""
        for name in names:
            self.processes[name].send_signal(number)

    def stop(self, *names: str) -> None:
        """Ask processes to end, and wait."""
        self.signal(signal.SIGTERM, *names)
        for name in names:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.processes[name].wait(timeout=15)

    def status(self) -> dict[str, Any] | None:
        """Return arpd's status document, None while it does not answer."""
        if not self.url:
            return None
        with (
            contextlib.suppress(OSError, urllib.error.URLError, json.JSONDecodeError),
            urllib.request.urlopen(f"{self.url}/api/v1/status", timeout=3.0) as answer,
        ):
            document = json.load(answer)
            return document if isinstance(document, dict) else None
        return None

    def _read(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            with contextlib.suppress(json.JSONDecodeError):
                self.arrivals = json.loads(line)


@contextlib.contextmanager
def robot(link: SimLink, workdir: Path, manner: Manner) -> Iterator[Side]:
    """Start planner, sensors and, under a daemon, peer, daemon and relay; end them all on leaving.

    Raises
    ------
    DemoError
        If a process does not start.
    """
    side = Side(link, workdir, manner)
    workdir.mkdir(parents=True, exist_ok=True)
    is_adaptive = manner.is_managed and not manner.has_two_ends
    profile = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(FASTDDS_PROFILE)} if is_adaptive else {}
    prefix, kind = (PREFIX, "adaptive") if is_adaptive else ("-", "plain")
    with contextlib.ExitStack() as stack:
        stack.callback(_end, side)
        out = str(workdir / "planner.json")
        side.start("planner", "base", "scripts.robot.planner", prefix, kind, out, env=profile)
        if manner.is_managed:
            side.config.write_text(two_ended_config(link) if manner.has_two_ends else CONFIG.read_text())
            side.start_peer()
            side.start_daemon()
            side.start_relay()
            if manner.has_two_ends:
                side.start_far_relay()
            side.url = stack.enter_context(window(link.robot, HTTP_PORT))
        for topic in (*SENSORS, BASE_DRIVER):
            name = node_name(topic)
            side.start(name, "robot", "scripts.robot.sensors", topic, str(workdir / f"{name}.json"))
        for name in SOURCES:
            side.await_ready(name)
        _await_discovery(side)
        yield side


def two_ended_config(link: SimLink) -> str:
    """Return the demo robot's configuration with two ends instead of the prefix."""
    document = yaml.safe_load(CONFIG.read_text())
    for topic in document["topics"]:
        topic["name"] = topic["name"].removeprefix(PREFIX)
    document["relay"] = {
        "link_domain": 102,  # SimLink takes lower ones
        "robot": link.robot.address,
        "base": link.base.address,
        "to_robot": [COMMAND_TOPIC],
    }
    return str(yaml.safe_dump(document))


def run(
    side: Side,
    schedule: RateSchedule,
    duration_s: float,
    *,
    on_tick: Callable[[float], None],
) -> list[TopicResult]:
    """Run the robot for ``duration_s`` while the link follows the schedule, and return the arrivals.

    Parameters
    ----------
    on_tick : as in `play`

    Raises
    ------
    DemoError
        If arpd does not answer at the end, or the link was bypassed.
    """
    before = sum(counters.rx_bytes for counters in side.link.counters().values())
    play(side, schedule.rate_at, duration_s, on_tick=on_tick)
    side.signal(signal.SIGUSR2, *SOURCES)
    time.sleep(_DRAIN_S)
    side.final = side.status()
    if side.manner.is_managed and side.final is None:
        raise DemoError(f"arpd does not answer at {side.url}; see {side.workdir / 'run.log'}")
    side.stop(*SOURCES)
    crossed = sum(counters.rx_bytes for counters in side.link.counters().values()) - before
    results = _results(side, side.final, duration_s)
    delivered = sum(result.delivered_bytes for result in results)
    if crossed < delivered:
        raise DemoError(f"only {crossed} bytes crossed the link for {delivered} delivered: the link was bypassed")
    return results


def play(
    side: Side,
    rate_at: Callable[[float], float],
    duration_s: float,
    *,
    on_tick: Callable[[float], None],
    loss_at: Callable[[float], float] = lambda _elapsed_s: 0.0,
) -> None:
    """Let every source publish while the link follows ``rate_at`` and ``loss_at``; they go on publishing afterwards.

    Parameters
    ----------
    rate_at : rate of both directions, by the time since the start (bytes/s by s)
    on_tick : called twice a second with the time since the start (s)
    loss_at : probability that an arriving packet is lost, in both directions (by s)
    """
    side.signal(signal.SIGUSR1, *SOURCES)
    side.started_s = time.monotonic()
    next_tick_s = 0.0
    while (elapsed_s := time.monotonic() - side.started_s) < duration_s:
        rate, loss = rate_at(elapsed_s), loss_at(elapsed_s)
        if rate != side.link.rate_bytes_per_second:
            side.link.set_rate(rate)
        if loss != side.link.loss:
            side.link.set_loss(loss)
        if elapsed_s >= next_tick_s:
            next_tick_s = elapsed_s + _TICK_S
            on_tick(elapsed_s)
            _check_alive(side)
        time.sleep(_SHAPE_S)


def lost_during(outages: Sequence[tuple[float, float]]) -> Callable[[float], float]:
    """Return the loss of a link that loses every packet in the spans (s, s) and none outside."""
    return lambda elapsed_s: float(any(start_s <= elapsed_s < end_s for start_s, end_s in outages))


def _await_discovery(side: Side) -> None:
    """Wait until every writer has its reader, so that no sample is published without one."""
    if not side.manner.is_managed:
        time.sleep(4.0)
        return
    until_s = time.monotonic() + _START_S
    crossing = 0
    while time.monotonic() < until_s:
        _check_alive(side)
        status = side.status()
        if status is not None:
            crossing = sum(topic["direction"] != "local" for topic in status["topics"])
            if crossing >= 12:
                time.sleep(1.0)
                return
        time.sleep(0.3)
    raise DemoError(f"only {crossing} of 12 topics crossed the link after {_START_S:.0f} s; logs in {side.workdir}")


def _check_alive(side: Side) -> None:
    for name, process in side.processes.items():
        if process.poll() is not None:
            raise DemoError(f"{name} ended with code {process.returncode}; see {side.workdir / (name + '.log')}")


def _results(side: Side, status: dict[str, Any] | None, duration_s: float) -> list[TopicResult]:
    files = [side.result(name) for name in SOURCES]
    offered = {topic: count for file in files for topic, count in file["offered"].items()}
    received = {topic: summary for file in files for topic, summary in file.get("received", {}).items()}
    numbers = {topic: number for file in files for topic, number in file.get("numbers", {}).items()}
    by_topic = {topic["topic"]: topic for topic in status["topics"]} if status else {}
    results = []
    for topic, summary in received.items():
        managed = by_topic.get(topic if topic == COMMAND_TOPIC else side.prefix + topic)
        rate_hz = _rate_hz(topic)
        results.append(
            TopicResult(
                topic=topic,
                source_rate_hz=rate_hz,
                expected=round(rate_hz * duration_s),
                offered=offered[topic],
                withheld=managed["withheld"] if managed else 0,
                sent=managed["published"] if managed else offered[topic],
                handed=numbers[topic] if side.manner.has_two_ends else None,
                **summary,
            )
        )
    return results


def _rate_hz(topic: str) -> float:
    return COMMAND_RATE_HZ if topic == COMMAND_TOPIC else SENSORS[topic][0]


def _end(side: Side) -> None:
    for name in ("run", "relay", "relay_far", "peer", *side.processes):
        process = side.processes.get(name)
        if process is not None and process.poll() is None:
            process.terminate()
    for process in side.processes.values():
        try:
            process.wait(timeout=15)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
