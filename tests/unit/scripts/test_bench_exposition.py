"""The benchmark of `/metrics`: both sides write as many samples, and arpd's costs no more than half as much again."""

import json
import subprocess
import sys
from typing import Any

import pytest

from scripts.bench.exposition import FORMATS, digest, race, table
from scripts.bench.exposition_daemon import crowded_daemon
from scripts.bench.record import REPO


@pytest.fixture(scope="module")
def found():
    return race(60, 9)


def test_both_sides_write_as_many_samples(found):
    """Only a few histograms' buckets and two infos are missing from prometheus_client's own metrics."""
    per_topic = 54
    assert found["samples"] > per_topic * 60
    assert 0 <= found["samples"] - found["library_samples"] < 0.1 * found["samples"]


def test_arpds_text_is_as_cheap_as_prometheus_clients(found):
    """In both formats arpd takes at most one and a half times as long as the library."""
    assert set(found["median_ratio"]) == set(FORMATS)
    for form in FORMATS:
        assert found["median_ratio"][form] <= 1.5  # about 0.3


def test_the_crowd_is_planned_for_and_announces_it():
    """The measured daemon is at work: every topic has a plan and announces it, and every tick is timed."""
    snapshot: Any = crowded_daemon(30).snapshot
    assert len(snapshot.decision.plan.topics) == snapshot.confirmed == 30
    durations = snapshot.totals.durations
    assert durations.ticks.up_to[-1][1] == snapshot.totals.ticks >= 35
    assert 1 < durations.solves.up_to[-1][1] <= 40
    assert durations.swap_phases["matching"].up_to[-1][1] == 0  # all of them finished before the daemon came


def test_the_daemon_answers_for_its_ticks_and_ends_with_its_parent():
    """Each line on stdin asks for the ticks since the last one; the daemon ends when stdin closes."""
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
                ticks += json.loads(process.stdout.readline())["late_s"]
            assert min(ticks) >= 0.0
            process.stdin.close()
            assert process.wait(30.0) == 0
        finally:
            process.kill()


def test_a_tick_is_late_from_half_a_period_on(found):
    """One of two ticks is 60 ms late; a daemon without scrapers has no scrape times, and the table is still made."""
    rounds = [{"late_s": [0.0, 0.06], "tick_s": [0.01, 0.02], "scrape_s": [0.1]}]
    scraped, quiet = digest(rounds), digest([{**rounds[0], "scrape_s": []}])
    assert scraped["late_share"] == quiet["late_share"] == 0.5
    assert (scraped["scrape_median_s"], quiet["scrape_median_s"]) == (0.1, None)
    assert table([found], {"topics": 60, "by_scrapers": {"0": quiet, "4": scraped}})
