"""The short form of every benchmark runs to its end, and leaves a sound document."""

from __future__ import annotations

import json
import subprocess

import pytest

from scripts.bench.record import REPO
from scripts.bench.suite import BENCHMARKS
from scripts.bench.swap import ADAPTIVE, EVENTS

pytestmark = pytest.mark.timeout(660)


def run(name, folder):
    """Run the short form of a benchmark as `scripts/bench/all --quick` does, and return its document."""
    (chosen,) = (each for each in BENCHMARKS if each.name == name)
    command = chosen.command(folder, is_quick=True)
    finished = subprocess.run(command, cwd=REPO, capture_output=True, text=True, timeout=600, check=False)
    assert finished.returncode == 0, finished.stdout + finished.stderr
    document = json.loads((folder / f"{name}.json").read_text())
    assert {"date", "python", "machine", "cpu_count", "load_average"} <= set(document["conditions"])
    return document


@pytest.mark.parametrize("name", [each.name for each in BENCHMARKS if each.name not in {"swap", "two_ends", "solve"}])
def test_a_benchmark_runs_to_its_end(name, tmp_path):
    """It exits with 0 and writes what it measured, and under which conditions."""
    assert len(run(name, tmp_path)) > 1


def test_swaps_lose_no_sample(tmp_path):
    """Neither a swap nor a soak of swaps loses, doubles or reorders a sample."""
    document = run("swap", tmp_path)
    assert [document["cells"][0]["ways"][ADAPTIVE][event] for event in EVENTS] == [0, 0, 0]
    soaked = document["soak"]
    assert soaked["notes"][-1]["swaps"] > 0
    assert soaked["sent"] > 0
    assert set(soaked["received"]) == {soaked["sent"]}


def test_two_ends_double_and_reorder_nothing_while_they_die(tmp_path):
    """Both ends die in several states; no sample comes twice or late, no set is torn, no late reader lacks one."""
    document = run("two_ends", tmp_path)
    assert document["ended_themselves"] == []
    for writer in (each for topic in document["topics"].values() for each in topic["writers"]):
        assert (writer["doubled"], writer["reordered"], writer["never_again"]) == (0, 0, 0)
        assert writer["received"] > 0
    assert document["sets"]["incomplete"] == document["sets"]["incomplete_beside_a_death"]
    assert not any(visit["lacks"] for visit in document["latched"] if not visit["meanwhile"])


def test_every_solver_solves_every_instance(tmp_path):
    """No back end fails at any instance or is ever wrong; only the paper's way may be."""
    for race in run("solve", tmp_path)["races"]:
        assert not any(count for name, count in race["failed_or_wrong"].items() if not name.startswith("the paper's"))
