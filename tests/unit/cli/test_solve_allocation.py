"""`arpd solve --config`: the daemon's plan, offline."""

from __future__ import annotations

import json
import subprocess
import sys
from functools import partial

import pytest

from arpd.model.settings import Backend
from tests.golden.sample import status_of

MBIT = 125_000.0  # bytes
SMALL = """\
program: {backend: closed_form}
topics:
  - {name: /scan, payload: 6kB, source_rate_hz: 20}
  - {name: /camera, payload: 30kB, source_rate_hz: 30, weight: 2, min_rate_hz: 2, max_rate_hz: 15}
  - {name: /cmd_vel, payload: 76B, source_rate_hz: 20, weight: 10, min_rate_hz: 20}
"""


@pytest.fixture
def solve(run):
    """Run ``arpd solve``."""
    return partial(run, "solve")


@pytest.fixture
def allocation(solve):
    """Run ``arpd solve --json`` and return its document, topics by name."""

    def allocation(*arguments):
        code, out, _ = solve(*arguments, "--json")
        assert code == 0
        document = json.loads(out)
        return document, {row["topic"]: row for row in document["topics"]}

    return allocation


@pytest.fixture
def status(tmp_path):
    """Save a status document, as ``arpd status --json > robot.json`` does."""

    def status(*rows, **document):
        path = tmp_path / "robot.json"
        path.write_text(json.dumps({"api_version": "v1", "topics": list(rows), **document}))
        return path

    return status


def measured(topic="/scan", **fields):
    publisher = {
        "topic": topic,
        "node": "/driver",
        "direction": "sensing",
        "payload_bytes": 6000.0,
        "source_rate_hz": 20.0,
        "remote_readers": 1,
        "type_name": "",
        "depth": 1,
        "baseline_depth": 1,
        **fields,
    }
    return {"topic": topic, "confirmed": publisher}


def test_several_capacities_are_a_list_or_columns(solve, config):
    """Each capacity has an allocation in JSON, and a column of rates in the table."""
    code, out, _ = solve("--config", config(), "--capacity", "0.5mbit,2mbit,54mbit", "--json")
    documents = json.loads(out)
    assert (code, [each["capacity_bytes_per_second"] / MBIT for each in documents]) == (0, [0.5, 2, 54])
    assert all(each["share"] <= 0.85 + 1e-9 for each in documents)
    _, out, _ = solve("--config", config(), "--capacity", "0.5mbit,54mbit")
    (scan,) = (line.split() for line in out.splitlines() if line.startswith("/scan"))
    assert scan[-1] == "20="
    assert "500 kbit/s: " in out  # what gave way there


def test_topics_of_which_nothing_is_known_are_left_out_and_named(solve, config):
    """These are entries without both keys and relayed topics without an entry; the note goes to stderr."""
    path = config(f"{SMALL}  - {{name: /odd, payload: 1kB}}\nrelay: {{topics: [{{name: /gps}}]}}\n")
    code, out, err = solve("--config", path, "--capacity", "2mbit")
    assert code == 0
    assert "for 3 topics" in out
    assert err.startswith("arpd: left out: /link/gps, /odd; ")
    assert json.loads(solve("--config", path, "--capacity", "2mbit", "--json")[1])["left_out"] == ["/link/gps", "/odd"]


def test_a_saved_status_says_what_topics_publish(allocation, config, status):
    """A measurement replaces an assumption; desired rates stay the configuration's; no DEADLINE exceeds a reader's."""
    path = status(
        measured("/scan", payload_bytes=500.0, source_rate_hz=40.0),
        measured("/scan", node="/other", payload_bytes=400.0, remote_readers=2),
        measured("/new", direction="actuation", requested_deadline_ns=30_000_000),
    )
    document, topics = allocation("--config", config(), "--status", path, "--capacity", "54mbit")
    assert list(topics) == ["/camera", "/cmd_vel", "/new", "/scan"]
    assert (topics["/scan"]["payload_bytes"], topics["/scan"]["source_rate_hz"], topics["/scan"]["copies"]) == (
        500.0,
        40.0,
        3,
    )
    assert topics["/camera"]["payload_bytes"] == 30_000.0
    assert (topics["/new"]["weight"], topics["/new"]["deadline_ns"]) == (1.0, 30_000_000)
    assert document["left_out"] == []


def test_a_real_status_document_is_understood(allocation, config, tmp_path, sample_snapshot):
    """The command reads what the daemon serves."""
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(status_of(sample_snapshot)))
    _, topics = allocation("--config", config("{}"), "--status", path, "--capacity", "5mbit")
    crossing = {p.topic for p in sample_snapshot.observation.publishers if p.direction != "local"}
    assert set(topics) == {p.topic for p in sample_snapshot.observation.publishers if p.topic in crossing}


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("", "is no status of arpd (file: "),
        ('{"api_version": "v1", "ready": false}', "was saved before"),
        (json.dumps({"api_version": "v1", "topics": [measured(), {}]}), "is no status of arpd (topics.1.confirmed: "),
        (
            json.dumps({"api_version": "v1", "topics": [measured(source_rate_hz=float("nan"))]}),
            "is no status of arpd (",
        ),
    ],
    ids=range(4),
)
def test_a_file_that_is_no_status_exits_1_with_its_place(solve, config, tmp_path, text, wrong):
    """The error names the file and the place in it."""
    path = tmp_path / "robot.json"
    path.write_text(text)
    code, out, err = solve("--config", config(), "--status", path, "--capacity", "5mbit")
    assert (code, out) == (1, "")
    assert err.startswith(f"arpd: {path}: {wrong}")
    assert err.strip().isprintable()


@pytest.mark.parametrize("command", [("solve", "--capacity", "5mbit", "--config"), ("check",)])
def test_solving_offline_needs_neither_ros_nor_matplotlib(config, command):
    """Solving and checking start fast and work on any computer."""
    script = (
        "import sys; from arpd.cli.main import main; main(); "
        "print(sorted({'rclpy', 'osqp', 'cvxpy', 'matplotlib'} & set(sys.modules)))"
    )
    ran = subprocess.run([sys.executable, "-c", script, *command, config()], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines()[-1] == "[]"


def test_every_back_end_prints_the_same_digits(allocation, config):
    """Rates and shares agree to a millionth, and each back end has found its own."""
    path, found = config(), {}
    for backend in Backend:
        document, found[backend] = allocation("--config", path, "--capacity", "2mbit", "--backend", backend)
        assert document["backend"] == backend
    for topics in found.values():
        for name, row in topics.items():
            for key in ("optimal_rate_hz", "share", "deadline_ns", "optimal_depth"):
                assert row[key] == pytest.approx(found[Backend.OSQP][name][key], rel=1e-6)
