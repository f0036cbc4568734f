"""Play one real run for all tests of the folder: the demo's robot over a real link, under a real Prometheus.

Prometheus runs on the robot, with the configuration, the rules and the alerts of etc/prometheus; only its intervals are
shorter. Forwarded ports lead from here to it and to the daemon, in the robot's network namespace.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
import urllib.error
import urllib.parse
import urllib.request
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import yaml

from scripts.bench.report import REPO
from scripts.robot.proxy import window
from tests.all.link.live_robot import FAST, SLOW, TOPICS, live_robot
from tests.waiting import eventually

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from scripts.bench.world import World
    from scripts.netns.simlink import SimLink

# They must fire while every packet is lost; the outage lasts until they do.
OUTAGE_CONDITIONS = ("outage", "peer_lost")
PROMETHEUS_ETC = REPO / "etc" / "prometheus"
_PROMETHEUS_PORT = 9090
_TRICKLE = 10.0  # bytes/s; a bucket of one frame still fits into the kernel's 275 s


@dataclass(kw_only=True)
class RealRun:
    """The run, still alive: the robot goes on, Prometheus goes on scraping it.

    Attributes
    ----------
    url : the daemon's HTTP server, such as http://127.0.0.1:40001
    prometheus_url : Prometheus's HTTP server
    moments : Unix times at which the phases began, by name (s): start, steady, slow, outage, outage_end,
        recovered. arpd's own state is outage for its first 10 s; then it gives up the peer.
    outage_alerts : the firing alerts at the end of the outage, by condition
    """

    world: World
    url: str
    prometheus_url: str
    moments: dict[str, float] = field(default_factory=dict)
    outage_alerts: dict[str, dict[str, Any]] = field(default_factory=dict)

    def get(self, path: str) -> bytes:
        """Return the daemon's answer to a path."""
        with urllib.request.urlopen(self.url + path, timeout=60) as answer:
            return answer.read()

    def status(self) -> dict[str, Any]:
        """Return the daemon's status document."""
        return json.loads(self.get("/api/v1/status"))

    def query(self, expression: str) -> list[tuple[dict[str, str], float]]:
        """Evaluate an expression now; return (labels, value) pairs."""
        answer = self.ask("query", query=expression)
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
            with urllib.request.urlopen(url, timeout=60) as answer:
                return json.load(answer)["data"]
        except urllib.error.HTTPError as error:
            if error.code == 503:
                raise  # not up yet
            raise ValueError(f"{parameters}: {json.load(error)['error']}") from error

    def begin(self, moment: str) -> None:
        """Note that a phase begins now."""
        self.moments[moment] = time.time()

    def eventually(self, what: str, condition: Callable[[], Any]) -> Any:
        """Wait for a condition of which each question may fail; show the logs if it does not come."""

        def holds() -> Any:
            with contextlib.suppress(OSError):
                return condition()

        try:
            return eventually(what, holds)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{self.logs()}") from None

    def logs(self) -> str:
        """Return the last lines of every process's log."""
        texts = {log.name: log.read_text(errors="replace").splitlines() for log in self.world.workdir.glob("*.log")}
        return "\n".join("\n".join([f"--- {name}", *text[-15:]]) for name, text in texts.items() if text)


@contextlib.contextmanager
def real_run(workdir: Path, *, prometheus: str) -> Iterator[RealRun]:
    """Start everything, play steady, slow, cut off and recovered, and keep it alive for the block."""
    with contextlib.ExitStack() as stack:
        world, url = stack.enter_context(live_robot(workdir / "robot"))
        _start_prometheus(world, prometheus, workdir / "prometheus")
        prometheus_url = stack.enter_context(window(world.link.robot, _PROMETHEUS_PORT))
        run = RealRun(world=world, url=url, prometheus_url=prometheus_url)
        _play(run)
        yield run


def _start_prometheus(world: World, prometheus: str, folder: Path) -> None:
    folder.mkdir()
    config = yaml.safe_load((PROMETHEUS_ETC / "prometheus.yml").read_text())
    config["global"].update(scrape_interval="1s", scrape_timeout="1s", evaluation_interval="1s")
    config["rule_files"] = [str(PROMETHEUS_ETC / name) for name in config.get("rule_files", ())]
    (folder / "prometheus.yml").write_text(yaml.safe_dump(config))
    with (world.workdir / "prometheus.log").open("w") as log:
        world.daemons["prometheus"] = world.link.popen(
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
    """Play each phase until its conditions come true."""
    link = run.world.link
    run.begin("start")
    run.eventually("Prometheus scrapes the daemon", lambda: run.query("up == 1"))
    # The first plan counts on the least that was measured by then; on a busy machine that is too little.
    run.eventually("a plan for the fast link is confirmed", lambda: _level(run) > 1.3 * SLOW and _is_confirmed(run))
    run.begin("steady")
    run.eventually("ten scrapes", lambda: run.query("count_over_time(up[1m]) > 10"))

    link.set_rate(SLOW)
    run.begin("slow")
    run.eventually("the plan for the slow link is confirmed", lambda: _level(run) < 1.3 * SLOW and _is_confirmed(run))
    seen = f"count_over_time((arpd_level_bytes_per_second < {1.3 * SLOW})[1m:1s]) > 5"
    run.eventually("five seconds of it", lambda: run.query(seen))

    _cut(link)
    run.begin("outage")
    for condition in OUTAGE_CONDITIONS:
        fires = _firing(condition)
        run.eventually(f"{condition} fires in the outage", lambda fires=fires: run.query(fires))
    # Longer than alerts keep firing, so that an alert that ends before the outage is visible.
    lasting = f"count_over_time({_firing('peer_lost')}[1m]) > 11"
    run.eventually("the outage lasts", lambda: run.query(lasting))
    run.outage_alerts = {
        alert["labels"]["condition"]: alert
        for alert in run.ask("alerts")["alerts"]
        if alert["state"] == "firing" and alert["labels"]["alertname"] == "ArpdCondition"
    }
    link.set_loss(0.0)
    link.set_rate(FAST)
    run.begin("outage_end")
    run.eventually("the alerts of the outage clear", lambda: not run.query(_firing("|".join(OUTAGE_CONDITIONS))))
    run.eventually("a plan for the fast link is confirmed", lambda: _level(run) > 1.3 * SLOW and _is_confirmed(run))
    run.begin("recovered")


def _cut(link: SimLink) -> None:
    """Let nothing cross while the interfaces are up: with loss alone, the receiver counts packets before the drop."""
    link.set_loss(1.0)
    link.set_rate(_TRICKLE)


def _firing(conditions: str) -> str:
    return f'ALERTS{{alertname="ArpdCondition", condition=~"{conditions}", alertstate="firing"}}'


def _is_confirmed(run: RealRun) -> bool:
    status = run.status()
    return status["plan"]["topics"] == status["plan"]["confirmed"] == len(TOPICS)


def _level(run: RealRun) -> float:
    return run.status()["plan"]["level_bytes_per_second"]
