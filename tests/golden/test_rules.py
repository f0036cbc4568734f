"""Checks etc/prometheus (configuration, recording rules, alerts) with promtool and against the exposition."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
import yaml

from arpd.report.events import EventKind

REPO = Path(__file__).parents[2]
ETC = REPO / "etc" / "prometheus"
RECORDING, ALERTING = ETC / "rules" / "arpd.rules.yml", ETC / "rules" / "arpd.alerts.yml"
UNIT_TESTS = sorted(Path(__file__).parent.glob("*.test.yml"))
ALERTS = re.compile(r'count\(ALERTS\{alertname=~?"([A-Za-z|]+)"(,alertstate="firing")?\}\)')
OTHERS = {"process_start_time_seconds", "up", "ALERTS"}  # of prometheus_client and of Prometheus itself
NAME = re.compile(r"\b(?:(?:instance|topic):)?(?:arpd|process|python)_[a-z0-9_]+(?::[a-z0-9_]+)?\b|\bup\b|\bALERTS\b")
SELECTOR = re.compile(r"\b([a-z]+:)?(arpd_[a-z0-9_:]+)\{([^}]*)\}")


def rules(path):
    return [rule for group in yaml.safe_load(path.read_text())["groups"] for rule in group["rules"]]


def exposed():
    """Return the names of the golden exposition's series, each with its label sets."""
    series: dict[str, list[dict[str, str]]] = {}
    for line in (REPO / "tests/golden/exposition.txt").read_text().splitlines():
        if line.startswith("#"):
            kind = line.split()
            if kind[1] == "TYPE":
                series.setdefault(kind[2], [])
            continue
        name, _, labels = line.rpartition(" ")[0].partition("{")
        series.setdefault(name, []).append(dict(re.findall(r'([a-z_]+)="([^"]*)"', labels)))
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


@pytest.mark.parametrize("path", UNIT_TESTS, ids=lambda path: path.name)
def test_rules_say_and_alerts_do_what_their_unit_tests_want(promtool, path):
    """Recording rules and alerts pass promtool's unit tests."""
    run(promtool, "test", "rules", path)


def test_every_alert_is_seen_to_fire_and_to_clear():
    """The unit tests check each alert before it fires, while it fires and after it has cleared."""
    told: dict[str, set[str]] = {}
    for path in UNIT_TESTS:
        for case in yaml.safe_load(path.read_text())["tests"]:
            seen: dict[str, list[tuple[bool, bool]]] = {}
            for check in case.get("promql_expr_test", ()):
                if match := ALERTS.fullmatch(check["expr"]):
                    for name in match[1].split("|"):
                        seen.setdefault(name, []).append((bool(check["exp_samples"]), bool(match[2])))
            for name, checks in seen.items():
                fires = [i for i, (is_there, _) in enumerate(checks) if is_there]
                before = fires and (False, True) in checks[: fires[0]]
                gone = fires and (False, False) in checks[fires[-1] :]
                told.setdefault(name, set()).update({"before"} if before else (), {"gone"} if gone else ())
    wanted = {rule["alert"] for rule in rules(ALERTING)}
    assert {name for name, what in told.items() if what == {"before", "gone"}} == wanted


def test_every_metric_a_rule_names_is_exposed():
    """Every metric and label value in a rule is exposed; otherwise the rule would never fire."""
    series, recorded = exposed(), {rule["record"] for rule in rules(RECORDING)}
    for rule in rules(RECORDING) + rules(ALERTING):
        text = " ".join((rule["expr"], *rule.get("annotations", {}).values()))
        text = re.sub(r"etc/prometheus/\S+", "", text)
        code = " ".join((rule["expr"], *re.findall(r"`([^`]*)`", text)))
        for name in NAME.findall(code):
            assert name in series or name in recorded or name in OTHERS, (rule.get("alert", rule.get("record")), name)
        for level, name, matchers in SELECTOR.findall(code):
            for label, operator, value in re.findall(r'([a-z_]+)(=~|!=|!~|=)"([^"]*)"', matchers):
                known = {labels.get(label) for labels in series.get(level + name, ())}
                wanted = value.split("|") if "~" in operator else [value]
                assert set(wanted) <= known or label in ("instance", "job"), (name, label, wanted, known)


def test_every_alert_says_what_it_is_and_where_its_runbook_is():
    """Each alert has a severity, a summary that names the robot, a description and a runbook."""
    sections = set(re.findall(r"^### (\w+)$", (ETC / "RUNBOOKS.md").read_text(), flags=re.MULTILINE))
    for rule in rules(ALERTING):
        annotations = rule["annotations"]
        assert rule["labels"]["severity"] in ("critical", "warning", "info"), rule
        assert set(annotations) == {"summary", "description", "runbook"}, rule
        assert annotations["summary"].startswith("{{ $labels.instance }}: "), rule
        assert annotations["runbook"] == f"etc/prometheus/RUNBOOKS.md#{rule['alert'].lower()}"
    assert sections == {rule["alert"] for rule in rules(ALERTING)}


def test_the_runbooks_name_what_there_is():
    """The metrics, events and configuration keys in the runbooks exist."""
    text = (ETC / "RUNBOOKS.md").read_text()
    assert set(re.findall(r"\barpd_[a-z_]+", text)) <= set(exposed())
    assert set(re.findall(r"ARPD_EVENT=(\w+)", text)) <= set(EventKind)
    keys = set(re.findall(r"`((?:link|program|governor|http)\.[a-z_]+)`", text))
    document = yaml.safe_load((REPO / "etc/arpd/arpd.yaml").read_text())
    assert len(keys) >= 5
    assert all(key in document[section] for section, key in (name.split(".") for name in keys))
