"""Dataclasses as JSON and back, and the schema of such a document.

JSON has no infinity: a number that is infinite or unknown is null.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import cache
from typing import Any, TypeVar

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import to_json

_T = TypeVar("_T")

# Shown elsewhere in a document, or of no use outside the daemon; each has a default.
_HIDDEN = {
    "Allocation": {"topics", "price"},
    "PublisherState": {"announced_at_s"},
    "Totals": {"solves_by_outcome"},
}
_MAY_BE_INFINITE = {"age_s", "max_rate_hz", "paced_rate_hz", "queue_delay_s", "rate_hz", "share_per_weight"}


def plain(value: Any, name: str = "") -> Any:
    """Return the value of a key without dataclasses; times in milliseconds, other numbers in five digits."""
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, float):
        return round(value, 3) if name in {"unix_time_s", "times"} else float(f"{value:.5g}")
    if isinstance(value, tuple):
        return [plain(each, name) for each in value]
    if isinstance(value, Mapping):
        return {key: plain(each) for key, each in sorted(value.items())}
    return {key: plain(getattr(value, key), key) for key in _keys(value.__class__)}


def text(value: Any) -> bytes:
    """Return what `plain` returns as JSON."""
    return to_json(value, inf_nan_mode="null")


@cache
def _keys(kind: Any) -> tuple[str, ...]:
    hidden = _HIDDEN.get(kind.__name__, set())
    return tuple(each.name for each in fields(kind) if each.name not in hidden)


def read(kind: Callable[..., _T], document: object) -> _T:
    """Return a document of a kind as the daemon writes it.

    Raises
    ------
    pydantic.ValidationError
        If it is something else.
    """
    found: _T = _adapter(kind).validate_python(_with_infinities(document))
    return found


class _Schema(GenerateJsonSchema):
    def float_schema(self, schema: Any) -> dict[str, Any]:
        """Let every number be null: infinite or unknown."""
        return super().float_schema(schema) | {"type": ["number", "null"]}


@cache
def schema_of(kind: Any, name: str) -> bytes:
    """Return the JSON Schema (draft 2020-12) of a document."""
    schema = _adapter(kind).json_schema(mode="serialization", schema_generator=_Schema)
    head = {"$schema": _Schema.schema_dialect, "$id": f"{name}-v1.json"}
    return f"{json.dumps(head | schema | {'title': f'arpd {name}'}, indent=1)}\n".encode()


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    adapter: TypeAdapter[Any] = TypeAdapter(kind)
    # The dataclasses of model/ name each other's types for type checkers only.
    adapter.rebuild(raise_errors=True, _types_namespace=vars(sys.modules[kind.__module__]))
    return adapter


def _with_infinities(part: Any) -> Any:
    if isinstance(part, dict):
        return {
            key: math.inf if value is None and key in _MAY_BE_INFINITE else _with_infinities(value)
            for key, value in part.items()
        }
    return [_with_infinities(each) for each in part] if isinstance(part, list) else part
