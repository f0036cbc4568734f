"""Panels of a Grafana dashboard, by what is particular to each."""

from __future__ import annotations

import re
import string
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from scripts.dashboards.states import BLUE, GREEN, GREY, ORANGE, VERMILLION

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scripts.dashboards.states import StateSet

Json = dict[str, Any]

DATASOURCE: Json = {"type": "prometheus", "uid": "${datasource}"}
THIS_ROBOT = 'job=~"$job", instance=~"$instance"'
# A value below the first limit is good, one between them is on its way, one above the second is bad.
GOOD_TO_BAD = (GREEN, ORANGE, VERMILLION)
BAD_TO_GOOD = (VERMILLION, ORANGE, GREEN)


@dataclass(frozen=True, kw_only=True, slots=True)
class Advice:
    """A panel's description: what it shows, what of that is bad, and what to do then."""

    shows: str
    bad: str
    then: str

    def __str__(self) -> str:
        return f"{self.shows}\n\n**Bad:** {self.bad}\n\n**Then:** {self.then}"


def query(expression: str, legend: str = "") -> Json:
    """Return a range query; every selector is narrowed to the chosen job and instance."""
    return {
        "datasource": DATASOURCE,
        "editorMode": "code",
        "expr": _of_this_robot(expression),
        "legendFormat": legend or "__auto",
        "range": True,
    }


def instant(expression: str, legend: str = "") -> Json:
    """Return a query for now only, as one number per series."""
    return {**query(expression, legend), "instant": True, "range": False}


def rows(expression: str) -> Json:
    """Return a query for now only, as rows of a table with one column per label."""
    return {**instant(expression), "format": "table"}


def timeseries(
    title: str,
    advice: Advice,
    queries: Sequence[Json],
    *,
    unit: str,
    decimals: int | None = None,
    limits: tuple[float, float] | None = None,
    most: float | None = None,
    is_step: bool = False,
    is_stacked: bool = False,
    is_table: bool = False,
    colours: Json | None = None,
    links: Sequence[Json] = (),
) -> Json:
    """Return a chart of lines from zero up; ``limits`` are drawn as dashed lines, ``colours`` go by legend."""
    custom = {
        "drawStyle": "line",
        "fillOpacity": 30 if is_stacked else 5,
        "lineInterpolation": "stepAfter" if is_step else "linear",
        "lineWidth": 1,
        "showPoints": "never",
        "spanNulls": False,
        "stacking": {"group": "A", "mode": "normal" if is_stacked else "none"},
        "thresholdsStyle": {"mode": "dashed" if limits else "off"},
    }
    defaults = _defaults(unit, decimals=decimals, limits=limits, links=links)
    defaults.update(color={"mode": "palette-classic"}, custom=custom, min=0)
    if most is not None:
        defaults["max"] = most
    panel = _panel("timeseries", title, advice, queries, defaults=defaults, overrides=_coloured(colours or {}))
    panel["options"] = {
        "legend": _legend(is_table=is_table, calcs=["lastNotNull", "mean", "max"] if is_table else []),
        "tooltip": {"mode": "multi", "sort": "desc"},
    }
    return panel


def bars(title: str, advice: Advice, queries: Sequence[Json], *, links: Sequence[Json] = ()) -> Json:
    """Return a chart of how often something happened in each step of time, at least ten seconds long."""
    custom = {
        "drawStyle": "bars",
        "fillOpacity": 80,
        "lineWidth": 0,
        "showPoints": "never",
        "stacking": {"group": "A", "mode": "normal"},
    }
    defaults = _defaults("short", decimals=0, links=links)
    defaults.update(color={"mode": "palette-classic-by-name"}, custom=custom, min=0)
    panel = _panel("timeseries", title, advice, queries, defaults=defaults)
    panel["interval"] = "10s"
    panel["options"] = {
        "legend": _legend(is_table=True, calcs=["sum"]),
        "tooltip": {"mode": "multi", "sort": "desc"},
    }
    return panel


