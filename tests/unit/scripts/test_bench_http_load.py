"""The benchmark of the HTTP server: its daemon is at work, and its figures are what the daemon counts meanwhile."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

from scripts.bench.crowded_daemon import crowded_daemon
from scripts.bench.http_load import counts, digest, report
from scripts.bench.record import REPO
from tests.waiting import eventually


def test_the_crowd_is_planned_for_and_announces_it():
    """The measured daemon is at work: every topic has a plan and announces it, and every tick is timed."""
    daemon: Any = crowded_daemon(30)
    for tick in range(100):  # a turn that took long is followed by 2 s of rest
        daemon.tick(0.1 * tick)
    snapshot = daemon.snapshot
    assert len(snapshot.decision.plan.topics) == snapshot.confirmed == 30
    durations = snapshot.totals.durations
    assert durations.ticks.up_to[-1][1] == snapshot.totals.ticks >= 35
    assert 1 < durations.solves.up_to[-1][1] <= 100
    assert durations.swap_phases["matching"].up_to[-1][1] == 0  # all of them finished before the daemon came


def test_the_daemon_ticks_serves_and_ends_with_its_parent():
    """The daemon prints its URL, counts its ticks by lateness, and ends when stdin closes."""
    process: Any = subprocess.Popen(
        [sys.executable, "-m", "scripts.bench.crowded_daemon", "3"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=REPO,
    )
    with process:
        try:
            url = process.stdout.readline().strip()
            eventually(lambda: counts(url).get("arpd_tick_lateness_seconds_count"))
            process.stdin.close()
            assert process.wait(30.0) == 0
        finally:
            process.kill()


def test_a_tick_above_fifty_milliseconds_is_late():
    """One of ten ticks is late, which misses a target; a daemon without scrapers has no scrape times."""
    counted = {
        "arpd_tick_lateness_seconds_bucket 0.05": 9.0,
        "arpd_tick_lateness_seconds_count": 10.0,
        "arpd_tick_lateness_seconds_sum": 0.2,
        "arpd_tick_duration_seconds_count": 10.0,
        "arpd_tick_duration_seconds_sum": 0.1,
        "arpd_http_connections_refused_total evicted": 3.0,
    }
    quiet = digest([{"scrape_s": [], "failed": 0, "counted": counted}])
    scraped = digest([{"scrape_s": [0.1, 0.3], "failed": 1, "counted": counted}] * 2)
    assert (quiet["late"], quiet["scrape_median_s"]) == (1, None)
    assert (scraped["ticks"], scraped["late"], scraped["scrapes"], scraped["scrapes_failed"]) == (20, 2, 4, 2)
    assert scraped["scrape_median_s"] == pytest.approx(0.2)
    assert scraped["refused"] == {"evicted": 6}
    page = report({"topics": 1000, "loads": {"nothing": quiet, "one scraper": scraped}})
    assert "Targets: 2 of 5 met." in page
