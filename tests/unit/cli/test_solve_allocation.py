"""`arpd solve --config`: the daemon's plan, offline."""

from __future__ import annotations

import json
import subprocess
import sys
from functools import partial

import pytest

from arpd.model.endpoints import Direction
from arpd.model.settings import Backend
from tests.sample_publishers import publisher
from tests.unit.fake_daemon import document

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
        plan = json.loads(out)
        return plan, {row["topic"]: row for row in plan["topics"]}

    return allocation


@pytest.fixture
def status(tmp_path):
    """Save the status of a daemon with these publishers, as ``arpd status --json > robot.json`` does."""

    def status(*publishers):
        path = tmp_path / "robot.json"
        path.write_text(json.dumps(document(observation={"publishers": publishers})))
        return path

    return status


def measured(topic="/scan", node="/driver", **fields):
    return publisher(node, topic, **{"payload_bytes": 6000.0, "source_rate_hz": 20.0, "remote_readers": 1} | fields)


def test_several_capacities_are_a_list_or_tables(solve, config):
    """Each capacity has an allocation in JSON, and a table of its own."""
    code, out, _ = solve("--config", config(), "--capacity", "0.5mbit,2mbit,54mbit", "--json")
    documents = json.loads(out)
    assert (code, [each["capacity_bytes_per_second"] / MBIT for each in documents]) == (0, [0.5, 2, 54])
    assert all(each["share"] <= 0.85 + 1e-9 for each in documents)
    _, out, _ = solve("--config", config(), "--capacity", "0.5mbit,54mbit")
    slow, fast = (line.split() for line in out.splitlines() if line.startswith("/scan"))
    assert (slow[5], fast[5]) == ("paused", "20")
    assert "gave way: " in out


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
        measured("/new", direction=Direction.ACTUATION, requested_deadline_ns=30_000_000),
    )
    plan, topics = allocation("--config", config(), "--status", path, "--capacity", "54mbit")
    assert list(topics) == ["/camera", "/cmd_vel", "/new", "/scan"]
    assert (topics["/scan"]["payload_bytes"], topics["/scan"]["source_rate_hz"], topics["/scan"]["copies"]) == (
        500.0,
        40.0,
        3,
    )
    assert topics["/camera"]["payload_bytes"] == 30_000.0
    assert (topics["/new"]["weight"], topics["/new"]["deadline_ns"]) == (1.0, 30_000_000)
    assert plan["left_out"] == []


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("[1]", "is no status of"),
        ('{"api_version": "v1", "ready": false}', "is no status of"),
        ('{"api_version": "v1", "topics": [{}]}', "says is of another version"),
    ],
    ids=range(3),
)
def test_a_file_that_is_no_status_exits_1(solve, config, tmp_path, text, wrong):
    """The error names the file, and what is wrong."""
    path = tmp_path / "robot.json"
    path.write_text(text)
    code, out, err = solve("--config", config(), "--status", path, "--capacity", "5mbit")
    assert (code, out) == (1, "")
    assert str(path) in err
    assert wrong in err
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
        plan, found[backend] = allocation("--config", path, "--capacity", "2mbit", "--backend", backend)
        assert plan["allocation"]["backend"] == backend
    for topics in found.values():
        for name, row in topics.items():
            for key in ("rate_hz", "share", "deadline_ns", "depth"):
                assert row[key] == pytest.approx(found[Backend.OSQP][name][key], rel=1e-6)
