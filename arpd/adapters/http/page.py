"""The page at ``/``: the status document laid out by ``page.html``.

Without scripts it is a summary that reloads itself; ``assets/page.js`` keeps it up to date. ``assets/fields.js`` fills
the same places in the same way as this module; tests compare the two. In the template

- ``{{path|format}}`` stands for a value of the document,
- ``{{=path}}`` in a tag marks the element with the value, for the stylesheet,
- ``{{?path}}`` in a tag shows the element only while the value is true and not empty, ``{{!path}}`` only while not,
- ``<!-- rows path -->`` … ``<!-- end -->`` is repeated for each element of a list; inside, paths start at the element.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from arpd.model.quantities import format_cell

if TYPE_CHECKING:
    from collections.abc import Callable

_TEMPLATE = files("arpd.adapters.http").joinpath("page.html").read_text(encoding="utf-8")
_PLACE = re.compile(r"\{\{([=?!]?)([\w.]+)(?:\|(\w+))?\}\}")
_ROWS = re.compile(r"<!-- rows (\w+)( newest first)? -->\s*(.*?)\s*<!-- end -->", re.DOTALL)
_ABSENT = object()  # no such key, or the object around it is null
_STARTING = {
    "verdict": {"severity": "info", "headline": "Starting", "text": "Starting: no tick has finished yet"},
    "interface": "",
}


def render_page(status: dict[str, Any] | None, *, assets: str = "/assets/") -> str:
    """Return the page.

    Parameters
    ----------
    status : the status document (`arpd.report.status.status_document`), None before the first tick
    assets : path of the folder with scripts and styles, from the root
    """
    document = _STARTING if status is None else status
    template = _TEMPLATE.replace("{{assets}}", assets.removeprefix("/"))
    return _filled(_ROWS.sub(lambda rows: _rows(document, rows), template), document)


def _rows(document: dict[str, Any], rows: re.Match[str]) -> str:
    """Repeat a row for each element; an empty row stays in a template element for the script."""
    path, newest_first, row = rows.groups()
    elements = _value(document, path)
    elements = elements if isinstance(elements, list) else []
    order = ' data-order="newest first"' if newest_first else ""
    body = "".join(_filled(row, element) for element in (reversed(elements) if newest_first else elements))
    return f'<template data-rows="{path}"{order}>{_filled(row, {})}</template>{body}'


def _filled(markup: str, document: dict[str, Any]) -> str:
    def fill(place: re.Match[str]) -> str:
        sign, path, form = place.groups()
        value = _value(document, path)
        if sign == "=":
            return f'data-mark-field="{path}" data-mark="{escape(_text(value))}"'
        if sign:
            is_shown = (sign == "?") == _is_true(value)
            return f'data-{"show" if sign == "?" else "hide"}="{path}"{"" if is_shown else " hidden"}'
        text = escape(FORMATS[form](value))
        if form == "time":
            return f'<time data-field="{path}" data-format="time" datetime="{_iso(value)}">{text}</time>'
        return f'<span data-field="{path}" data-format="{form}">{text}</span>'

    return _PLACE.sub(fill, markup)


def _value(document: Any, path: str) -> Any:
    for key in path.split("."):
        document = document.get(key, _ABSENT) if isinstance(document, dict) else _ABSENT
    return document


def _is_true(value: Any) -> bool:
    return value is not _ABSENT and bool(value)


def _is_none(value: Any) -> bool:
    return value is _ABSENT or value is None or value == ""


def _text(value: Any) -> str:
    return "–" if _is_none(value) else str(value)


def _words(value: Any) -> str:
    return _text(value).replace("_", " ")


def _number(value: Any) -> str:
    return "–" if _is_none(value) else format_cell(value)


def _pace(value: Any) -> str:
    return "unpaced" if value is None else _number(value)


def _period(value: Any) -> str:
    return "none" if value is None else _number(value if value is _ABSENT else value * 1e-6)


def _with_unit(unit: str, scale: float) -> Callable[[Any], str]:
    return lambda value: "–" if _is_none(value) else f"{_number(value * scale)} {unit}"


def _counts(value: Any) -> str:
    return "" if not isinstance(value, dict) else ", ".join(f"{_words(k)} {n}" for k, n in value.items() if n)


def _list(value: Any) -> str:
    return ", ".join(map(_words, value)) if isinstance(value, list) else "–"


def _time(value: Any) -> str:
    return "–" if _is_none(value) else f"{datetime.fromtimestamp(value, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _iso(value: Any) -> str:
    return "" if _is_none(value) else datetime.fromtimestamp(value, UTC).isoformat(timespec="milliseconds")


def _named(names: dict[str, str]) -> Callable[[Any], str]:
    return lambda value: names.get(value, _text(value)) if isinstance(value, str) else "–"


_EVIDENCE = {
    "peer": "the peer",
    "local": "the interface's own queue",
    "radio": "the radio's bit rate",
    "configured": "the configuration",
}
_STATES = {"app_limited": "not filled"}
_SEVERITIES = {"info": "", "warning": "Warning:", "error": "Error:"}

FORMATS: dict[str, Callable[[Any], str]] = {
    "text": lambda value: "" if value == "" else _text(value),
    "words": _words,
    "number": _number,
    "count": _text,
    "pace": _pace,
    "period": _period,
    "mbit": _with_unit("Mbit/s", 8e-6),
    "ms": _with_unit("ms", 1e3),
    "age": _with_unit("s", 1.0),
    "percent": _with_unit("%", 100.0),
    "mebibytes": _with_unit("MiB", 2**-20),
    "counts": _counts,
    "list": _list,
    "time": _time,
    "evidence": _named(_EVIDENCE),
    "state": _named(_STATES),
    "severity": _named(_SEVERITIES),
}
