"""The operator's view of one real run: a real Prometheus with rules and alerts, dashboards, page and `arpd top`.

Only this file uses the run (`tests.seeing.real_run`): pytest-xdist runs file by file, so it plays once.
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
import yaml

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from tests.seeing import dashboards
from tests.seeing.browser import chromium, visit
from tests.seeing.real_run import PROMETHEUS_ETC

pytestmark = [pytest.mark.link, pytest.mark.ros]
RULE_FILES = ("arpd.rules.yml", "arpd.alerts.yml")


def test_the_play_went_as_planned(run):
    """Every phase of the play came within its time: plans were confirmed, alerts fired, and cleared."""
    assert not run.missed, "\n\n".join(run.missed)


def test_every_rule_evaluates_and_records(run):
    """No rule has an error, and every recorded series has data of this run."""
    rules = [rule for group in run.ask("rules")["groups"] for rule in group["rules"]]
    assert {rule["health"] for rule in rules} == {"ok"}, [rule for rule in rules if rule["health"] != "ok"]
    recorded = {rule["name"] for rule in rules if rule["type"] == "recording"}
    assert recorded == {rule["record"] for rule in rules_of("arpd.rules.yml")}
    assert {rule["name"] for rule in rules if rule["type"] == "alerting"} == {
        rule["alert"] for rule in rules_of("arpd.alerts.yml")
    }
    for name in recorded:
        assert run.query(f"last_over_time({name}[10m])"), name


def test_every_metric_of_the_rules_is_there(run):
    """The running daemon exposes every metric that a rule or an alert names, but those of two ends, which it lacks."""
    exposed = set(re.findall(r"^# TYPE (\w+) ", run.get("/metrics").decode(), flags=re.MULTILINE))
    expressions = " ".join(rule["expr"] for name in RULE_FILES for rule in rules_of(name))
    named = set(re.findall(r"(?<![\w:])(?:arpd|process)_\w+", expressions))
    assert len(named) > 40
    assert {name for name in named if not name.startswith("arpd_relay_")} <= exposed


def test_promtool_finds_nothing_to_complain_about_in_a_scrape(run, promtool):
    """The running daemon's metrics keep Prometheus's rules for names, units, types and help."""
    scraped = run.get("/metrics")
    checked = subprocess.run([promtool, "check", "metrics"], input=scraped, capture_output=True, check=False)
    assert (checked.returncode, checked.stdout + checked.stderr) == (0, b"")
    assert len(scraped.splitlines()) > 1000


def test_prometheus_scraped_arpd_throughout(run):
    """The daemon answered nearly every scrape, in the outage too, and never restarted."""
    begin_s = run.moments["steady"]
    ((_, points),) = run.query_range("up", begin_s, time.time())
    answered = [value for _, value in points]
    assert sum(answered) > 0.95 * len(answered) > 40
    ((_, during),) = run.query_range("up", run.moments["outage"], run.moments["outage_end"])
    assert sum(value for _, value in during) > 0.9 * len(during)
    assert run.query(f"changes(process_start_time_seconds[{math.ceil(time.time() - begin_s)}s])")[0][1] == 0


def test_the_alerts_fire_in_the_outage_and_clear_after_it(run):
    """ArpdLinkDown and ArpdPeerLost fire from within the outage to its end, and not after it."""
    outage_s, end_s = run.moments["outage"], run.moments["outage_end"]
    for name in ("ArpdLinkDown", "ArpdPeerLost"):
        ((labels, points),) = run.query_range(
            f'ALERTS{{alertname="{name}",alertstate="firing"}}', run.moments["start"], time.time()
        )
        times = [at_s for at_s, _ in points]
        assert outage_s < times[0] < end_s
        # The alert lasts as long as the outage, which is longer than arpd's own outage state.
        assert [at_s for at_s in times if at_s < end_s][-1] > end_s - 3.0
        assert labels["severity"] == "critical"
        sent = run.outage_alerts[name]
        assert sent["annotations"]["summary"].startswith("127.0.0.1:9464: ")
        assert "error expanding" not in str(sent), sent
    assert not run.query('ALERTS{alertname=~"ArpdLinkDown|ArpdPeerLost"}')


def rules_of(name):
    groups = yaml.safe_load((PROMETHEUS_ETC / "rules" / name).read_text())["groups"]
    return [rule for group in groups for rule in group["rules"]]


def numbers(run, query, values):
    """Return all numbers of a dashboard's query over the run, or now, with the labels of their series."""
    expression = dashboards.fill_in(query.expression, values)
    if query.is_instant:
        series = [(labels, [(0.0, value)]) for labels, value in run.query(expression)]
    else:
        series = run.query_range(expression, run.moments["start"], time.time(), 2.0)
    return [(labels, value) for labels, points in series for _, value in points if math.isfinite(value)]


