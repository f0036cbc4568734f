"""Play one real run for all tests of the folder: the demo's robot over a real link, under a real Prometheus.

Prometheus runs on the robot, with the configuration, the rules and the alerts of etc/prometheus; only its intervals are
shorter. Forwarded ports lead from here to it and to the daemon, in the robot's network namespace.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import time
import urllib.error
import urllib.parse
import urllib.request
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import yaml

from scripts.netns.simlink import SimLink
from scripts.robot.manner import WITH_ARPD
from scripts.robot.proxy import window
from scripts.robot.run import REPO, SOURCES, Side, robot
from scripts.robot.sensors import SENSORS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

FAST, SLOW = 20e6 / 8, 5e6 / 8
# They must fire while every packet is lost; the outage lasts until they do.
OUTAGE_ALERTS = ("ArpdLinkDown", "ArpdPeerLost")
PROMETHEUS_ETC = REPO / "etc" / "prometheus"
_PROMETHEUS_PORT = 9090
_POLL_S = 0.2
_PATIENCE_S = 60.0  # for one condition
_PLAY_S = 200.0  # for all of them: less than pytest's timeout, which would show no logs
_TRICKLE = 10.0  # bytes/s; a bucket of one frame still fits into the kernel's 275 s
_REFUSED = (400, 422)  # the expression does not parse, or does not evaluate


class NotInTimeError(AssertionError):
    """A condition of the run did not come true in its time; the message shows the logs."""


@dataclass(kw_only=True)
class RealRun:
    """The run, still alive: the robot goes on, Prometheus goes on scraping it.

    Attributes
    ----------
    url : the daemon's HTTP server, such as http://127.0.0.1:40001
    prometheus_url : Prometheus's HTTP server
    moments : Unix times at which the phases began, by name (s): start, steady, slow, slow_confirmed, outage,
        outage_end, recovered. arpd's own state is outage for its first 10 s; then it gives up the peer.
    missed : conditions of the play that did not come true in their time, in plain words
    outage_alerts : the firing alerts at the end of the outage, by name
    """

    side: Side
    url: str
    prometheus_url: str
    moments: dict[str, float] = field(default_factory=dict)
    missed: list[str] = field(default_factory=list)
    outage_alerts: dict[str, dict[str, Any]] = field(default_factory=dict)

    def get(self, path: str) -> bytes:
        """Return the daemon's answer to a path."""
        with urllib.request.urlopen(self.url + path, timeout=20) as answer:
            return answer.read()

    def status(self) -> dict[str, Any]:
        """Return the daemon's status document."""
        return json.loads(self.get("/api/v1/status"))

    def query(self, expression: str, *, at_s: float | None = None) -> list[tuple[dict[str, str], float]]:
        """Evaluate an expression now or at a Unix time; return (labels, value) pairs.

        Raises
        ------
        ValueError
            If Prometheus refuses the expression; the message is its reason.
        """
        answer = self.ask("query", query=expression, **({} if at_s is None else {"time": at_s}))
        if answer["resultType"] in ("scalar", "string"):
            return [({}, float(answer["result"][1]))]
        return [(series["metric"], float(series["value"][1])) for series in answer["result"]]

    def query_range(
        self, expression: str, begin_s: float, end_s: float, step_s: float = 1.0
    ) -> list[tuple[dict[str, str], list[tuple[float, float]]]]:
        """Evaluate an expression over a span of Unix time; return (labels, [(time, value), …]) pairs."""
        answer = self.ask("query_range", query=expression, start=begin_s, end=end_s, step=step_s)
        return [
            (series["metric"], [(float(at_s), float(value)) for at_s, value in series["values"]])
            for series in answer["result"]
        ]

    def ask(self, what: str, **parameters: object) -> Any:
        """Return the data of Prometheus's answer to an API call."""
        url = f"{self.prometheus_url}/api/v1/{what}?{urllib.parse.urlencode(parameters)}"
        try:
            with urllib.request.urlopen(url, timeout=20) as answer:
                return json.load(answer)["data"]
        except urllib.error.HTTPError as error:
            if error.code not in _REFUSED:
                raise  # 503: not up yet
            raise ValueError(f"{parameters}: {json.load(error)['error']}") from error

    def begin(self, moment: str) -> None:
        """Note that a phase begins now."""
        self.moments[moment] = time.time()

    def expect(self, condition: Callable[[], Any], text: str) -> None:
        """Wait as `eventually`, but note a failure: one test reports it, and the others still have their run."""
        left_s = self.moments["start"] + _PLAY_S - time.time()
        try:
            self.eventually(condition, min(_PATIENCE_S, left_s), text)
        except NotInTimeError as error:
            self.missed.append(str(error))

    def wait_until(self, expression: str, timeout_s: float = _PATIENCE_S) -> list[tuple[dict[str, str], float]]:
        """Wait until an expression has a result, such as ``up == 1``, and return it."""
        return self.eventually(lambda: self.query(expression), timeout_s, expression)

    def eventually(self, condition: Callable[[], Any], timeout_s: float, text: str) -> Any:
        """Wait until a condition holds; return its result."""
        until_s = time.monotonic() + timeout_s
        while True:
            with contextlib.suppress(OSError):
                if result := condition():
                    return result
            if time.monotonic() > until_s:
                raise NotInTimeError(f"not in {timeout_s:.0f} s: {text}\n{self.logs()}")
            time.sleep(_POLL_S)

    def logs(self, lines: int = 15) -> str:
        """Return the last lines of every process's log."""
        return tail_of_logs(self.side.workdir, lines)


