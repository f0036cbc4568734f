"""`arpd solve --config`: the daemon's plan, offline."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

MBIT = 125_000.0  # bytes
SMALL = """\
program: {backend: closed_form}
topics:
  - {name: /scan, payload: 6kB, source_rate_hz: 20}
  - {name: /camera, payload: 30kB, source_rate_hz: 30, weight: 2, min_rate_hz: 2, max_rate_hz: 15}
  - {name: /cmd_vel, payload: 76B, source_rate_hz: 20, weight: 10, min_rate_hz: 20}
"""


def test_several_capacities_are_a_list_or_tables(run, config):
    """Each capacity has an allocation in JSON, and a table of its own."""
    code, out, _ = run("solve", "--config", config(), "--capacity", "0.5mbit,2mbit,54mbit", "--json")
    documents = json.loads(out)
    assert (code, [each["capacity_bytes_per_second"] / MBIT for each in documents]) == (0, [0.5, 2, 54])
    assert all(each["share"] <= 0.85 + 1e-9 for each in documents)
    _, out, _ = run("solve", "--config", config(), "--capacity", "0.5mbit,54mbit")
    slow, fast = (line.split() for line in out.splitlines() if line.startswith("/scan"))
    assert (slow[5], fast[5]) == ("paused", "20")
    assert "gave way: " in out


def test_topics_of_which_nothing_is_known_are_left_out(run, config):
    """With none there is nothing to plan, and the file is wrong."""
    path = config(f"{SMALL}  - {{name: /odd, payload: 1kB}}\n")
    assert "for 3 topics" in run("solve", "--config", path, "--capacity", "2mbit")[1]
    code, out, err = run("solve", "--config", config("topics: [{name: /odd, payload: 1kB}]"), "--capacity", "2mbit")
    assert (code, out, err.startswith(f"{path}:1:1: topics: no topic has")) == (78, "", True)


@pytest.mark.parametrize("command", [("solve", "--capacity", "5mbit", "--config"), ("check",)])
def test_solving_offline_needs_neither_ros_nor_matplotlib(config, command):
    """Solving and checking start fast and work on any computer."""
    script = (
        "import sys; from arpd.cli.main import main; main(); "
        "print(sorted({'rclpy', 'osqp', 'cvxpy', 'matplotlib'} & set(sys.modules)))"
    )
    ran = subprocess.run([sys.executable, "-c", script, *command, config()], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines()[-1] == "[]"
