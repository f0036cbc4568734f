"""Dashboards, rules and alerts ask for what arpd has, in PromQL that parses, and no panel hides another."""

from __future__ import annotations

import json
import re
import subprocess
from itertools import combinations
from pathlib import Path

import pytest
import yaml

from tests.golden.test_rules import ALERTING, RECORDING, exposed, rules

DASHBOARDS = Path(__file__).parents[2] / "etc" / "grafana" / "dashboards"
MOST_LINES = {"arpd-robot": 1500, "arpd-fleet": 600}
# Made by Prometheus itself.
OTHERS = {"up", "ALERTS"}
NOT_NAMES = {"and", "or", "unless", "bool", "Inf", "NaN"}
FREE_LABELS = {"instance", "job", "topic"}  # no exposition names their values
SELECTOR = re.compile(r"([a-zA-Z_:][\w:]*)\{([^}]*)\}")


def dashboard(name):
    return json.loads((DASHBOARDS / f"{name}.json").read_text(encoding="utf-8"))


def panels(name):
    """Return the panels of a dashboard, those under headings too, without the headings."""
    tops = dashboard(name)["panels"]
    return [panel for top in tops for panel in (top, *top.get("panels", ())) if panel["type"] != "row"]


def of_dashboard(name):
    """Return every query of a dashboard, also those of its variables and annotations."""
    document = dashboard(name)
    variables = [each["query"]["query"] for each in document["templating"]["list"] if each["type"] == "query"]
    annotations = [each["expr"] for each in document["annotations"]["list"]]
    return variables, annotations + [target["expr"] for panel in panels(name) for target in panel["targets"]]


def of_rules(path):
    """Return every query of a file of rules, also those in the texts of its alerts."""
    texts = [text for rule in rules(path) for text in rule.get("annotations", {}).values()]
    return [found for text in texts for found in re.findall(r"printf `([^`]*)`", text)], [
        rule["expr"] for rule in rules(path)
    ]


SOURCES = {
    "arpd-robot": lambda: of_dashboard("arpd-robot"),
    "arpd-fleet": lambda: of_dashboard("arpd-fleet"),
    "rules": lambda: of_rules(RECORDING),
    "alerts": lambda: of_rules(ALERTING),
}


def metrics_in(expression):
    """Return the names of the metrics in an expression: what is no function, keyword, label or text."""
    bare = re.sub(r"\{[^}]*\}|\[[^\]]*\]|\"[^\"]*\"|#.*", " ", expression)
    bare = re.sub(r"\b(by|without|on|ignoring|group_left|group_right)\s*\([^)]*\)", " ", bare)
    bare = re.sub(r"label_values\((.*),\s*\w+\)", r"\1", bare)
    return set(re.findall(r"(?<![\w:.])[a-zA-Z_:][\w:]*\b(?!\s*\()", bare)) - NOT_NAMES


@pytest.mark.parametrize("source", SOURCES)
def test_every_metric_asked_for_is_one_that_arpd_has(source):
    """No query names a metric or a label's value that arpd does not expose and no rule records."""
    series, known = exposed(), OTHERS | {rule["record"] for rule in rules(RECORDING)}
    asked = [query for queries in SOURCES[source]() for query in queries]
    names = {name for query in asked for name in metrics_in(query)}
    assert len(names) > 10
    assert names - known == names & set(series)
    for name, matchers in (found for query in asked for found in SELECTOR.findall(query) if found[0] in series):
        for label, operator, value in re.findall(r'(\w+)(=~|!=|!~|=)"([^"]*)"', matchers):
            values = {labels.get(label) for labels in series[name]}
            wanted = value.split("|") if "~" in operator else [value]
            assert label in FREE_LABELS or set(wanted) <= values, (name, label, wanted, values)


@pytest.mark.parametrize("name", MOST_LINES)
def test_every_query_of_a_dashboard_parses(name, promtool, tmp_path):
    """Promtool takes every query as a rule, with the variables filled in."""
    values = {"__range": "15m", "__rate_interval": "8s", "instance": "picker", "topic": ".+"}
    filled = [re.sub(r"\$(\w+)", lambda variable: values[variable[1]], query) for query in of_dashboard(name)[1]]
    as_rules = [{"record": f"query:{number}", "expr": query} for number, query in enumerate(filled)]
    path = tmp_path / "queries.yml"
    path.write_text(yaml.safe_dump({"groups": [{"name": "queries", "rules": as_rules}]}))
    checked = subprocess.run([promtool, "check", "rules", path], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout + checked.stderr


@pytest.mark.parametrize("name", MOST_LINES)
def test_the_panels_of_a_dashboard_stand_side_by_side(name):
    """Ids are unique, no two panels share a place, and each panel has one line of description, a unit and legends."""
    document = dashboard(name)
    tops = document["panels"]
    ids = [panel["id"] for top in tops for panel in (top, *top.get("panels", ()))]
    assert document["uid"] == name
    assert len(ids) == len(set(ids))
    for together in (tops, *(top["panels"] for top in tops if top["type"] == "row")):
        for one, other in combinations([panel["gridPos"] for panel in together], 2):
            apart = (
                one["x"] + one["w"] <= other["x"]
                or other["x"] + other["w"] <= one["x"]
                or one["y"] + one["h"] <= other["y"]
                or other["y"] + other["h"] <= one["y"]
            )
            assert apart, (one, other)
    for panel in panels(name):
        assert len(panel["description"].splitlines()) == 1, panel["title"]
        assert panel["fieldConfig"]["defaults"]["unit"], panel["title"]
        assert all(target["legendFormat"] for target in panel["targets"]), panel["title"]
    assert len((DASHBOARDS / f"{name}.json").read_text(encoding="utf-8").splitlines()) <= MOST_LINES[name]
