"""The operator's view of one real run: a real Prometheus with rules and alerts, dashboards, page and `arpd status`.

Only this file uses the run (`tests.all.seeing.real_run`), so it plays once.
"""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
import time

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from scripts.bench.report import REPO
from scripts.netns.simlink import available
from tests.all.seeing.real_run import OUTAGE_CONDITIONS, real_run

CAN, WHY = available()
pytestmark = [
    pytest.mark.link,
    pytest.mark.ros,
    pytest.mark.timeout(600),  # the first test plays the run
    pytest.mark.skipif(not CAN, reason=WHY),
]


@pytest.fixture(scope="module")
def run(request, tmp_path_factory):
    """Play the run once, and keep it alive."""
    prometheus = request.getfixturevalue("prometheus")  # only now: it may have to be downloaded
    with real_run(tmp_path_factory.mktemp("seeing"), prometheus=prometheus) as played:
        yield played


def test_the_alerts_fire_in_the_outage_and_clear_after_it(run):
    """The outage and the lost peer raise alerts from within the outage on, and none after it."""
    for name in OUTAGE_CONDITIONS:
        ((labels, points),) = run.query_range(
            f'ALERTS{{alertname="ArpdCondition",condition="{name}",alertstate="firing"}}',
            run.moments["start"],
            time.time(),
        )
        assert points[0][0] > run.moments["outage"]
        assert labels["severity"] == "critical"
        sent = run.outage_alerts[name]  # at its end, which is later than arpd's own outage state
        assert sent["annotations"]["summary"].startswith("127.0.0.1:9464: ")
        assert "error expanding" not in str(sent), sent
    assert not run.query(f'ALERTS{{condition=~"{"|".join(OUTAGE_CONDITIONS)}"}}')


def targets(document):
    """Yield every query of a dashboard with the title of its panel, or of the collapsed heading that hides it."""
    for panel in document["panels"]:
        for inner in (panel, *panel.get("panels", ())):
            for target in inner.get("targets", ()):
                yield panel["title"], target


def fill_in(expression, values):
    """Return an expression as Grafana sends it; a variable without a value is a KeyError."""
    return re.sub(r"\$(?:\{(\w+)\}|(\w+))", lambda variable: values[variable[1] or variable[2]], expression)


def as_opened(run, document):
    """Return Grafana's values of the variables of a dashboard on opening."""
    values = {"__range": f"{time.time() - run.moments['start']:.0f}s", "__rate_interval": "10s"}
    for variable in document["templating"]["list"]:
        if variable["type"] == "query":
            metric, label = re.fullmatch(r"label_values\((.+), (\w+)\)", variable["query"]["query"]).groups()
            series = run.query(f"group by ({label}) ({fill_in(metric, values)})")
            offered = sorted(labels[label] for labels, _ in series)
            values[variable["name"]] = variable["allValue"] if variable["includeAll"] else offered[0]
    return values


def has_number(run, target, values):
    """Return whether a query has a number in the run, or now if Grafana asks only for the present."""
    expression = fill_in(target["expr"], values)
    if target.get("instant", False):
        return any(math.isfinite(value) for _, value in run.query(expression))
    series = run.query_range(expression, run.moments["start"], time.time(), 2.0)
    return any(math.isfinite(value) for _, points in series for _, value in points)


@pytest.mark.parametrize("name", ["arpd-robot", "arpd-fleet"])
def test_every_query_of_a_dashboard_returns_data(run, name):
    """Each query of each panel has a number of this run, with the variables' values on opening.

    The run has no relay with two ends; queries about one only have no error.
    """
    document = json.loads((REPO / f"etc/grafana/dashboards/{name}.json").read_text())
    values = as_opened(run, document)
    empty = [(title, target["expr"]) for title, target in targets(document) if not has_number(run, target, values)]
    assert [query for query in empty if query[0] != "Relay with two ends"] == []


# -- in a terminal


def command(*arguments):
    """Run ``arpd`` in a pipe; return its exit code and its output."""
    environment = {**os.environ, "COLUMNS": "400", "LINES": "200"}  # wide enough for everything
    done = subprocess.run(
        [sys.executable, "-m", "arpd.cli", *arguments], capture_output=True, text=True, check=False, env=environment
    )
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout + done.stderr


def test_status_shows_the_recovered_robot_as_well(run):
    """It exits with 0, and its one frame has verdict, topics, the allowed part through the outage, and the log."""

    def told():
        before = run.status()
        code, text = command("status", "--url", run.url)
        is_well = code == 0 and text.splitlines()[1].startswith(before["verdict"]["headline"])
        return (before, text) if is_well else None

    before, text = run.eventually("arpd status tells that all is well", told)
    assert "\x1b" not in text
    lines = text.splitlines()
    course = {line.split()[0]: set(line) & set("▁▂▃▄▅▆▇█") for line in lines if line.startswith(("link ", "allowed "))}
    assert course["link"]
    assert len(course["allowed"]) > 1, "the outage allows less"
    for topic in before["topics"]:
        assert any(line.startswith(f"{topic['topic']} ") for line in lines), text
    assert any(line.endswith(before["events"][-1]["text"]) for line in lines), text
