"""Checks etc/prometheus (configuration, recording rules, alerts) with promtool and against the exposition."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
import yaml
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families

from arpd.report.conditions import MESSAGE_IDS, Condition
from arpd.web.metrics import make_registry

REPO = Path(__file__).parents[2]
ETC = REPO / "etc" / "prometheus"
RECORDING, ALERTING = ETC / "rules" / "arpd.rules.yml", ETC / "rules" / "arpd.alerts.yml"
ALERT_CASES = yaml.safe_load(Path(__file__).with_name("alerts.yml").read_text())


def rules(path):
    return [rule for group in yaml.safe_load(path.read_text())["groups"] for rule in group["rules"]]


def exposed():
    """Return the names of the series of the golden exposition and of the process, each with its label sets."""
    series: dict[str, list[dict[str, str]]] = {}
    golden = (REPO / "tests/golden/exposition.txt").read_text()
    for text in (golden, generate_latest(make_registry(lambda: None)).decode()):
        for sample in (sample for family in text_string_to_metric_families(text) for sample in family.samples):
            series.setdefault(sample.name, []).append(sample.labels)
    return series


def run(promtool, *arguments):
    done = subprocess.run([promtool, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_configuration_and_the_rules_are_valid(promtool):
    """Promtool and its linter accept the configuration with both rule files."""
    assert "2 rule files found" in run(
        promtool, "check", "config", "--lint=all", "--lint-fatal", ETC / "prometheus.yml"
    )
    run(promtool, "check", "rules", "--lint=all", "--lint-fatal", RECORDING, ALERTING)


def test_rules_say_what_their_unit_test_wants(promtool):
    """Recording rules pass promtool's unit test."""
    run(promtool, "test", "rules", Path(__file__).with_name("rules.test.yml"))


def of_a_robot(series):
    """Return a series with the labels of the robot r1, unless it has its own."""
    name, _, labels = series.removesuffix("}").partition("{")
    own = {label.partition("=")[0] for label in labels.split(",")}
    named = {"instance": '"r1"', "job": '"arpd"'}
    return f"{name}{{{','.join(filter(None, [*(f'{k}={v}' for k, v in named.items() if k not in own), labels]))}}}"


@pytest.mark.parametrize("case", ALERT_CASES, ids=lambda case: case["alert"])
def test_every_alert_is_seen_to_fire_and_to_clear(promtool, tmp_path, case):
    """Each is quiet before it fires, fires, and is neither firing nor pending when what it is about is over."""
    every, alert = f"{case.get('every', 2)}s", f'alertname="{case["alert"]}"'
    asked = {"quiet": f'{alert},alertstate="firing"', "fires": f'{alert},alertstate="firing"', "over": alert}
    found = {"quiet": [], "fires": [{"labels": "{}", "value": case.get("count", 1)}], "over": []}
    test = {
        "interval": every,
        "input_series": [{"series": of_a_robot(name), "values": values} for name, values in case["series"].items()],
        "promql_expr_test": [
            {"expr": f"count(ALERTS{{{asked[what]}}})", "eval_time": f"{at_s}s", "exp_samples": found[what]}
            for what, times in case["at"].items()
            for at_s in times
        ],
    }
    files = {"rule_files": [str(RECORDING), str(ALERTING)], "evaluation_interval": every}
    path = tmp_path / "alerts.test.yml"
    path.write_text(yaml.safe_dump({**files, "tests": [test]}))
    run(promtool, "test", "rules", path)


def test_every_alert_says_what_it_is_and_where_its_runbook_is():
    """Each has a severity and a summary that names the robot; each alert and each wrong condition has a runbook."""
    assert {case["alert"] for case in ALERT_CASES} == {rule["alert"] for rule in rules(ALERTING)}
    sections = set(re.findall(r"^### (\w+)$", (ETC / "RUNBOOKS.md").read_text(), flags=re.MULTILINE))
    conditions = {condition for condition in Condition if condition.is_wrong}
    for rule in rules(ALERTING):
        annotations, is_ours = rule["annotations"], rule["alert"] != "ArpdCondition"
        assert rule["labels"]["severity"] in ("critical", "warning") or not is_ours, rule
        assert set(annotations) == {"summary", "description", "runbook"}, rule
        assert annotations["summary"].startswith("{{ $labels.instance }}: "), rule
        section = rule["alert"].lower() if is_ours else "{{ $labels.condition }}"
        assert annotations["runbook"] == f"etc/prometheus/RUNBOOKS.md#{section}"
    assert sections == {rule["alert"] for rule in rules(ALERTING)} - {"ArpdCondition"} | conditions


def test_the_runbooks_name_what_there_is():
    """The metrics, events and configuration keys in the runbooks exist."""
    text = (ETC / "RUNBOOKS.md").read_text()
    assert set(re.findall(r"\barpd_[a-z_]+", text)) <= {name.removesuffix("_bucket") for name in exposed()}
    assert set(re.findall(r"ARPD_EVENT=(\w+)", text)) <= set(MESSAGE_IDS)
    keys = set(re.findall(r"`((?:link|program|governor|http)\.[a-z_]+)`", text))
    document = yaml.safe_load((REPO / "etc/arpd/arpd.yaml").read_text())
    assert len(keys) >= 5
    assert all(key in document[section] for section, key in (name.split(".") for name in keys))
