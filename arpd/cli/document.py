"""Reading a daemon's JSON, of whatever version and from whomever: what is missing, or no such thing, is none."""

from __future__ import annotations

import math
from typing import Any

from arpd.adapters.config.yaml_source import printable

_LONGEST = 400


def find(document: object, *keys: str) -> Any:
    """Return what stands under the keys, None where there is nothing."""
    for key in keys:
        if not isinstance(document, dict):
            return None
        document = document.get(key)
    return document


def number(document: object, *keys: str) -> float | None:
    """Return the finite number under the keys, None where there is none."""
    value = find(document, *keys)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:  # JSON's integers have no end
        return None


def count(document: object, *keys: str) -> int:
    """Return the count under the keys, 0 where there is none."""
    return int(number(document, *keys) or 0)


def text(document: object, *keys: str, longest: int = _LONGEST) -> str:
    """Return the text under the keys so that it cannot steer a terminal, empty where there is none."""
    value = find(document, *keys)
    return printable(value, longest=longest) if isinstance(value, str) else ""


def rows(document: object, *keys: str) -> list[dict[str, Any]]:
    """Return the objects of the list under the keys."""
    value = find(document, *keys)
    return [row for row in value if isinstance(row, dict)] if isinstance(value, list) else []


def texts(document: object, *keys: str) -> list[str]:
    """Return the texts of the list under the keys, as `text` does."""
    value = find(document, *keys)
    return (
        [printable(item, longest=_LONGEST) for item in value if isinstance(item, str)]
        if isinstance(value, list)
        else []
    )


def counts(document: object, *keys: str) -> dict[str, int]:
    """Return the counts by name under the keys that are not 0."""
    value = find(document, *keys)
    named = {printable(str(name)): count(value, name) for name in value} if isinstance(value, dict) else {}
    return {name: many for name, many in named.items() if many}


def series(document: object, *keys: str) -> list[float | None]:
    """Return the samples under the keys, None where there was nothing."""
    value = find(document, *keys)
    return [number({"": item}, "") for item in value] if isinstance(value, list) else []
