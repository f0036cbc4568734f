"""The Grafana dashboards keep the linter's rules and a few of our own; the tests need no Grafana."""

from __future__ import annotations

import json
import re
from itertools import pairwise
from pathlib import Path

import promql_parser
import pytest
import yaml

from arpd.model.allocation import AllocationStatus, Binding
from arpd.model.link import CapacityKind, LinkState
from scripts.dashboards.document import as_json
from scripts.dashboards.fleet import fleet
from scripts.dashboards.robot import robot
from scripts.dashboards.states import STATE_SETS
from tests.golden.test_rules import RECORDING, exposed, rules
from tests.seeing.dashboards import GRAFANA, NAMES, load, marks, panels, queries
from tests.unit.dashboard_rules import LINT, nodes, parsed
from tests.unit.dashboard_types import strangers

REPO = Path(__file__).parents[3]
# Prometheus itself and prometheus_client make these.
FOREIGN_METRICS = re.compile(r"up|ALERTS|scrape_\w+|process_\w+")
RULES = {**LINT, "known-to-grafana": strangers}
DEPARTURES = {
    ("template-instance-rule", "arpd-robot"): "the dashboard is of one robot; two laid over each other answer nothing"
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("rule", RULES)
def test_the_linters_rules_hold(rule, name):
    """Each rule finds nothing in each dashboard, except for the listed departures, which must still exist."""
    complaints = list(RULES[rule](load(name)))
    assert bool(complaints) is ((rule, name) in DEPARTURES), "\n".join(complaints)


@pytest.mark.parametrize(
    ("rule", "good", "bad"),
    [
        ("template-datasource-rule", '"label": "Data source"', '"label": "Source"'),
        ("template-job-rule", '"allValue": ".+"', '"allValue": ".*"'),
        ("template-instance-rule", '"label": "Instance"', '"label": "Robot"'),
        ("template-label-promql-rule", "label_values(up{job=~", "label_names(up{job=~"),
        ("template-on-time-change-reload-rule", '"refresh": 2', '"refresh": 1'),
        ("panel-datasource-rule", '"uid": "${datasource}"', '"uid": "P1809F7CD0C75ACF3"'),
        ("panel-title-description-rule", "**Then:**", "Then"),
        ("panel-units-rule", '"unit": "bps"', '"unit": "megabits"'),
        ("panel-no-targets-rule", '"targets"', '"target"'),
        ("target-promql-rule", "sum by", "sum of"),
        ("target-rate-interval-rule", "[$__rate_interval]", "[$__range]"),
        ("target-job-rule", 'job=~\\"$job\\"', 'job=\\"arpd\\"'),
        ("target-instance-rule", 'instance=~\\"$instance\\"', 'instance=\\"$instance\\"'),
        ("target-counter-agg-rule", "increase(arpd_plans_total", "delta(arpd_plans_total"),
        ("target-histogram-rule", "histogram_quantile(0.99, ", "(0.99 * "),
        ("uneditable-dashboard", '"editable": false', '"editable": true'),
        ("known-to-grafana", '"unit":', '"units":'),
        ("known-to-grafana", '"fillOpacity": 80', '"fillOpacity": "80"'),
        ("known-to-grafana", '"editable": false', '"editable": 0'),
        ("known-to-grafana", '"showPoints": "never"', '"showPoints": "no"'),
        ("known-to-grafana", '"type": "value"', '"type": "values"'),
        ("known-to-grafana", '"type": "table"', '"type": "tables"'),
    ],
)
def test_each_rule_notices_what_it_is_for(rule, good, bad):
    """A dashboard with the fault of a rule does not pass it."""
    text = (GRAFANA / "dashboards" / "arpd-fleet.json").read_text(encoding="utf-8")
    assert good in text
    assert list(RULES[rule](json.loads(text.replace(good, bad))))


@pytest.mark.parametrize("document", [robot(), fleet()], ids=NAMES)
def test_the_committed_json_is_what_the_script_writes(document):
    """After a change, `python -m scripts.dashboards` must run."""
    path = GRAFANA / "dashboards" / f"{document['uid']}.json"
    assert path.read_text(encoding="utf-8") == as_json(document)


@pytest.mark.parametrize("name", NAMES)
def test_every_metric_asked_for_is_one_that_arpd_has(name):
    """No query names a metric that neither arpd nor Prometheus makes."""
    document = load(name)
    asked = {
        (query.where, node.name)
        for query in (*queries(document), *marks(document))
        for node, _ in nodes(parsed(query), promql_parser.VectorSelector)
    }
    known = {*exposed(), *(rule["record"] for rule in rules(RECORDING))}
    assert not [each for each in sorted(asked) if each[1] not in known and not FOREIGN_METRICS.fullmatch(each[1])]


@pytest.mark.parametrize("name", NAMES)
def test_panels_fill_the_grid_without_overlap(name):
    """Every line of panels is 24 columns wide, its panels are of one height, and the next line begins under it."""
    document = load(name)
    for shown in [document["panels"], *(row["panels"] for row in document["panels"] if row.get("collapsed"))]:
        lines: dict[int, list[dict[str, int]]] = {}
        for panel in shown:
            lines.setdefault(panel["gridPos"]["y"], []).append(panel["gridPos"])
        for line in lines.values():
            assert [place["x"] + place["w"] for place in line] == [*(place["x"] for place in line[1:]), 24]
            assert len({place["h"] for place in line}) == 1
        for (above, places), (below, _) in pairwise(sorted(lines.items())):
            hidden = sum(
                max(inside["gridPos"]["y"] + inside["gridPos"]["h"] for inside in row["panels"]) - above - 1
                for row in shown
                if row.get("collapsed") and row["gridPos"]["y"] == above
            )
            assert below == above + places[0]["h"] + hidden


@pytest.mark.parametrize("name", NAMES)
def test_panels_can_be_told_apart(name):
    """No two panels share a number or a title, so that links and advice lead to one panel."""
    document = load(name)
    everything = [*document["panels"], *panels(document)]
    identified = {(panel["id"], panel["title"]) for panel in everything}
    assert len({number for number, _ in identified}) == len({title for _, title in identified}) == len(identified)


def test_advice_names_panels_that_exist():
    """A title in quotes in a description is that of a panel."""
    titles = {panel["title"] for name in NAMES for panel in panels(load(name))}
    titles |= {panel["title"] for name in NAMES for panel in load(name)["panels"]}
    for name in NAMES:
        for panel in panels(load(name)):
            named = set(re.findall(r"'([A-Z][^']+)'", panel["description"]))
            assert named - titles <= {"Manage alerts via Alerting UI"}, panel["title"]


@pytest.mark.parametrize("name", NAMES)
def test_a_colour_by_name_is_of_a_series_that_exists(name):
    """Overrides by name match a legend, or a column of a table."""
    for panel in panels(load(name)):
        names = {target["legendFormat"] for target in panel.get("targets", ())}
        names |= {"rate", "price", "blocked", "failed", "closed"} if "{{cause}}" in names else set()
        for step in panel.get("transformations", ()):
            names |= set(step["options"].get("renameByName", {}).values())
        for override in panel.get("fieldConfig", {}).get("overrides", ()):
            if override["matcher"]["id"] == "byName":
                assert override["matcher"]["options"] in names, panel["title"]


@pytest.mark.parametrize("name", NAMES)
def test_columns_of_tables_are_what_the_queries_return(name):
    """Each column is a query's value or one of its labels, and the queries share a label to merge by."""
    for panel in panels(load(name)):
        if panel["type"] != "table":
            continue
        labels = {}
        for target in panel["targets"]:
            (grouping,) = re.findall(r"^\w+ by \(([^)]+)\)", target["expr"])
            labels[target["refId"]] = set(grouping.split(", "))
        there = {f"Value #{ref}" for ref in labels} | set.union(*labels.values())
        shown = panel["transformations"][1]["options"]["include"]["names"]
        assert set(shown) <= there, panel["title"]
        assert "topic" in set.intersection(*labels.values()) or "instance" in set.intersection(*labels.values())


@pytest.mark.parametrize(
    ("metric", "states"),
    [
        ("arpd_link_state", LinkState),
        ("arpd_link_capacity_kind", CapacityKind),
        ("arpd_allocation_status", AllocationStatus),
        ("arpd_allocation_binding", Binding),
        ("arpd_topic_rate_binding", Binding),
        ("arpd_topic_depth_binding", Binding),
    ],
)
def test_every_state_has_a_number_a_word_and_a_colour(metric, states):
    """Every state of arpd has words and a colour, and no two states look alike."""
    known = next(each for each in STATE_SETS if each.metric == metric)
    assert {state for state, _, _ in known.states} == set(states)
    assert len({words for _, words, _ in known.states}) == len({colour for *_, colour in known.states}) == len(states)


@pytest.mark.parametrize("name", NAMES)
def test_links_lead_to_a_dashboard_and_keep_the_time(name):
    """Links at the top and on values name one of our dashboards and keep the time range."""
    document = load(name)
    for link in document["links"]:
        assert link["url"].removeprefix("/d/").partition("?")[0] in NAMES
        assert link["keepTime"]
    urls = re.findall(r'"url": "(/d/[^"]+__url_time_range[^"]*)"', json.dumps(document))
    assert name == "arpd-robot" or urls
    for url in urls:
        assert url.startswith("/d/arpd-robot?var-datasource=${datasource}&var-job=")
        assert "&var-instance=" in url


def test_provisioning_is_what_grafana_reads():
    """The files name a Prometheus, its shipped scrape interval, and the folder of the comments."""
    source = yaml.safe_load((GRAFANA / "provisioning/datasources/arpd.yaml").read_text())
    scraped = yaml.safe_load((REPO / "etc/prometheus/prometheus.yml").read_text())["global"]["scrape_interval"]
    assert source["apiVersion"] == 1
    assert [(each["type"], each["jsonData"]["timeInterval"]) for each in source["datasources"]] == [
        ("prometheus", scraped)
    ]
    text = (GRAFANA / "provisioning/dashboards/arpd.yaml").read_text()
    provider = yaml.safe_load(text)["providers"][0]
    assert not provider["allowUiUpdates"]
    assert text.count(provider["options"]["path"]) == 3
