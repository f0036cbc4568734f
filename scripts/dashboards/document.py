"""A Grafana dashboard as a document: its variables, annotations and links, and the places of its panels."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from scripts.dashboards.panels import DATASOURCE, THIS_ROBOT, Json, panel_id
from scripts.dashboards.states import BLUE, GREY, ORANGE, PINK, VERMILLION

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

FOLDER = Path(__file__).resolve().parents[2] / "etc" / "grafana" / "dashboards"
COLUMNS = 24
# What Grafana 10.0 writes; later versions migrate it on reading.
_SCHEMA_VERSION = 38
_ON_TIME_RANGE_CHANGE = 2
_SHARED_CROSSHAIR = 1

_ANNOTATIONS = (
    ("Plans", BLUE, "new plan", "plan"),
    ("Swaps", PINK, "QoS swap", "swap|swap_failed"),
    ("Outages", VERMILLION, "link", "outage|recovered"),
    ("Reloads", ORANGE, "configuration", "reloaded|reload_failed"),
    ("Starts", GREY, "daemon", "started|standing_by|in_charge"),
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Section:
    """A row of the dashboard with a heading.

    Parameters
    ----------
    title : the heading
    lines : height (grid units) and panels with their widths (of 24 columns) of each line
    is_collapsed : whether a click opens it
    """

    title: str
    lines: Sequence[tuple[int, Sequence[tuple[int, Json]]]] = field(default_factory=tuple)
    is_collapsed: bool = False


def dashboard(
    *,
    uid: str,
    title: str,
    description: str,
    since: str,
    variables: Sequence[Json],
    sections: Sequence[Section],
    links: Sequence[Json],
) -> Json:
    """Return the document."""
    return {
        "annotations": {"list": [_annotation(*each) for each in _ANNOTATIONS]},
        "description": description,
        "editable": False,
        "fiscalYearStartMonth": 0,
        "graphTooltip": _SHARED_CROSSHAIR,
        "id": None,
        "links": list(links),
        "panels": list(_placed(sections)),
        "refresh": "10s",
        "schemaVersion": _SCHEMA_VERSION,
        "tags": ["arpd", "ros2"],
        "templating": {"list": [_datasource_variable(), *variables]},
        "time": {"from": since, "to": "now"},
        "timepicker": {"refresh_intervals": ["5s", "10s", "30s", "1m", "5m"]},
        "timezone": "browser",
        "title": title,
        "uid": uid,
        "version": 1,
        "weekStart": "",
    }


def as_json(document: Json) -> str:
    """Return a document as it is committed: with sorted keys, for small diffs."""
    return json.dumps(document, indent=2, sort_keys=True, ensure_ascii=False) + "\n"


def choice(name: str, metric: str, matchers: str = "", *, label: str, is_multiple: bool) -> Json:
    """Return a variable that takes its values from a label of a metric."""
    source = f"label_values({metric}{{{matchers}}}, {name})" if matchers else f"label_values({metric}, {name})"
    many = {"allValue": ".+", "current": {"selected": True, "text": ["All"], "value": ["$__all"]}}
    return {
        **(many if is_multiple else {}),
        "datasource": DATASOURCE,
        "hide": 0,
        "includeAll": is_multiple,
        "label": label,
        "multi": is_multiple,
        "name": name,
        "options": [],
        "query": {"qryType": 1, "query": source, "refId": f"arpd-{name}"},
        "refresh": _ON_TIME_RANGE_CHANGE,
        "regex": "",
        "skipUrlSync": False,
        "sort": 1,
        "type": "query",
    }


def evenly(*panels: Json) -> list[tuple[int, Json]]:
    """Return panels of equal width that fill a line."""
    return [(COLUMNS // len(panels), panel) for panel in panels]


def link_to_dashboard(uid: str, title: str, tooltip: str) -> Json:
    """Return a link at the top of a dashboard that keeps the time range and the data source."""
    return {
        "asDropdown": False,
        "icon": "dashboard",
        "includeVars": False,
        "keepTime": True,
        "tags": [],
        "targetBlank": False,
        "title": title,
        "tooltip": tooltip,
        "type": "link",
        "url": f"/d/{uid}?var-datasource=${{datasource}}",
    }


def _datasource_variable() -> Json:
    return {
        "hide": 0,
        "includeAll": False,
        "label": "Data source",
        "multi": False,
        "name": "datasource",
        "options": [],
        "query": "prometheus",
        "refresh": 1,
        "regex": "",
        "skipUrlSync": False,
        "type": "datasource",
    }


def _annotation(name: str, colour: str, title: str, events: str) -> Json:
    matchers = f'{{{THIS_ROBOT}, event=~"{events}"}}'
    return {
        "datasource": DATASOURCE,
        "enable": True,
        "expr": f"sum by (instance, event) (increase(arpd_events_total{matchers}[$__rate_interval])) > 0",
        "hide": False,
        "iconColor": colour,
        "name": name,
        "step": "2s",
        "tagKeys": "instance",
        "textFormat": "{{event}}",
        "titleFormat": title,
    }


def _placed(sections: Sequence[Section]) -> Iterator[Json]:
    """Yield headings and panels with their places, from top to bottom; a collapsed heading holds its panels."""
    y = 0
    for section in sections:
        heading = {
            "collapsed": section.is_collapsed,
            "gridPos": {"h": 1, "w": COLUMNS, "x": 0, "y": y},
            "id": panel_id(section.title),
            "panels": [],
            "title": section.title,
            "type": "row",
        }
        y += 1
        panels = []
        for height, line in section.lines:
            x = 0
            for width, panel in line:
                panels.append({**panel, "gridPos": {"h": height, "w": width, "x": x, "y": y}})
                x += width
            y += height
        if section.is_collapsed:
            yield {**heading, "panels": panels}
        else:
            yield heading
            yield from panels
