"""The demo's own figures: the robot with rclpy's defaults, and with arpd."""

from __future__ import annotations

import tempfile
from pathlib import Path

from arpd.sim.schedule import RateSchedule
from scripts.bench.report import Summary, Table
from scripts.robot.demo import QUICK, TAIL_S, DemoError, compare
from scripts.robot.report import HEADINGS, row_of


def play(*, is_quick: bool, rounds: int = 1) -> Summary:
    """Run what `scripts/demo --quick` does, which takes as long in every form."""
    del is_quick, rounds
    schedule = RateSchedule.parse(QUICK)
    with tempfile.TemporaryDirectory(prefix="arpd-bench-demo-") as logs:
        pairs = compare(Path(logs), schedule, schedule.duration_s + TAIL_S[QUICK])
    if not all(pair.with_arpd.received for pair in pairs):
        raise DemoError("nothing arrived on some topic with arpd")
    return Summary(
        about=f"rclpy's defaults (RELIABLE, KEEP_LAST 10) → arpd, link {QUICK}.",
        tables=[Table(columns=list(HEADINGS), rows=list(map(row_of, pairs)))],
    )
