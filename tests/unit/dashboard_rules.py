"""The rules of https://github.com/grafana/dashboard-linter, under its names: each yields what it finds wrong.

They are written anew, because the linter is a Go program and nothing that the tests could install. Two are stricter:
every panel but a list of alerts needs a unit, and a description says what is bad and what to do.
"""

from __future__ import annotations

import re
from datetime import timedelta
from typing import Any

import promql_parser
from grafana_foundation_sdk.models import units

from tests.seeing.dashboards import fill_in, marks, panels, queries

# Durations that nobody would write, so that a parsed range still shows which variable it was.
RATE_INTERVAL, RANGE = timedelta(seconds=11277964), timedelta(seconds=11277965)
SENTINELS = {
    "job": "$job",
    "instance": "$instance",
    "topic": "$topic",
    "__rate_interval": f"{RATE_INTERVAL.total_seconds():.0f}s",
    "__range": f"{RANGE.total_seconds():.0f}s",
}


def parsed(query):
    return promql_parser.parse(fill_in(query.expression, SENTINELS))


def nodes(expression, kind):
    """Every node of a kind in a parsed expression, each with its ancestors, the nearest last."""
    found: list[Any] = []
    ancestors: list[Any] = []

    def enter(node):
        if isinstance(node, kind):
            found.append((node, tuple(ancestors)))
        ancestors.append(node)

    promql_parser.walk(expression, enter, lambda _: ancestors.pop() and None)
    return found


def of_every_query(document, kind):
    for query in queries(document):
        for node, ancestors in nodes(parsed(query), kind):
            yield query.where, node, ancestors


def variables(document, kind):
    return [variable for variable in document["templating"]["list"] if variable["type"] == kind]


def template_datasource_rule(document):
    found = [(each["name"], each["label"], each["query"]) for each in variables(document, "datasource")]
    if found != [("datasource", "Data source", "prometheus")]:
        yield f"data source variables are {found}"


def template_job_rule(document):
    yield from _chooses(document, "job")


def template_instance_rule(document):
    yield from _chooses(document, "instance")


def _chooses(document, name):
    found = [each for each in variables(document, "query") if each["name"] == name]
    if not found:
        yield f"no variable {name}"
        return
    wanted = {"label": name.title(), "multi": True, "allValue": ".+", "includeAll": True}
    for key, value in wanted.items():
        if found[0].get(key) != value:
            yield f"variable {name}: {key} is {found[0].get(key)}, not {value}"
    if found[0]["datasource"]["uid"] != "${datasource}":
        yield f"variable {name} asks another data source"


def template_label_promql_rule(document):
    for variable in variables(document, "query"):
        call = re.fullmatch(r"label_values\((.+), (\w+)\)", variable["query"]["query"])
        if call is None:
            yield f"variable {variable['name']}: {variable['query']['query']}"
        else:
            promql_parser.parse(call[1])


def template_on_time_change_reload_rule(document):
    for variable in variables(document, "query"):
        if variable["refresh"] != 2:
            yield f"variable {variable['name']} is not asked again when the time range changes"


def panel_datasource_rule(document):
    for panel in panels(document):
        for asks in (panel, *panel.get("targets", ())):
            if panel["type"] != "alertlist" and asks.get("datasource", {}).get("uid") != "${datasource}":
                yield f"{panel['title']}: data source {asks.get('datasource')}"


def panel_title_description_rule(document):
    for panel in panels(document):
        if not panel.get("title") or not re.fullmatch(
            r"[^*]+\n\n\*\*Bad:\*\* [^*]+\n\n\*\*Then:\*\* [^*]+", panel.get("description", "")
        ):
            yield f"{panel.get('title')}: {panel.get('description')}"


def panel_units_rule(document):
    for panel in panels(document):
        if panel["type"] != "alertlist" and panel["fieldConfig"]["defaults"].get("unit") not in vars(units).values():
            yield f"{panel['title']}: unit {panel['fieldConfig']['defaults'].get('unit')}"


def panel_no_targets_rule(document):
    for panel in panels(document):
        if panel["type"] != "alertlist" and not panel.get("targets"):
            yield f"{panel['title']}: asks nothing"


def target_promql_rule(document):
    for query in (*queries(document), *marks(document)):
        try:
            parsed(query)
        except ValueError as error:
            yield f"{query.where}: {error}"


def target_rate_interval_rule(document):
    for where, node, _ in of_every_query(document, promql_parser.Call):
        if node.func.name in {"rate", "irate"} and node.args[0].range != RATE_INTERVAL:
            yield f"{where}: {node.func.name} over {node.args[0].range}"


def target_job_rule(document):
    yield from _narrowed(document, "job")


def target_instance_rule(document):
    yield from _narrowed(document, "instance")


def _narrowed(document, label):
    for where, node, _ in of_every_query(document, promql_parser.VectorSelector):
        wanted = (label, promql_parser.MatchOp.Re, f"${label}")
        if wanted not in [(each.name, each.op, each.value) for each in node.matchers.matchers]:
            yield f"{where}: {node.name} is not narrowed to the chosen {label}"


def target_counter_agg_rule(document):
    for where, node, ancestors in of_every_query(document, promql_parser.VectorSelector):
        calls = [each.func.name for each in ancestors if isinstance(each, promql_parser.Call)]
        if re.search("_(total|bucket|sum|count)$", node.name) and not {"rate", "irate", "increase"} & set(calls):
            yield f"{where}: {node.name} is read as it is"


def target_histogram_rule(document):
    for where, node, ancestors in of_every_query(document, promql_parser.VectorSelector):
        calls = [each.func.name for each in ancestors if isinstance(each, promql_parser.Call)]
        if node.name.endswith("_bucket") and "histogram_quantile" not in calls:
            yield f"{where}: {node.name} outside of histogram_quantile"


def uneditable_dashboard(document):
    if document["editable"]:
        yield "can be edited"


LINT = {
    rule.__name__.replace("_", "-"): rule
    for rule in (
        template_datasource_rule,
        template_job_rule,
        template_instance_rule,
        template_label_promql_rule,
        template_on_time_change_reload_rule,
        panel_datasource_rule,
        panel_title_description_rule,
        panel_units_rule,
        panel_no_targets_rule,
        target_promql_rule,
        target_rate_interval_rule,
        target_job_rule,
        target_instance_rule,
        target_counter_agg_rule,
        target_histogram_rule,
        uneditable_dashboard,
    )
}
