"""The benchmark of `/metrics`: both sides write as many samples, and arpd's costs no more than half as much again."""

import json
import subprocess
import sys
from typing import Any

import pytest

from scripts.bench.exposition import ARPD, FORMATS, LIBRARY, SCRAPERS, digest, race, table
from scripts.bench.exposition_daemon import crowded_daemon
from scripts.bench.record import REPO


@pytest.fixture(scope="module")
def found():
    return race(60, 9)


def test_both_sides_write_as_many_samples(found):
    """What prometheus_client's own metrics leave out is a few histograms' buckets and two infos."""
    per_topic = 54
    assert found["samples"] > per_topic * 60
    assert 0 <= found["samples"] - found["library_samples"] < 0.1 * found["samples"]


def test_arpds_text_is_as_cheap_as_prometheus_clients(found):
    """In either format a turn of arpd's takes at most one and a half of the same turn of the library's."""
    assert set(found["median_ratio"]) == set(FORMATS)
    for form in FORMATS:
        assert found["median_ratio"][form] <= 1.5  # about 0.3


def test_the_crowd_is_planned_for_and_announces_it():
    """What is measured is a daemon at work: every topic has a plan and announces it, and every tick is timed."""
    snapshot: Any = crowded_daemon(30).snapshot
    assert len(snapshot.decision.plan.topics) == snapshot.confirmed == 30
    durations = snapshot.totals.durations
    assert durations.ticks.up_to[-1][1] == snapshot.totals.ticks == 40
    assert 1 < durations.solves.up_to[-1][1] <= 40
    assert durations.swap_phases["matching"].up_to[-1][1] == 0  # all of them finished before the daemon came


def test_the_daemon_answers_for_its_ticks_and_ends_with_its_parent():
    """Each line asks what the ticks since the last one were like; it ends when nobody can ask any more."""
    process: Any = subprocess.Popen(
        [sys.executable, "-m", "scripts.bench.exposition_daemon", "3"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=REPO,
    )
    with process:
        try:
            assert json.loads(process.stdout.readline())["url"].startswith("http://127.0.0.1:")
            ticks: list[float] = []
            while len(ticks) < 3:
                print(file=process.stdin, flush=True)
                told = json.loads(process.stdout.readline())
                ticks += told["late_s"]
            assert min(ticks) >= 0.0
            process.stdin.close()
            assert process.wait(30.0) == 0
        finally:
            process.kill()


def test_the_table_has_a_row_for_everything(found):
    """A line for each size and format, and one for each number of scrapers."""
    rounds = [{"late_s": [0.0, 0.06], "tick_s": [0.01, 0.02], "scrape_s": [0.1]}]
    quiet = [{**rounds[0], "scrape_s": []}]
    by_scrapers = {str(scrapers): digest(rounds if scrapers else quiet) for scrapers in SCRAPERS}
    lines = table([found], {"topics": 60, "by_scrapers": by_scrapers}).splitlines()
    assert [line.split()[0] for line in lines if line.split()[:1] == ["60"]] == ["60"] * len(FORMATS)
    assert all(side in lines[0] for side in (ARPD, LIBRARY.split("_")[0]))
    assert [line.split()[2] for line in lines[-len(SCRAPERS) :]] == ["50.0%"] * len(SCRAPERS)
