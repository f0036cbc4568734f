"""The API's documents against their schemas, and the keys of earlier versions."""

import json
import math
import re
from pathlib import Path

import pytest
import yaml
from jsonschema import Draft202012Validator

from arpd.model.allocation import AllocationStatus, Uniform
from arpd.report.history import History as Past
from arpd.web.api import history_json
from tests.golden.sample import EVENT, changed, status_of
from tests.unit.web_world import running

KEYS = Path(__file__).parents[2] / "golden" / "api-v1-keys.yml"
KINDS = ("status", "history")


@pytest.fixture
def documents(sample_snapshot):
    """Return documents of every kind of daemon, by name: those of one with everything, and of an empty one."""
    past = Past()
    past.note(sample_snapshot)
    uniform = Uniform(topics=3, max_rate_hz=9.0, rate_hz=3.0, depth=5)
    full = changed(events=(EVENT,), allocation={"uniform": uniform}, config_error="line 3: unknown key")
    empty = changed(
        observation={"publishers": (), "counters": None, "peer_ages_s": {}, "rmw": "", "refused": {}},
        allocation={"topics": (), "status": AllocationStatus.EMPTY},
        link={"age_s": math.inf, "queue_delay_s": math.nan, "loss_ratio": None},
    )
    return {
        "full": {
            "status": status_of(full, now_s=1000.25),
            "history": json.loads(history_json(past.samples, (EVENT,))),
        },
        "empty": {"status": status_of(empty, now_s=1000.25), "history": json.loads(history_json((), ()))},
    }


def strict(schema):
    """Return the schema, but a key it does not describe is a fault."""
    if isinstance(schema, list):
        return [strict(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    closed = {"additionalProperties": False} if "properties" in schema else {}
    return closed | {key: strict(value) for key, value in schema.items()}


def keys_of(part, path):
    """Yield the keys of every object of a document, by its path; a mapping from what a run meets is no object."""
    if isinstance(part, dict) and not re.search(r"(_by_\w+|details|refused|calls_failed)$", path):
        yield path, " ".join(sorted(part))
        for key, value in part.items():
            yield from keys_of(value, f"{path}.{key}")
    elif isinstance(part, list) and part:
        yield from keys_of(part[0], f"{path}.[]")


@pytest.mark.parametrize("name", KINDS)
def test_documents_fit_their_schema_and_hold_nothing_else(documents, name):
    """Status and history of a full and an empty daemon are valid, and every key is described."""
    with running() as world:
        schema = json.loads(world.get(f"/api/v1/schema/{name}-v1.json").text)
    validator = Draft202012Validator(strict(schema))
    for extent in documents.values():
        assert not [f"{each.json_path}: {each.message}" for each in validator.iter_errors(extent[name])]


def test_keys_of_v1_are_only_added(documents):
    """Every key that v1 ever had is there; a new one is added to the list."""
    found = dict(pair for name in KINDS for pair in keys_of(documents["full"][name], name))
    assert found == yaml.safe_load(KEYS.read_text())
