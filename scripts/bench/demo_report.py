"""The results of `demo.py` for docs/results.md."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from scripts.bench.record import described
from scripts.bench.report import markdown_table
from scripts.robot.report import milliseconds, percent

if TYPE_CHECKING:
    from collections.abc import Callable

_HEAD = ("topic", "source Hz", "latency p99 ms", "loss %", "withheld %", "age p50 ms", "age p99 ms", "delivered MB")
_LEGEND = (
    "*Age* is that of the newest sample at the reader, sampled at 20 Hz; *withheld* is the share of samples for "
    "which pacing sent a fresher one instead. Latency counts the samples that arrived: where the default robot lost "
    "most, its survivors look quick, and only the age shows the delay."
)


def markdown(document: dict[str, Any]) -> str:
    """Return a row per topic, every cell without arpd → with arpd, and the demo's own verdict."""
    head = (
        f"`scripts/demo --quick` ({described(document)}), link {document['schedule']}; rclpy defaults (RELIABLE, "
        f"KEEP_LAST 10) → arpd. {document['verdict']['text']}"
    )
    rows = map(_row, sorted(document["topics"], key=lambda topic: -topic["with"]["delivered_bytes"]))
    return "\n".join([head, "", *markdown_table("lr", _HEAD, rows), "", _LEGEND])


def _row(topic: dict[str, Any]) -> list[str]:
    def both(cell: Callable[[dict[str, Any]], str]) -> str:
        return f"{cell(topic['without'])} → {cell(topic['with'])}"

    return [
        f"`{topic['topic']}`",
        f"{topic['with']['source_rate_hz']:g}",
        both(lambda side: milliseconds(side["latency_p99_s"])),
        both(lambda side: percent(side["loss_ratio"])),
        both(lambda side: percent(side.get("withheld_ratio", 0.0))),
        both(lambda side: milliseconds(side["age_p50_s"])),
        both(lambda side: milliseconds(side["age_p99_s"])),
        both(lambda side: f"{side['delivered_bytes'] / 1e6:.2f}"),
    ]
