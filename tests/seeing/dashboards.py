"""The Grafana dashboards for tests: their panels and queries, and Grafana's values of their variables."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

GRAFANA = Path(__file__).resolve().parents[2] / "etc" / "grafana"
NAMES = ("arpd-robot", "arpd-fleet")

Json = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Query:
    """One query of a panel, or of an annotation.

    Attributes
    ----------
    where : dashboard, panel and letter, for messages
    expression : PromQL with Grafana's variables
    is_instant : whether Grafana asks only for the present
    """

    where: str
    expression: str
    is_instant: bool


def load(name: str) -> Json:
    """Return a dashboard's document."""
    document: Json = json.loads((GRAFANA / "dashboards" / f"{name}.json").read_text(encoding="utf-8"))
    return document


def panels(document: Json) -> list[Json]:
    """Return all panels, also those under collapsed headings, without the headings."""
    found: list[Json] = []
    for panel in document["panels"]:
        found += panel["panels"] if panel["type"] == "row" else [panel]
    return found


def queries(document: Json) -> Iterator[Query]:
    """Yield the queries of the panels."""
    for panel in panels(document):
        for target in panel.get("targets", ()):
            yield Query(
                where=f"{document['uid']}, {panel['title']}, {target['refId']}",
                expression=target["expr"],
                is_instant=target.get("instant", False),
            )


def marks(document: Json) -> Iterator[Query]:
    """Yield the queries of the annotations."""
    for annotation in document["annotations"]["list"]:
        yield Query(where=f"{document['uid']}, {annotation['name']}", expression=annotation["expr"], is_instant=False)


def fill_in(expression: str, values: Mapping[str, str]) -> str:
    """Return an expression as Grafana sends it.

    Raises
    ------
    KeyError
        If a variable of the expression has no value.
    """
    return re.sub(r"\$(?:\{(\w+)\}|(\w+))", lambda variable: values[variable[1] or variable[2]], expression)


def as_opened(
    document: Json, ask: Callable[[str], list[tuple[dict[str, str], float]]], *, span_s: float
) -> dict[str, str]:
    """Return Grafana's values of the variables of a dashboard on opening.

    Parameters
    ----------
    ask : evaluates PromQL now
    span_s : shown time range (s)
    """
    values = {"__range": f"{span_s:.0f}s", "__rate_interval": "10s"}
    for variable in document["templating"]["list"]:
        if variable["type"] == "query":
            call = re.fullmatch(r"label_values\((.+), (\w+)\)", variable["query"]["query"])
            assert call is not None, variable["query"]
            offered = sorted(labels[call[2]] for labels, _ in ask(f"group by ({call[2]}) ({fill_in(call[1], values)})"))
            assert offered, f"{document['uid']}: nothing to choose for {variable['name']}"
            values[variable["name"]] = variable["allValue"] if variable["includeAll"] else offered[0]
    return values
