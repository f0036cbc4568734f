"""The short form of every benchmark runs to its end, and leaves a sound summary."""

import subprocess
import sys

import pytest

from scripts.bench.__main__ import SCENARIOS
from scripts.bench.report import REPO, Summary
from scripts.bench.swap import ADAPTIVE

pytestmark = pytest.mark.timeout(660)


def run(name, folder):
    """Run the short form of a benchmark, and return its summary."""
    command = [sys.executable, "-m", "scripts.bench", name, "--quick", "--out", str(folder)]
    finished = subprocess.run(command, cwd=REPO, capture_output=True, text=True, timeout=600, check=False)
    assert finished.returncode == 0, finished.stdout + finished.stderr
    return Summary.read(folder / f"{name}.json")


@pytest.mark.parametrize("name", [name for name in SCENARIOS if name not in {"swap", "faults", "solve"}])
def test_a_benchmark_runs_to_its_end(name, tmp_path):
    """It exits with 0, and says what it measured, when, at which commit, and under which load."""
    summary = run(name, tmp_path)
    assert summary.tables[0].rows
    assert {"date", "commit", "machine", "load"} <= set(summary.conditions[0])


def test_swaps_lose_no_sample(tmp_path):
    """Neither a swap nor a soak of swaps loses, doubles or reorders a sample, and the readers see the new writers."""
    summary = run("swap", tmp_path)
    assert not [each.what for each in summary.figures if each.target == 0 and each.value]
    columns = summary.tables[0].columns
    (row,) = (row for row in summary.tables[0].rows if ADAPTIVE in row)
    assert row[columns.index("seen")] >= row[columns.index("swaps")] > 0


def test_ends_and_daemons_that_die_double_and_reorder_nothing(tmp_path):
    """No sample is lost beside a break, doubled or late, no set is torn, no call runs twice, and all flows again."""
    summary = run("faults", tmp_path)
    assert not [each.what for each in summary.figures if each.target == 0 and each.value]


def test_every_solver_solves_every_instance(tmp_path):
    """No back end is ever wrong; only the paper's way may be."""
    summary = run("solve", tmp_path)
    assert not [each.what for each in summary.figures if each.target == 0 and each.value]