def stat(
    title: str,
    advice: Advice,
    queries: Sequence[Json],
    *,
    unit: str,
    decimals: int | None = None,
    limits: tuple[float, float] | None = None,
    colours: tuple[str, str, str] = GOOD_TO_BAD,
    states: StateSet | None = None,
    words: Json | None = None,
    missing: str = "",
) -> Json:
    """Return the last value, large; its colour says whether it is good.

    ``words`` are value mappings from a number to a text and a colour; ``missing`` stands where there is no value.
    """
    defaults = _defaults(unit, decimals=decimals, limits=limits, colours=colours)
    if missing:
        defaults["noValue"] = missing
    defaults["color"] = {"mode": "thresholds"}
    if states is not None:
        defaults["mappings"] = states.mappings
    if words is not None:
        defaults["mappings"] = [{"options": words, "type": "value"}]
    panel = _panel("stat", title, advice, queries, defaults=defaults)
    panel["options"] = {
        "colorMode": "value",
        "graphMode": "none" if states or words or queries[0].get("instant") else "area",
        "justifyMode": "auto",
        "orientation": "auto",
        "reduceOptions": {"calcs": ["lastNotNull"], "fields": "", "values": False},
        "showPercentChange": False,
        "textMode": "auto",
        "wideLayout": True,
    }
    return panel


def timeline(title: str, advice: Advice, parts: Sequence[tuple[Json, StateSet]], *, links: Sequence[Json] = ()) -> Json:
    """Return a chart of states over time, one row per series; each part has its query and what its numbers mean."""
    defaults = _defaults("short", decimals=0, links=links)
    defaults.update(color={"fixedColor": GREY, "mode": "fixed"}, custom={"fillOpacity": 80, "lineWidth": 0})
    overrides = []
    if len({states for _, states in parts}) == 1:
        defaults["mappings"] = parts[0][1].mappings
    else:
        overrides = [
            _override("byFrameRefID", ref_id, mappings=states.mappings)
            for ref_id, (_, states) in zip(string.ascii_uppercase, parts, strict=False)
        ]
    panel = _panel("state-timeline", title, advice, [each for each, _ in parts], defaults=defaults, overrides=overrides)
    panel["options"] = {
        "alignValue": "left",
        "legend": {**_legend(is_table=False, calcs=[]), "showLegend": False},
        "mergeValues": True,
        "rowHeight": 0.85,
        "showValue": "auto",
        "tooltip": {"mode": "single", "sort": "none"},
    }
    return panel


def ranking(
    title: str, advice: Advice, queries: Sequence[Json], *, unit: str, limits: tuple[float, float] | None = None
) -> Json:
    """Return one horizontal bar per series, for the time shown as a whole."""
    defaults = _defaults(unit, limits=limits)
    defaults.update(color={"mode": "thresholds"} if limits else {"fixedColor": BLUE, "mode": "fixed"}, min=0)
    panel = _panel("bargauge", title, advice, queries, defaults=defaults)
    panel["options"] = {
        "displayMode": "basic",
        "maxVizHeight": 300,
        "minVizHeight": 16,
        "minVizWidth": 8,
        "namePlacement": "auto",
        "orientation": "horizontal",
        "reduceOptions": {"calcs": ["lastNotNull"], "fields": "", "values": False},
        "showUnfilled": True,
        "sizing": "auto",
        "valueMode": "color",
    }
    return panel


@dataclass(frozen=True, kw_only=True, slots=True)
class Column:
    """A column of a table.

    Parameters
    ----------
    title : its heading
    expression : PromQL of its value; empty = the rows of the other columns have what it shows
    label : the label it shows; empty = the value itself
    unit, decimals, limits, states, missing : how a value is written and coloured, and what stands where none is
    width : pixels, 0 = whatever is left
    links : where a click on a value leads
    """

    title: str
    expression: str = ""
    label: str = ""
    unit: str = "short"
    decimals: int | None = None
    limits: tuple[float, float] | None = None
    colours: tuple[str, str, str] = GOOD_TO_BAD
    states: StateSet | None = None
    missing: str = ""
    width: int = 0
    links: Sequence[Json] = field(default=(), hash=False)

    def override(self) -> Json:
        """Return how Grafana is to show the column."""
        properties: Json = {"unit": self.unit, "noValue": self.missing or "–"}
        if self.decimals is not None:
            properties["decimals"] = self.decimals
        if self.limits is not None:
            properties["thresholds"] = _thresholds(self.limits, self.colours)
        if self.states is not None:
            properties["mappings"] = self.states.mappings_of_names if self.label else self.states.mappings
        if self.limits is not None or self.states is not None:
            properties["custom.cellOptions"] = {"type": "color-text"}
        if self.width:
            properties["custom.width"] = self.width
        if self.links:
            properties["links"] = list(self.links)
        return _override("byName", self.title, **properties)


