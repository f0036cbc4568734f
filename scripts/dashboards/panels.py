"""Panels of a Grafana dashboard: each function takes what differs between panels of its kind."""

from __future__ import annotations

import re
import string
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypedDict

from scripts.dashboards.states import BLUE, GREEN, GREY, ORANGE, VERMILLION

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Unpack

    from scripts.dashboards.states import StateSet

Json = dict[str, Any]

DATASOURCE: Json = {"type": "prometheus", "uid": "${datasource}"}
THIS_ROBOT = 'job=~"$job", instance=~"$instance"'
GOOD_TO_BAD = (GREEN, ORANGE, VERMILLION)
BAD_TO_GOOD = (VERMILLION, ORANGE, GREEN)


class Advice(TypedDict):
    """A panel's description: what it shows, which values are bad, and what to do then."""

    shows: str
    bad: str
    then: str


@dataclass(frozen=True, slots=True)
class Scale:
    """Unit, digits and colours of a panel's numbers.

    Parameters
    ----------
    unit : as Grafana names it
    decimals : digits after the point; None = as many as Grafana chooses
    limits : values at which the second and the third colour begin
    most : upper end of a chart; None = its largest value
    """

    unit: str = "short"
    decimals: int | None = None
    limits: tuple[float, float] | None = None
    colours: tuple[str, str, str] = GOOD_TO_BAD
    most: float | None = None

    @property
    def thresholds(self) -> Json:
        """Grafana's thresholds; without limits, everything is blue."""
        steps: list[Json] = [{"color": self.colours[0] if self.limits else BLUE, "value": None}]
        if self.limits:
            steps += [{"color": colour, "value": at} for colour, at in zip(self.colours[1:], self.limits, strict=True)]
        return {"mode": "absolute", "steps": steps}


COUNT = Scale("short", 0)
QUEUE_DELAY = Scale("s", 3, (0.1, 0.25))
ADMITTED = Scale("percentunit", 0, (0.5, 0.95), BAD_TO_GOOD)


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
    queries: Sequence[Json],
    scale: Scale,
    *,
    is_step: bool = False,
    is_stacked: bool = False,
    is_table: bool = False,
    colours: Json | None = None,
    links: Sequence[Json] = (),
    **advice: Unpack[Advice],
) -> Json:
    """Return a chart of lines from zero up; limits are dashed lines, ``colours`` go by legend."""
    custom = {
        "drawStyle": "line",
        "fillOpacity": 30 if is_stacked else 5,
        "lineInterpolation": "stepAfter" if is_step else "linear",
        "lineWidth": 1,
        "showPoints": "never",
        "spanNulls": False,
        "stacking": {"group": "A", "mode": "normal" if is_stacked else "none"},
        "thresholdsStyle": {"mode": "dashed" if scale.limits else "off"},
    }
    defaults = _defaults(scale, links)
    defaults.update(color={"mode": "palette-classic"}, custom=custom, min=0)
    if scale.most is not None:
        defaults["max"] = scale.most
    panel = _panel("timeseries", title, queries, advice, defaults=defaults, overrides=_coloured(colours or {}))
    panel["options"] = {
        "legend": _legend(is_table=is_table, calcs=["lastNotNull", "mean", "max"] if is_table else []),
        "tooltip": {"mode": "multi", "sort": "desc"},
    }
    return panel


def bars(title: str, queries: Sequence[Json], *, links: Sequence[Json] = (), **advice: Unpack[Advice]) -> Json:
    """Return a chart of the number of events in each step of time, at least ten seconds long."""
    custom = {
        "drawStyle": "bars",
        "fillOpacity": 80,
        "lineWidth": 0,
        "showPoints": "never",
        "stacking": {"group": "A", "mode": "normal"},
    }
    defaults = _defaults(COUNT, links)
    defaults.update(color={"mode": "palette-classic-by-name"}, custom=custom, min=0)
    panel = _panel("timeseries", title, queries, advice, defaults=defaults)
    panel["interval"] = "10s"
    panel["options"] = {"legend": _legend(is_table=True, calcs=["sum"]), "tooltip": {"mode": "multi", "sort": "desc"}}
    return panel


def stat(
    title: str,
    queries: Sequence[Json],
    scale: Scale,
    *,
    states: StateSet | None = None,
    words: Json | None = None,
    missing: str = "",
    **advice: Unpack[Advice],
) -> Json:
    """Return the last value, large; its colour says whether it is good.

    ``words`` map a number to a text and a colour; ``missing`` is the text where there is no value.
    """
    defaults = _defaults(scale)
    if missing:
        defaults["noValue"] = missing
    defaults["color"] = {"mode": "thresholds"}
    if states is not None:
        defaults["mappings"] = states.mappings
    if words is not None:
        defaults["mappings"] = [{"options": words, "type": "value"}]
    panel = _panel("stat", title, queries, advice, defaults=defaults)
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


