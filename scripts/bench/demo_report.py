"""Show the results of `demo.py` as docs/results.md has them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from scripts.bench.record import described

if TYPE_CHECKING:
    from collections.abc import Callable

_LEGEND = (
    "*Age* is that of the newest sample at the reader, sampled at 20 Hz; *withheld* is what pacing chose not to send "
    "in favour of a fresher sample. Latency counts what arrived: where most was lost, the survivors of the default "
    "robot look quick, and the age tells the truth."
)


def markdown(document: dict[str, Any]) -> str:
    """Return a row per topic, every cell without arpd → with arpd, and the demo's own verdict."""
    head = (
        f"`scripts/demo --quick` ({described(document)}), link {document['schedule']}; rclpy defaults (RELIABLE, "
        f"KEEP_LAST 10) → arpd. {document['verdict']['text']}"
    )
    return "\n".join(
        [
            head,
            "",
            "| topic | source Hz | latency p99 ms | loss % | withheld % | age p50 ms | age p99 ms | delivered MB |",
            "|---|---:|---:|---:|---:|---:|---:|---:|",
            *map(_row, sorted(document["topics"], key=lambda topic: -topic["with"]["delivered_bytes"])),
            "",
            _LEGEND,
        ]
    )


def _row(topic: dict[str, Any]) -> str:
    def both(cell: Callable[[dict[str, Any]], str]) -> str:
        return f"{cell(topic['without'])} → {cell(topic['with'])}"

    cells = [
        both(lambda side: _ms(side["latency_p99_s"])),
        both(lambda side: f"{100 * side['loss_ratio']:.1f}"),
        both(lambda side: f"{100 * side.get('withheld_ratio', 0.0):.1f}"),
        both(lambda side: _ms(side["age_p50_s"])),
        both(lambda side: _ms(side["age_p99_s"])),
        both(lambda side: f"{side['delivered_bytes'] / 1e6:.2f}"),
    ]
    return f"| `{topic['topic']}` | {topic['with']['source_rate_hz']:g} | {' | '.join(cells)} |"


def _ms(seconds: float | None) -> str:
    return "never" if seconds is None else f"{seconds * 1e3:.0f}"
