"""The demo's own figures: the robot with rclpy's defaults, and with arpd."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING, Any

from scripts.bench.report import REPO, Summary, table
from scripts.robot.demo import QUICK
from scripts.robot.report import milliseconds, percent

if TYPE_CHECKING:
    from collections.abc import Callable

    from scripts.bench.report import Column


def play(*, is_quick: bool) -> Summary:
    """Run `scripts/demo --quick`, which takes two minutes either way."""
    del is_quick
    command = [sys.executable, "-m", "scripts.robot.demo", "--quick", "--json"]
    played = json.loads(subprocess.run(command, cwd=REPO, stdout=subprocess.PIPE, text=True, check=True).stdout)
    topics = sorted(played["topics"], key=lambda topic: -topic["with"]["delivered_bytes"])
    if not all(topic["with"]["received"] for topic in topics):
        raise SystemExit("demo: nothing arrived on some topic with arpd")

    def both(head: str, cell: Callable[[dict[str, Any]], str]) -> Column:
        return head, lambda topic: f"{cell(topic['without'])} → {cell(topic['with'])}"

    columns = (
        both("latency p99 ms", lambda side: milliseconds(side["latency_p99_s"])),
        both("loss %", lambda side: percent(side["loss_ratio"])),
        both("withheld %", lambda side: percent(side.get("withheld_ratio", 0.0))),
        both("age p50 ms", lambda side: milliseconds(side["age_p50_s"])),
        both("age p99 ms", lambda side: milliseconds(side["age_p99_s"])),
        both("delivered MB", lambda side: f"{side['delivered_bytes'] / 1e6:.2f}"),
    )
    return Summary(
        about=f"rclpy's defaults (RELIABLE, KEEP_LAST 10) → arpd, link {QUICK}.",
        tables=[
            table(
                "",
                topics,
                ("topic", lambda row: f"`{row['topic']}`"),
                ("source Hz", lambda row: row["with"]["source_rate_hz"]),
                *columns,
            )
        ],
    )