def table(title: str, advice: Advice, columns: Sequence[Column], *, sort_by: str, is_descending: bool) -> Json:
    """Return a table of now: one row per set of labels that the queries of all columns share."""
    measured = [column for column in columns if column.expression]
    queries = [rows(column.expression) for column in measured]
    values = {column: f"Value #{ref}" for ref, column in zip(string.ascii_uppercase, measured, strict=False)}
    fields = {column.title: column.label or values[column] for column in columns}
    shown = {fields[column.title]: place for place, column in enumerate(columns)}
    defaults = {**_defaults("short"), "custom": {"align": "auto", "cellOptions": {"type": "auto"}, "inspect": False}}
    panel = _panel(
        "table", title, advice, queries, defaults=defaults, overrides=[column.override() for column in columns]
    )
    panel["options"] = {
        "cellHeight": "sm",
        "frameIndex": 0,
        "showHeader": True,
        "sortBy": [{"desc": is_descending, "displayName": sort_by}],
    }
    panel["transformations"] = [
        {"id": "merge", "options": {}},
        {"id": "filterFieldsByName", "options": {"include": {"names": list(shown)}}},
        {
            "id": "organize",
            "options": {
                "excludeByName": {},
                "indexByName": shown,
                "renameByName": {field: heading for heading, field in fields.items()},
            },
        },
    ]
    return panel


def alert_list(title: str, advice: Advice) -> Json:
    """Return the list of arpd's alerts that fire or are about to, as Grafana's alerting knows them."""
    return {
        "description": str(advice),
        "id": panel_id(title),
        "options": {
            "alertInstanceLabelFilter": '{instance=~"$instance"}',
            "alertName": "Arpd",
            "dashboardAlerts": False,
            "groupBy": [],
            "groupMode": "default",
            "maxItems": 20,
            "sortOrder": 3,
            "stateFilter": {"error": True, "firing": True, "noData": False, "normal": False, "pending": True},
            "viewMode": "list",
        },
        "title": title,
        "type": "alertlist",
    }


def repeated(panel: Json, variable: str) -> Json:
    """Return a panel that Grafana shows once for each chosen value of a variable."""
    return {**panel, "maxPerRow": 4, "repeat": variable, "repeatDirection": "h"}


def _panel(
    kind: str, title: str, advice: Advice, queries: Sequence[Json], *, defaults: Json, overrides: Sequence[Json] = ()
) -> Json:
    return {
        "datasource": DATASOURCE,
        "description": str(advice),
        "fieldConfig": {"defaults": defaults, "overrides": list(overrides)},
        "id": panel_id(title),
        "targets": [{**each, "refId": ref} for ref, each in zip(string.ascii_uppercase, queries, strict=False)],
        "title": title,
        "type": kind,
    }


def panel_id(title: str) -> int:
    """Return a number that stays when other panels come and go, so that links to the panel and diffs stay, too."""
    return zlib.crc32(title.encode()) % 1_000_000 + 1


def _of_this_robot(expression: str) -> str:
    return re.sub(r"\{(.*?)\}", lambda braces: f"{{{', '.join(filter(None, (THIS_ROBOT, braces[1])))}}}", expression)


def _defaults(
    unit: str,
    *,
    decimals: int | None = None,
    limits: tuple[float, float] | None = None,
    colours: tuple[str, str, str] = GOOD_TO_BAD,
    links: Sequence[Json] = (),
) -> Json:
    defaults: Json = {"thresholds": _thresholds(limits, colours), "unit": unit}
    if decimals is not None:
        defaults["decimals"] = decimals
    if links:
        defaults["links"] = list(links)
    return defaults


def _thresholds(limits: tuple[float, float] | None, colours: tuple[str, str, str]) -> Json:
    steps: list[Json] = [{"color": colours[0] if limits else BLUE, "value": None}]
    steps += [{"color": colour, "value": limit} for colour, limit in zip(colours[1:], limits or (), strict=False)]
    return {"mode": "absolute", "steps": steps}


def _legend(*, is_table: bool, calcs: list[str]) -> Json:
    return {
        "calcs": calcs,
        "displayMode": "table" if is_table else "list",
        "placement": "right" if is_table else "bottom",
        "showLegend": True,
    }


def _coloured(colours: Json) -> list[Json]:
    return [
        _override("byName", legend, color={"fixedColor": colour, "mode": "fixed"}) for legend, colour in colours.items()
    ]


def _override(matcher: str, options: str, **properties: Any) -> Json:
    return {
        "matcher": {"id": matcher, "options": options},
        "properties": [{"id": name, "value": value} for name, value in sorted(properties.items())],
    }
