"""Short form of the solver benchmark: it measures what docs/results.md claims."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).resolve().parents[2] / "scripts" / "bench" / "solve.py"
PAPER = "cvxpy, built anew"


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    out, plot = folder / "solve.json", folder / "solve.png"
    command = [sys.executable, BENCH, "--quick", "--json", out, "--plot", plot]
    finished = subprocess.run(command, capture_output=True, text=True, timeout=200, check=True)
    assert "median re-solve" in finished.stdout
    assert plot.read_bytes().startswith(b"\x89PNG")
    return json.loads(out.read_text())


@pytest.mark.parametrize(("side", "times"), [("OSQP, direct", 40), ("exact", 60)])
def test_a_re_solve_for_twelve_topics_beats_the_papers_way(bench, side, times):
    """In one interleaved run, OSQP is at least 40 and exact at least 60 times as fast as a new cvxpy problem."""
    (race,) = [race for race in bench["races"] if race["topics"] == 12]
    assert race["median_s"][PAPER] >= times * race["median_s"][side]


def test_our_back_ends_never_fail(bench):
    """Every back end of arpd is right on all instances of the benchmark."""
    for race in bench["races"]:
        assert {name: wrong for name, wrong in race["failed_or_wrong"].items() if name != PAPER and wrong} == {}


def test_the_daemons_solver_is_small(bench):
    """A process that solves with OSQP or exactly stays below 60 MiB before ROS, and never loads cvxpy."""
    for backend in ("osqp", "exact"):
        footprint = bench["footprints"][backend]
        assert footprint["peak_rss_bytes"] <= 60 * 2**20
        assert not footprint["loads_cvxpy"]
