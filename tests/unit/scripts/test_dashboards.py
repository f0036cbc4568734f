"""The Grafana dashboards ask for what there is, and are what `python -m scripts.dashboards` writes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from scripts.dashboards.document import as_json
from scripts.dashboards.fleet import fleet
from scripts.dashboards.robot import robot
from tests.golden.test_rules import RECORDING, exposed, rules

DASHBOARDS = Path(__file__).parents[3] / "etc" / "grafana" / "dashboards"
NAMES = sorted(path.stem for path in DASHBOARDS.glob("*.json"))
# Metrics of arpd and of the recording rules; what else a query names is PromQL's, or made by Prometheus itself.
METRIC = re.compile(r"\b(?:[a-z]+:)?arpd_[a-z0-9_]+(?::[a-z0-9_]+)?\b")


def expressions(node):
    """Yield every query of a dashboard, also those of its variables."""
    if isinstance(node, dict):
        yield from (node[key] for key in ("expr", "query") if isinstance(node.get(key), str))
        yield from (found for value in node.values() for found in expressions(value))
    elif isinstance(node, list):
        yield from (found for value in node for found in expressions(value))


@pytest.mark.parametrize("document", [robot(), fleet()], ids=lambda document: document["uid"])
def test_the_committed_json_is_what_the_script_writes(document):
    """Each dashboard's file is valid JSON, and that of the script."""
    text = (DASHBOARDS / f"{document['uid']}.json").read_text(encoding="utf-8")
    assert json.loads(text)["uid"] == document["uid"]
    assert text == as_json(document)


@pytest.mark.parametrize("name", NAMES)
def test_every_metric_asked_for_is_one_that_arpd_has(name):
    """No query names a metric that arpd does not expose and no rule records."""
    document = json.loads((DASHBOARDS / f"{name}.json").read_text(encoding="utf-8"))
    asked = {metric for expression in expressions(document) for metric in METRIC.findall(expression)}
    assert len(asked) > 10
    assert asked - {*exposed(), *(rule["record"] for rule in rules(RECORDING))} == set()
