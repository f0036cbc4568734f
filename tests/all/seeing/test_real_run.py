"""The operator's view of one real run: a real Prometheus with rules and alerts, dashboards, page and `arpd status`.

The demo's robot plays over a real link, and Prometheus runs on it, with the configuration, the rules and the alerts of
etc/prometheus; only its intervals are shorter. Forwarded ports lead from here to it and to the daemon.
"""

import json
import math
import os
import re
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
from contextlib import ExitStack, suppress

import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from scripts.bench.report import REPO
from scripts.netns.simlink import available
from scripts.robot.proxy import window
from tests import waiting
from tests.all.link.live_robot import FAST, SLOW, is_confirmed, live_robot
from tests.unit.test_dashboards import NAMES, of_dashboard

CAN, WHY = available()
pytestmark = [
    pytest.mark.link,
    pytest.mark.ros,
    pytest.mark.timeout(600),  # the first test plays the run
    pytest.mark.skipif(not CAN, reason=WHY),
]
# They must fire while every packet is lost; the outage lasts until they do.
OUTAGE_CONDITIONS = ("outage", "peer_lost")
PROMETHEUS_ETC = REPO / "etc" / "prometheus"
PORT = 9090
TRICKLE = 10.0  # bytes/s; a bucket of one frame still fits into the kernel's 275 s


def eventually(what, condition):
    """Wait for a condition of which each question may fail."""

    def holds():
        with suppress(OSError):
            return condition()

    return waiting.eventually(what, holds)


class RealRun:
    """The run, still alive after it was played: the robot goes on, Prometheus goes on scraping it.

    Attributes
    ----------
    url : the daemon's HTTP server, such as http://127.0.0.1:40001
    start_s, outage_s : Unix times at which the run and its outage began
    outage_alerts : the firing alerts at the end of the outage, by condition
    """

    def __init__(self, world, url, prometheus_url):
        self.world, self.url, self._prometheus_url = world, url, prometheus_url

    def ask(self, what, **parameters):
        """Return the data of Prometheus's answer to an API call."""
        url = f"{self._prometheus_url}/api/v1/{what}?{urllib.parse.urlencode(parameters)}"
        try:
            with urllib.request.urlopen(url, timeout=60) as answer:
                return json.load(answer)["data"]
        except urllib.error.HTTPError as error:
            if error.code == 503:
                raise  # not up yet
            raise ValueError(f"{parameters}: {json.load(error)['error']}") from error

    def query(self, expression):
        """Return the series for which an expression holds now."""
        return self.ask("query", query=expression)["result"]

    def course(self, expression, step_s=1.0):
        """Evaluate an expression over the whole run; return (labels, [(Unix time, value), …]) pairs."""
        answer = self.ask("query_range", query=expression, start=self.start_s, end=time.time(), step=step_s)
        return [
            (series["metric"], [(float(at_s), float(value)) for at_s, value in series["values"]])
            for series in answer["result"]
        ]

    def play(self):
        """Play steady, slow, cut off and recovered; each phase lasts until its conditions come true."""
        link = self.world.link
        self.start_s = time.time()
        eventually("Prometheus scrapes the daemon", lambda: self.query("up == 1"))
        # The first plan counts on the least that was measured by then; on a busy machine that is too little.
        eventually("a plan for the fast link is confirmed", lambda: self._has_plan(FAST))
        eventually("ten scrapes", lambda: self.query("count_over_time(up[1m]) > 10"))

        link.set_rate(SLOW)
        eventually("the plan for the slow link is confirmed", lambda: self._has_plan(SLOW))
        seen = f"count_over_time((arpd_level_bytes_per_second < {1.3 * SLOW})[1m:1s]) > 5"
        eventually("five seconds of it", lambda: self.query(seen))

        # Nothing crosses while the interfaces are up: with loss alone, the receiver counts packets before the drop.
        link.set_loss(1.0)
        link.set_rate(TRICKLE)
        self.outage_s = time.time()
        for condition in OUTAGE_CONDITIONS:
            fires = firing(condition)
            eventually(f"{condition} fires in the outage", lambda fires=fires: self.query(fires))
        # Longer than alerts keep firing, so that an alert that ends before the outage is visible.
        lasting = f"count_over_time({firing('peer_lost')}[1m]) > 11"
        eventually("the outage lasts", lambda: self.query(lasting))
        self.outage_alerts = {
            alert["labels"]["condition"]: alert
            for alert in self.ask("alerts")["alerts"]
            if alert["state"] == "firing" and alert["labels"]["alertname"] == "ArpdCondition"
        }
        link.set_loss(0.0)
        link.set_rate(FAST)
        eventually("the alerts of the outage clear", lambda: not self.query(firing("|".join(OUTAGE_CONDITIONS))))
        eventually("a plan for the fast link is confirmed", lambda: self._has_plan(FAST))

    def _has_plan(self, for_rate):
        """Return whether the plan in force is for the slow or for the fast link."""
        status = self.world.status()
        is_fast = bool(status) and status["plan"]["level_bytes_per_second"] > 1.3 * SLOW
        return status and is_fast == (for_rate == FAST) and is_confirmed(self.world)