def opened(run, document):
    return dashboards.as_opened(document, run.query, span_s=time.time() - run.moments["start"])


@pytest.mark.parametrize("name", dashboards.NAMES)
def test_every_query_of_a_dashboard_returns_data(run, name):
    """Each query of each panel has a number of this run, with the variables' values on opening."""
    document = dashboards.load(name)
    values = opened(run, document)
    empty = [query for query in dashboards.queries(document) if not numbers(run, query, values)]
    assert not empty, "\n".join(f"{query.where}: {dashboards.fill_in(query.expression, values)}" for query in empty)


@pytest.mark.parametrize("name", dashboards.NAMES)
def test_annotations_mark_what_happened(run, name):
    """The dashboards mark plans, swaps and the outage of the run; marks of other kinds evaluate."""
    document = dashboards.load(name)
    values = opened(run, document)
    for query in dashboards.marks(document):
        counted = dashboards.Query(
            where=query.where, expression=query.expression.removesuffix(" > 0"), is_instant=False
        )
        assert numbers(run, counted, values), query
        if query.where.split(", ")[1] in {"Plans", "Swaps", "Outages"}:
            assert numbers(run, query, values), query


def test_the_first_row_shows_the_outage(run):
    """While every packet is lost, the first row says outage, and counts more alerts than before."""
    document = dashboards.load("arpd-robot")
    values = opened(run, document)
    shown = {panel["title"]: panel for panel in dashboards.panels(document)}
    (mapping,) = shown["Link"]["fieldConfig"]["defaults"]["mappings"]
    words = {int(number): state["text"] for number, state in mapping["options"].items()}

    def shown_by(title, begin, end):
        expression = dashboards.fill_in(shown[title]["targets"][0]["expr"], values)
        ((_, points),) = run.query_range(expression, run.moments[begin], run.moments[end])
        return [int(value) for _, value in points]

    assert "outage" in {words[number] for number in shown_by("Link", "outage", "outage_end")}
    assert {words[number] for number in shown_by("Link", "steady", "slow")} != {"outage"}
    before = shown_by("Alerts firing", "steady", "slow")
    assert max(shown_by("Alerts firing", "outage", "outage_end")) > max(before)


def test_a_row_of_the_topics_table_is_one_publisher(run):
    """Each column of the table of topics has at most one value for a publisher, and every publisher has its rates."""
    document = dashboards.load("arpd-robot")
    values = opened(run, document)
    columns = [query for query in dashboards.queries(document) if ", Topics now, " in query.where]

    def rows(query):
        found = [(labels["topic"], labels["node"], labels["direction"]) for labels, _ in numbers(run, query, values)]
        assert len(found) == len(set(found)), query
        return set(found)

    def managed():
        return {(row["topic"], row["node"], row["direction"]) for row in run.status()["topics"]}

    assert all(rows(query) for query in columns)
    source, published = columns[0], columns[2]
    run.eventually(lambda: rows(source) == rows(published) == managed(), 30.0, "a row for each publisher of the status")


# -- in a terminal


