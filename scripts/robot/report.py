"""The demo's table: both runs side by side."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.sim.result import TopicResult

_HURT_P99_S = 0.25  # p99 of a default robot above this means that the link cannot carry the topic
_HURT_LOSS = 0.001


@dataclass(frozen=True, kw_only=True, slots=True)
class Pair:
    """One topic in both runs."""

    without: TopicResult
    with_arpd: TopicResult

    @property
    def is_overloaded(self) -> bool:
        """True if the link could not carry the topic's demand without arpd."""
        return self.without.loss_ratio > _HURT_LOSS or (self.without.latency_p99_s or math.inf) > _HURT_P99_S

    @property
    def is_better(self) -> bool:
        """True with less loss (or none in both), lower p99 latency and lower p99 age with arpd."""
        return (
            (self.with_arpd.loss_ratio < self.without.loss_ratio or self.with_arpd.lost == 0)
            and _less(_p99_of_sent_s(self.with_arpd), _p99_of_sent_s(self.without))
            and _less(self.with_arpd.age_p99_s, self.without.age_p99_s)
        )


def pair_up(without: Sequence[TopicResult], with_arpd: Sequence[TopicResult]) -> list[Pair]:
    """Pair the topics of two runs; the one that arpd carried most of comes first."""
    unmanaged = {result.topic: result for result in without}
    ordered = sorted(with_arpd, key=lambda result: -result.delivered_bytes)
    return [Pair(without=unmanaged[result.topic], with_arpd=result) for result in ordered]


def verdict(pairs: Sequence[Pair]) -> tuple[bool, str]:
    """Return whether arpd was better on every topic the link could not carry, and a sentence on it."""
    overloaded = [pair for pair in pairs if pair.is_overloaded]
    worse = [pair.without.topic for pair in overloaded if not pair.is_better]
    if not overloaded:
        return True, "In this run the link carried everything without arpd."
    if worse:
        return False, f"Not better on {', '.join(worse)} ({len(overloaded)} topics were overloaded)."
    return True, (
        f"On all {len(overloaded)} topics the link could not carry in time, arpd had a lower p99 latency (a lost "
        "sample never arrives), a lower p99 age, and less loss where there was any."
    )


HEADINGS = (
    *("topic", "source Hz", "latency p50 ms", "latency p99 ms", "loss %", "withheld %"),
    *("age p50 ms", "age p99 ms", "stalled %", "delivered MB"),
)


def row_of(pair: Pair) -> list[str]:
    """Return the cells of a topic: ``without → with arpd``."""
    about = [pair.without.topic, f"{pair.without.source_rate_hz:g}"]
    return [*about, *map("{} → {}".format, _cells(pair.without), _cells(pair.with_arpd))]


def final_table(pairs: Sequence[Pair]) -> Table:
    """Return both runs side by side."""
    table = Table(title="rclpy defaults (RELIABLE, KEEP_LAST 10) → arpd", title_justify="left", pad_edge=False)
    for k, heading in enumerate(HEADINGS):
        name, _, unit = heading.rpartition(" ")
        table.add_column(f"{name}\n{unit}" if k else heading, justify="right" if k else "left", no_wrap=True)
    for pair in pairs:
        table.add_row(*row_of(pair), style="bold" if pair.is_overloaded else "")
    return table


def as_document(pairs: Sequence[Pair]) -> dict[str, Any]:
    """Return the whole comparison for JSON."""
    better, sentence = verdict(pairs)
    return {
        "verdict": {"is_better": better, "text": sentence},
        "topics": [
            {
                "topic": pair.without.topic,
                "is_overloaded": pair.is_overloaded,
                "is_better": pair.is_better,
                "without": asdict(pair.without),
                "with": asdict(pair.with_arpd) | {"lost": pair.with_arpd.lost},
            }
            for pair in pairs
        ],
    }


def _p99_of_sent_s(result: TopicResult) -> float | None:
    """Return the p99 latency of all samples sent; None with more than 1 % lost, even if the survivors are quick."""
    return result.latency_p99_s if result.loss_ratio <= 0.01 else None


def _less(ours: float | None, theirs: float | None) -> bool:
    return ours is not None and (theirs is None or ours < theirs)


def _milliseconds(value: float | None) -> str:
    return "never" if value is None else f"{value * 1e3:.0f}"


def _cells(result: TopicResult) -> list[str]:
    return [
        _milliseconds(result.latency_p50_s),
        _milliseconds(result.latency_p99_s),
        f"{100 * result.loss_ratio:.1f}",
        f"{100 * result.withheld_ratio:.1f}",
        _milliseconds(result.age_p50_s),
        _milliseconds(result.age_p99_s),
        f"{100 * result.stalled_ratio:.1f}",
        f"{result.delivered_bytes / 1e6:.2f}",
    ]
