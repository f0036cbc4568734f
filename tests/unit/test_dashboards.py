"""Dashboards, rules and alerts ask for what arpd has, in PromQL that parses."""

import json
import re
import subprocess
from pathlib import Path

import pytest
import yaml

from tests.golden.test_rules import ALERTING, RECORDING, exposed, rules

DASHBOARDS = Path(__file__).parents[2] / "etc" / "grafana" / "dashboards"
NAMES = ("arpd-robot", "arpd-fleet")
# Made by Prometheus itself.
OTHERS = {"up", "ALERTS"}
NOT_NAMES = {"and", "or", "unless", "bool", "Inf", "NaN"}
FREE_LABELS = {"instance", "job", "topic"}  # no exposition names their values
SELECTOR = re.compile(r"([a-zA-Z_:][\w:]*)\{([^}]*)\}")


def of_dashboard(name):
    """Return every query of a dashboard, also those of its variables and annotations."""
    document = json.loads((DASHBOARDS / f"{name}.json").read_text(encoding="utf-8"))
    panels = [panel for top in document["panels"] for panel in (top, *top.get("panels", ()))]
    variables = [each["query"]["query"] for each in document["templating"]["list"] if each["type"] == "query"]
    annotations = [each["expr"] for each in document["annotations"]["list"]]
    return variables, annotations + [target["expr"] for panel in panels for target in panel.get("targets", ())]


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


@pytest.mark.parametrize("name", NAMES)
def test_every_query_of_a_dashboard_parses(name, promtool, tmp_path):
    """Promtool takes every query as a rule, with the variables filled in."""
    values = {"__range": "15m", "__rate_interval": "8s", "instance": "picker", "topic": ".+"}
    filled = [re.sub(r"\$(\w+)", lambda variable: values[variable[1]], query) for query in of_dashboard(name)[1]]
    as_rules = [{"record": f"query:{number}", "expr": query} for number, query in enumerate(filled)]
    path = tmp_path / "queries.yml"
    path.write_text(yaml.safe_dump({"groups": [{"name": "queries", "rules": as_rules}]}))
    checked = subprocess.run([promtool, "check", "rules", path], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout + checked.stderr