def timeline(
    title: str, parts: Sequence[tuple[Json, StateSet]], *, links: Sequence[Json] = (), **advice: Unpack[Advice]
) -> Json:
    """Return a chart of states over time, one row per series; each part has its query and the states of its numbers."""
    defaults = _defaults(COUNT, links)
    defaults.update(color={"fixedColor": GREY, "mode": "fixed"}, custom={"fillOpacity": 80, "lineWidth": 0})
    overrides = []
    if len({states for _, states in parts}) == 1:
        defaults["mappings"] = parts[0][1].mappings
    else:
        overrides = [
            _override("byFrameRefID", ref_id, mappings=states.mappings)
            for ref_id, (_, states) in zip(string.ascii_uppercase, parts, strict=False)
        ]
    panel = _panel("state-timeline", title, [each for each, _ in parts], advice, defaults=defaults, overrides=overrides)
    panel["options"] = {
        "alignValue": "left",
        "legend": {**_legend(is_table=False, calcs=[]), "showLegend": False},
        "mergeValues": True,
        "rowHeight": 0.85,
        "showValue": "auto",
        "tooltip": {"mode": "single", "sort": "none"},
    }
    return panel


def ranking(title: str, queries: Sequence[Json], scale: Scale, **advice: Unpack[Advice]) -> Json:
    """Return one horizontal bar per series, for the whole time shown."""
    defaults = _defaults(scale)
    defaults.update(color={"mode": "thresholds"} if scale.limits else {"fixedColor": BLUE, "mode": "fixed"}, min=0)
    panel = _panel("bargauge", title, queries, advice, defaults=defaults)
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
    expression : PromQL of its value; empty = a label of the other columns' rows
    label : the label it shows; empty = the value itself
    missing : text where there is no value
    width : in pixels; 0 = the space that is left
    links : targets of a click on a value
    """

    title: str
    expression: str = ""
    label: str = ""
    scale: Scale = Scale()
    states: StateSet | None = None
    missing: str = ""
    width: int = 0
    links: Sequence[Json] = field(default=(), hash=False)

    def override(self) -> Json:
        """Return how Grafana is to show the column."""
        properties: Json = {"unit": self.scale.unit, "noValue": self.missing or "–"}
        if self.scale.decimals is not None:
            properties["decimals"] = self.scale.decimals
        if self.scale.limits is not None:
            properties["thresholds"] = self.scale.thresholds
        if self.states is not None:
            properties["mappings"] = self.states.mappings_of_names if self.label else self.states.mappings
        if self.scale.limits is not None or self.states is not None:
            properties["custom.cellOptions"] = {"type": "color-text"}
        if self.width:
            properties["custom.width"] = self.width
        if self.links:
            properties["links"] = list(self.links)
        return _override("byName", self.title, **properties)


def table(
    title: str, columns: Sequence[Column], *, sort_by: str, is_descending: bool, **advice: Unpack[Advice]
) -> Json:
    """Return a table of now: one row per set of labels that the queries of all columns share."""
    measured = [column for column in columns if column.expression]
    queries = [rows(column.expression) for column in measured]
    values = {column: f"Value #{ref}" for ref, column in zip(string.ascii_uppercase, measured, strict=False)}
    fields = {column.title: column.label or values[column] for column in columns}
    shown = {fields[column.title]: place for place, column in enumerate(columns)}
    defaults = {**_defaults(Scale()), "custom": {"align": "auto", "cellOptions": {"type": "auto"}, "inspect": False}}
    panel = _panel(
        "table", title, queries, advice, defaults=defaults, overrides=[column.override() for column in columns]
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


def alert_list(title: str, **advice: Unpack[Advice]) -> Json:
    """Return the list of arpd's alerts that fire or are pending, as Grafana's alerting knows them."""
    return {
        "description": _description(advice),
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
    kind: str, title: str, queries: Sequence[Json], advice: Advice, *, defaults: Json, overrides: Sequence[Json] = ()
) -> Json:
    return {
        "datasource": DATASOURCE,
        "description": _description(advice),
        "fieldConfig": {"defaults": defaults, "overrides": list(overrides)},
        "id": panel_id(title),
        "targets": [{**each, "refId": ref} for ref, each in zip(string.ascii_uppercase, queries, strict=False)],
        "title": title,
        "type": kind,
    }


def _description(advice: Advice) -> str:
    return f"{advice['shows']}\n\n**Bad:** {advice['bad']}\n\n**Then:** {advice['then']}"


def panel_id(title: str) -> int:
    """Return a number that depends on the title alone: links and diffs survive when other panels come and go."""
    return zlib.crc32(title.encode()) % 1_000_000 + 1


def _of_this_robot(expression: str) -> str:
    return re.sub(r"\{(.*?)\}", lambda braces: f"{{{', '.join(filter(None, (THIS_ROBOT, braces[1])))}}}", expression)


def _defaults(scale: Scale, links: Sequence[Json] = ()) -> Json:
    defaults: Json = {"thresholds": scale.thresholds, "unit": scale.unit}
    if scale.decimals is not None:
        defaults["decimals"] = scale.decimals
    if links:
        defaults["links"] = list(links)
    return defaults


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
