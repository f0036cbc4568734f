"""The JSON Schemas of the API's documents (draft 2020-12), made from their models when somebody asks."""

from __future__ import annotations

import json
from functools import cache
from typing import TYPE_CHECKING, Any

from arpd.web.api.history import History
from arpd.web.api.status import Status

if TYPE_CHECKING:
    from pydantic import BaseModel

_MODELS: dict[str, type[BaseModel]] = {"status": Status, "history": History}


@cache
def schema_of(name: str) -> bytes:
    """Return the schema of a document as JSON.

    Parameters
    ----------
    name : ``status`` or ``history``
    """
    model = _MODELS[name]
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"{name}-v1.json",
        **_tidied(model.model_json_schema(mode="serialization")),
        "title": f"arpd {name}",
    }
    return f"{json.dumps(schema, indent=1)}\n".encode()


def _tidied(part: Any) -> Any:
    """Leave out titles, docstrings of enumerations, which say no more to a client, and line breaks of the others."""
    if isinstance(part, list):
        return [_tidied(each) for each in part]
    if not isinstance(part, dict):
        return part
    is_enumeration = "enum" in part and "const" not in part
    return {
        key: " ".join(value.split()) if key == "description" and isinstance(value, str) else _tidied(value)
        for key, value in part.items()
        if not (isinstance(value, str) and (key == "title" or (key == "description" and is_enumeration)))
    }