def firing(conditions):
    return f'ALERTS{{alertname="ArpdCondition", condition=~"{conditions}", alertstate="firing"}}'


def start_prometheus(world, program, folder):
    folder.mkdir()
    config = yaml.safe_load((PROMETHEUS_ETC / "prometheus.yml").read_text())
    config["global"].update(scrape_interval="1s", scrape_timeout="1s", evaluation_interval="1s")
    config["rule_files"] = [str(PROMETHEUS_ETC / name) for name in config.get("rule_files", ())]
    (folder / "prometheus.yml").write_text(yaml.safe_dump(config))
    files = (f"--config.file={folder}/prometheus.yml", f"--storage.tsdb.path={folder}/data")
    argv = [program, *files, f"--web.listen-address=127.0.0.1:{PORT}", "--log.level=warn"]
    world.daemons["prometheus"] = world.link.popen("robot", argv, env={**os.environ, "GOMAXPROCS": "1"})


@pytest.fixture(scope="module")
def run(request, tmp_path_factory):
    """Play the run once, and keep it alive."""
    prometheus = request.getfixturevalue("prometheus")  # only now: it may have to be downloaded
    folder = tmp_path_factory.mktemp("seeing")
    with ExitStack() as stack:
        world, url = stack.enter_context(live_robot(folder / "robot"))
        start_prometheus(world, prometheus, folder / "prometheus")
        run = RealRun(world, url, stack.enter_context(window(world.link.robot, PORT)))
        run.play()
        yield run


def test_the_alerts_fire_in_the_outage_and_clear_after_it(run):
    """The outage and the lost peer raise alerts from within the outage on, and none after it."""
    for name in OUTAGE_CONDITIONS:
        ((labels, points),) = run.course(firing(name))
        assert points[0][0] > run.outage_s
        assert labels["severity"] == "critical"
        sent = run.outage_alerts[name]  # at its end, which is later than arpd's own outage state
        assert sent["annotations"]["summary"].startswith("127.0.0.1:9464: ")
        assert "error expanding" not in str(sent), sent
    assert not run.query(f'ALERTS{{condition=~"{"|".join(OUTAGE_CONDITIONS)}"}}')


@pytest.mark.parametrize("name", NAMES)
def test_every_query_of_a_dashboard_returns_data(run, name):
    """Each query of each panel has a number in this run, but those about a relay with two ends, which it has not."""
    values = {"instance": "127.0.0.1:9464", "topic": ".+", "__rate_interval": "10s"}
    values["__range"] = f"{time.time() - run.start_s:.0f}s"
    empty = []
    for query in of_dashboard(name)[1]:
        filled = re.sub(r"\$(\w+)", lambda variable: values[variable[1]], query)
        found = [value for _, points in run.course(filled, step_s=2.0) for _, value in points]
        if "arpd_relay_" not in query and not query.endswith("> 0") and not any(map(math.isfinite, found)):
            empty.append(query)
    assert empty == []


def test_status_shows_the_recovered_robot_as_well(run):
    """It exits with 0, and its one frame has verdict, topics, the allowed part through the outage, and the log."""
    environment = {**os.environ, "COLUMNS": "400", "LINES": "200"}  # wide enough for everything
    command = [sys.executable, "-m", "arpd.cli", "status", "--url", run.url]

    def told():
        before = run.world.status()
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        assert "Traceback" not in done.stderr
        is_well = before and not done.returncode
        return is_well and before["verdict"]["headline"] in done.stdout.splitlines()[1] and (before, done.stdout)

    before, text = eventually("arpd status tells that all is well", told)
    assert "\x1b" not in text
    lines = text.splitlines()
    course = {line.split()[0]: set(line) & set("▁▂▃▄▅▆▇█") for line in lines if line.startswith(("link ", "allowed "))}
    assert course["link"]
    assert len(course["allowed"]) > 1, "the outage allows less"
    for topic in before["topics"]:
        assert any(line.startswith(f"{topic['topic']} ") for line in lines), text
    assert any(line.endswith(before["events"][-1]["text"]) for line in lines), text