def command(*arguments):
    """Run ``arpd`` in a pipe; return its exit code and its output."""
    environment = {**os.environ, "COLUMNS": "400", "LINES": "200"}  # wide enough for everything
    done = subprocess.run(
        [sys.executable, "-m", "arpd.cli", *arguments], capture_output=True, text=True, check=False, env=environment
    )
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout + done.stderr


def test_status_reports_the_recovered_robot_as_well(run):
    """It exits with 0, and prints the daemon's verdict and every topic with its announced rate and depth."""

    def is_well():
        status = run.status()
        code, told = command("status", "--url", run.url)
        lines = told.splitlines()
        return (
            code == 0
            and lines[1].startswith(status["verdict"]["headline"])
            and all(
                re.search(
                    rf"^{topic['topic']} +{topic['confirmed']['rate_hz']:.3g}\b.* {topic['confirmed']['depth']} ",
                    told,
                    re.MULTILINE,
                )
                for topic in status["topics"]
            )
        )

    run.eventually(is_well, 60.0, f"arpd status tells what the daemon does: {command('status', '--url', run.url)}")


def test_top_shows_the_run_in_one_frame(run):
    """The frame has topics, capacity, the admitted part through the outage and the log, without control codes."""
    before = run.status()
    code, told = command("top", "--once", "--url", run.url)
    assert code == 0
    assert "\x1b" not in told
    lines = told.splitlines()
    course = {line.split()[0]: line for line in lines if line.startswith(("link ", "queue ", "admitted "))}
    assert all(set(line) & set("▁▂▃▄▅▆▇█") for line in course.values())
    assert len(set(course["admitted"]) & set("▁▂▃▄▅▆▇█")) > 1, "the outage admits less"
    for topic in before["topics"]:
        assert any(line.startswith(f"{topic['topic']} ") for line in lines), told
    assert before["events"]
    assert any(line.endswith(before["events"][-1]["text"]) for line in lines), told


@pytest.fixture(scope="module")
def browser():
    with chromium() as started:
        yield started


def test_the_page_shows_what_the_status_says(run, browser):
    """Verdict, plan and every topic with its node on the live page are those of its last status document."""
    with visit(browser, run.url) as seen:
        seen.wait_for("document.querySelectorAll('canvas').length === 4")
        assert seen.complaints == []
        document = seen.last_status()
        topics = document["topics"]
        assert seen.texts("#verdict p") == [document["verdict"]["text"]]
        assert seen.texts("[data-field='plan.generation|count']") == [str(document["plan"]["generation"])]
        named = {f"{topic['topic']} {topic['node']}, {topic['direction']}" for topic in topics}
        assert set(seen.texts("#topics tbody th")) == named
        assert sum(topic["direction"] != "local" for topic in topics) >= 12
        assert all(request.startswith((run.url, "data:")) for request in seen.requests)


def test_the_page_shows_the_outage(run, browser):
    """The charts show the run, and the decision log has the drop and the outage."""
    with visit(browser, run.url) as seen:
        seen.wait_for("document.querySelectorAll('canvas').length === 4")
        assert all(seen.drawn(f"#chart-{name} canvas") > 1000 for name in ("rate", "delay", "gate", "topic"))
        log = seen.texts("#log li")
        assert any("carries nothing" in line for line in log), log
        assert any("link fell to" in line and "→" in line for line in log), log
        assert seen.complaints == []


def test_the_history_has_the_run(run):
    """The outage is in the history at its time, and all columns are as long as the times."""
    history = json.loads(run.get("/api/v1/history"))
    states = list(zip(history["times"], history["link"]["state"], strict=True))

    def states_between(begin, end):
        return [state for at_s, state in states if run.moments[begin] < at_s < run.moments[end]]

    during = states_between("outage", "outage_end")
    assert during.count("outage") > len(during) / 2
    assert "outage" not in states_between("steady", "slow")
    assert len(history["topics"]) >= 12
    assert {len(topic["published_rate_hz"]) for topic in history["topics"]} == {len(history["times"])}
