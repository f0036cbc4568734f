"""The API's documents against their schemas, and against the keys of earlier versions."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from jsonschema import Draft202012Validator

from arpd.model.allocation import AllocationStatus
from arpd.report.conditions import Happening, Severity
from arpd.report.events import Event
from arpd.report.history import History
from arpd.web.api.history import history_json
from arpd.web.api.schemas import schema_of
from tests.golden.sample import status_of

KEYS = Path(__file__).parents[2] / "golden" / "api-v1-keys.yml"
SCHEMAS = {name: json.loads(schema_of(name)) for name in ("status", "history")}
EVENT = Event(
    number=7,
    at_s=1000.0,
    unix_time_s=1.7e9,
    kind=Happening.PLAN,
    severity=Severity.WARNING,
    text="link fell to 4.8 Mbit/s: /camera/image 30 → 2.1 Hz",
    details={"generation": "3"},
)


@pytest.fixture
def documents(sample_snapshot):
    """Return documents of every kind of daemon, by name: (status, history)."""
    history = History()
    history.note(sample_snapshot)
    told = replace(sample_snapshot, events=(EVENT,))
    observation = replace(sample_snapshot.observation, publishers=(), counters=None, peer_ages_s={}, rmw="", taken=None)
    allocation = replace(sample_snapshot.allocation, topics=(), status=AllocationStatus.EMPTY)
    empty = replace(sample_snapshot, observation=observation, allocation=allocation)
    return {
        "golden": (status_of(told, now_s=1000.25), b"".join(history_json(history.samples, (EVENT,)))),
        "empty": (status_of(empty, is_ready=False), b"".join(history_json((), ()))),
    }


def strict(schema):
    """Return the schema, but a key it does not describe is a fault."""
    if isinstance(schema, list):
        return [strict(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    closed = {"additionalProperties": False} if "properties" in schema else {}
    return closed | {key: strict(value) for key, value in schema.items()}


def described(schema, root, path=""):
    """Yield every key that the schema describes, as a path, with its part of the schema."""
    for way in ("allOf", "anyOf"):  # pydantic writes "or null" so
        schema = {**next((each for each in schema.get(way, ()) if each.get("type") != "null"), {}), **schema}
    if "$ref" in schema:
        schema = {**root["$defs"][schema["$ref"].removeprefix("#/$defs/")], **schema}
    yield path, schema
    for key, inner in schema.get("properties", {}).items():
        yield from described(inner, root, f"{path}.{key}")
    if isinstance(schema.get("items"), dict):
        yield from described(schema["items"], root, f"{path}.[]")


@pytest.mark.parametrize("kind", ["golden", "empty"])
@pytest.mark.parametrize("name", SCHEMAS)
def test_documents_fit_their_schema_and_hold_nothing_else(documents, kind, name):
    """Status and history of a full and an empty daemon are valid, and every key is described."""
    status, history = documents[kind]
    document = status if name == "status" else json.loads(history)
    faults = [
        f"{error.json_path}: {error.message}"
        for error in Draft202012Validator(strict(SCHEMAS[name])).iter_errors(document)
    ]
    assert not faults


def test_keys_of_v1_are_only_added():
    """Every key that v1 ever had is there and required; a new one is added to the list."""
    now = {}
    for name, schema in SCHEMAS.items():
        for path, inner in described(schema, schema):
            keys = sorted(inner.get("properties", ()))
            assert sorted(inner.get("required", ())) == keys, f"{name}{path}"
            now |= {f"{name}{path}": " ".join(keys)} if keys else {}
    assert now == yaml.safe_load(KEYS.read_text())
