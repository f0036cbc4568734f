"""Record `scripts/demo --quick` for docs/results.md.

Usage: .venv/bin/python scripts/bench/demo.py [--quick] [--json FILE]

The demo takes two minutes with or without --quick. With --quick, its document goes only to the file of --json.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from scripts.bench.record import REPO, conditions, keep, options_of
from scripts.bench.report import about, paragraphs, table
from scripts.robot.demo import QUICK
from scripts.robot.report import milliseconds, percent

if TYPE_CHECKING:
    from collections.abc import Callable


def report(document: dict[str, Any]) -> str:
    def both(head: str, cell: Callable[[dict[str, Any]], str]) -> tuple[str, Callable[[dict[str, Any]], str]]:
        return head, lambda topic: f"{cell(topic['without'])} → {cell(topic['with'])}"

    return paragraphs(
        about(document, f"rclpy's defaults (RELIABLE, KEEP_LAST 10) → arpd, link {document['schedule']}"),
        document["verdict"]["text"],
        table(
            sorted(document["topics"], key=lambda topic: -topic["with"]["delivered_bytes"]),
            ("topic", lambda topic: f"`{topic['topic']}`"),
            ("source Hz", lambda topic: topic["with"]["source_rate_hz"], "{:g}"),
            both("latency p99 ms", lambda side: milliseconds(side["latency_p99_s"])),
            both("loss %", lambda side: percent(side["loss_ratio"])),
            both("withheld %", lambda side: percent(side.get("withheld_ratio", 0.0))),
            both("age p50 ms", lambda side: milliseconds(side["age_p50_s"])),
            both("age p99 ms", lambda side: milliseconds(side["age_p99_s"])),
            both("delivered MB", lambda side: f"{side['delivered_bytes'] / 1e6:.2f}"),
        ),
        "*Age* is that of the newest sample at the reader; *withheld*: pacing sent a fresher sample instead. Latency "
        "counts the samples that arrived: where the default robot lost most, only the age shows the delay.",
    )


def main() -> None:
    options = options_of(__doc__, "demo", quick="write nothing unless --json names a file").parse_args()
    document: dict[str, Any] = {"conditions": conditions(), "schedule": QUICK}
    with progress("the robot without arpd and with it, two minutes"):
        command = [str(REPO / "scripts/demo"), "--quick", "--json"]
        played = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if played.returncode:
        sys.exit(played.returncode)
    document |= json.loads(played.stdout)
    if not all(topic["with"]["received"] for topic in document["topics"]):
        sys.exit("demo: nothing arrived on some topic with arpd")
    keep(document, options, "demo", is_partial=options.quick)
    print(report(document))


if __name__ == "__main__":
    main()