def tail_of_logs(folder: Path, lines: int = 15) -> str:
    """Return the last lines of every log in a folder, under its name."""
    texts = {log.name: log.read_text(errors="replace").splitlines() for log in sorted(folder.glob("*.log"))}
    return "\n".join("\n".join([f"--- {name}", *text[-lines:]]) for name, text in texts.items() if text)


@contextlib.contextmanager
def real_run(workdir: Path, *, prometheus: str) -> Iterator[RealRun]:
    """Start everything, play steady, slow, cut off and recovered, and keep it alive for the block.

    Parameters
    ----------
    workdir : empty folder for logs and data of the processes
    prometheus : path of the server's program
    """
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(SimLink(f"seeing-{os.getpid()}", rate_bytes_per_second=FAST))
        try:
            side = stack.enter_context(robot(link, workdir / "robot", WITH_ARPD))
        except Exception as error:
            raise NotInTimeError(f"{error}\n{tail_of_logs(workdir / 'robot')}") from error
        _start_prometheus(side, prometheus, workdir / "prometheus")
        run = RealRun(side=side, url=side.url, prometheus_url=stack.enter_context(window(link.robot, _PROMETHEUS_PORT)))
        stack.callback(_kill, side)
        _play(run)
        yield run


def _kill(side: Side) -> None:
    """Kill all processes: a daemon that ends cleanly would wait for publishers, which end at the same time."""
    for process in side.processes.values():
        process.kill()


def _start_prometheus(side: Side, prometheus: str, folder: Path) -> None:
    folder.mkdir()
    config = yaml.safe_load((PROMETHEUS_ETC / "prometheus.yml").read_text())
    config["global"].update(scrape_interval="1s", scrape_timeout="1s", evaluation_interval="1s")
    config["rule_files"] = [str(PROMETHEUS_ETC / name) for name in config.get("rule_files", ())]
    (folder / "prometheus.yml").write_text(yaml.safe_dump(config))
    with (side.workdir / "prometheus.log").open("w") as log:
        side.processes["prometheus"] = side.link.popen(
            "robot",
            [
                prometheus,
                f"--config.file={folder / 'prometheus.yml'}",
                f"--storage.tsdb.path={folder / 'data'}",
                f"--web.listen-address=127.0.0.1:{_PROMETHEUS_PORT}",
                "--log.level=warn",
            ],
            env={**os.environ, "GOMAXPROCS": "1"},
            stdout=log,
            stderr=log,
            text=True,
        )


def _play(run: RealRun) -> None:
    """Play each phase until its conditions come true; note a condition that does not, instead of raising."""
    side, link = run.side, run.side.link
    run.begin("start")
    side.signal(signal.SIGUSR1, *SOURCES)
    run.eventually(lambda: run.query("up == 1"), _PATIENCE_S, "Prometheus scrapes the daemon")
    # The first plan counts on the least that was measured by then; on a busy machine that is too little.
    run.expect(lambda: _level(run) > 1.3 * SLOW and _is_confirmed(run), "a plan for the fast link is confirmed")
    run.begin("steady")
    run.expect(lambda: run.query("count_over_time(up[1m]) > 10"), "ten scrapes")

    link.set_rate(SLOW)
    run.begin("slow")
    run.expect(lambda: _level(run) < 1.3 * SLOW and _is_confirmed(run), "the plan for the slow link is confirmed")
    run.begin("slow_confirmed")
    seen = f"count_over_time((arpd_level_bytes_per_second < {1.3 * SLOW})[1m:1s]) > 5"
    run.expect(lambda: run.query(seen), "five seconds of it")

    _cut(link)
    run.begin("outage")
    for alert in OUTAGE_ALERTS:
        run.expect(lambda alert=alert: run.query(_firing(alert)), f"{alert} fires in the outage")
    # Longer than alerts keep firing, so that an alert that ends before the outage is visible.
    lasting = f"count_over_time({_firing('ArpdPeerLost')}[1m]) > 11"
    run.expect(lambda: run.query(lasting), "the outage lasts")
    run.outage_alerts = {
        alert["labels"]["alertname"]: alert for alert in run.ask("alerts")["alerts"] if alert["state"] == "firing"
    }
    link.set_loss(0.0)
    link.set_rate(FAST)
    run.begin("outage_end")
    run.expect(lambda: not run.query(_firing("|".join(OUTAGE_ALERTS))), "the alerts of the outage clear")
    run.expect(lambda: _level(run) > 1.3 * SLOW and _is_confirmed(run), "the plan for the fast link is confirmed")
    run.begin("recovered")


def _cut(link: SimLink) -> None:
    """Let nothing cross while the interfaces are up: with loss alone, the receiver counts packets before the drop."""
    link.set_loss(1.0)
    link.set_rate(_TRICKLE)


def _firing(alerts: str) -> str:
    return f'ALERTS{{alertname=~"{alerts}", alertstate="firing"}}'


def _is_confirmed(run: RealRun) -> bool:
    status = run.status()
    return status["plan"]["topics"] == status["plan"]["confirmed"] == len(SENSORS) + 1


def _level(run: RealRun) -> float:
    return run.status()["level_bytes_per_second"]
