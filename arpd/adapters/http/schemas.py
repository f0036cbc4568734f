"""The JSON Schemas of the API's documents, as they stand in ``arpd/adapters/http/schema``."""

from __future__ import annotations

from importlib.resources import files

_NAMES = ("status-v1.json", "history-v1.json")

SCHEMAS_BY_PATH = {
    f"/api/v1/schema/{name}": files("arpd.adapters.http").joinpath("schema", name).read_bytes() for name in _NAMES
}
