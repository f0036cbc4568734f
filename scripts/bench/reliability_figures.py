"""What a bad hour did, from the documents of `reliability.py` and `fuzz.py`: their report for docs/results.md."""

from __future__ import annotations

from itertools import groupby
from statistics import linear_regression, median
from typing import TYPE_CHECKING, Any

from scripts.bench.record import described
from scripts.bench.reliability_course import HOUR_MINUTES
from scripts.bench.report import mib, paragraphs, table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

TARGET_S = 5.0
_RECOVERIES = {
    "calm kill": "kill -9 of run, steady link and configuration: plan confirmed",
    "kill run": "kill -9 of run while both change all the time: plan confirmed",
    "restart run": "clean stop of run: plan confirmed",
    "kill relay": "kill -9 of the relay: all its topics under the plan",
    "kill peer": "kill -9 of the peer: its report at the daemon",
}


def report(document: dict[str, Any], fuzz: dict[str, Any] | None = None) -> str:
    # Memory counts from this age of a process on; a short run has no time for an older one.
    warm_s = 10.0 if document["minutes"] < HOUR_MINUTES / 2 else 60.0
    events = ", ".join(f"{count} × {kind}" for kind, count in document["events"].items())
    topics = {
        "with AdaptivePublishers": [topic for name, topic in document["topics"].items() if "/adaptive/" in name],
        "without arpd, at the same time": [topic for name, topic in document["topics"].items() if "/plain/" in name],
    }
    recoveries = {
        what: [one for one in document["recoveries"] if one["kind"] == kind] for kind, what in _RECOVERIES.items()
    }
    return paragraphs(
        f"{document['minutes']:g} minutes: {events}; the demo robot on a link of 2 to 20 Mbit/s "
        f"({described(document)}; load {document['load_average'][2]:.1f} at the end).",
        table(
            topics.items(),
            ("reliable messages of a running application", 0),
            ("sent", lambda row: _sum(row[1], "sent"), "{:,}"),
            *((what, lambda row, key=key: _sum(row[1], key)) for what, key in _FATES.items()),
            ("longest silence s", lambda row: max(topic["silence_s"] for topic in row[1]), "{:.1f}"),
        ),
        table(
            [(what, ones) for what, ones in recoveries.items() if ones],
            ("seconds from the new start after", 0),
            ("median", lambda row: _middle(row[1], "whole_s"), "{:.1f}"),
            ("longest", lambda row: max(_known(row[1], "whole_s"), default=None), "{:.1f}"),
            (
                f"within {TARGET_S:g} s",
                lambda row: f"{sum(s <= TARGET_S for s in _known(row[1], 'whole_s'))} of {len(row[1])}",
            ),
            ("not before the next event", lambda row: len(row[1]) - len(_known(row[1], "whole_s"))),
            ("run answers", lambda row: _middle(row[1], "answered_s") if "of run" in row[0] else "", "{:.1f}"),
            (
                "and has planned for all",
                lambda row: _middle(row[1], "planned_s") if "of run" in row[0] else "",
                "{:.1f}",
            ),
        ),
        table(
            _grown(document["footprints"], warm_s),
            (f"longest life without a restart, from {warm_s:g} s on", "name"),
            ("minutes", "minutes", "{:.1f}"),
            ("MiB at first → at last", lambda life: " → ".join(f"{size / 2**20:.1f}" for size in life["rss_bytes"])),
            ("MiB/h", lambda life: life["bytes_per_hour"] / 2**20, "{:+.1f}"),
            ("threads", "threads"),
            ("open files", "files"),
        ),
        table(_others(document, fuzz), ("", 0), ("", 1)),
    )


_FATES = {"lost": "lost", "doubled": "doubled", "out of order": "late"}


def _sum(topics: Sequence[dict[str, Any]], key: str) -> int:
    return sum(topic[key] for topic in topics)


def _known(ones: Sequence[dict[str, Any]], key: str) -> list[float]:
    return [one[key] for one in ones if one[key] is not None]


def _middle(ones: Sequence[dict[str, Any]], key: str) -> float | None:
    return median(known) if (known := _known(ones, key)) else None


def _grown(footprints: dict[str, list[dict[str, Any]]], warm_s: float) -> Iterator[dict[str, Any]]:
    """Yield what each process grew by in its longest life; memory by least squares over the time after its start."""
    for name, notes in footprints.items():
        lives = [list(life) for _, life in groupby(notes, key=lambda note: note["pid"])]
        longest = max(lives, key=lambda life: life[-1]["at_s"] - life[0]["at_s"])
        warm = [note for note in longest if note["at_s"] - longest[0]["at_s"] >= warm_s]
        if len(warm) < 3:
            continue
        sizes = [note["rss_bytes"] for note in warm]
        yield {
            "name": f"arpd {name}",
            "minutes": (warm[-1]["at_s"] - warm[0]["at_s"]) / 60,
            "rss_bytes": (sizes[0], sizes[-1]),
            "bytes_per_hour": 3600 * linear_regression([note["at_s"] for note in warm], sizes).slope,
            **{key: _change([note[key] for note in warm]) for key in ("threads", "files")},
        }


def _change(values: Sequence[int]) -> str:
    return f"{values[0]}" if min(values) == max(values) else f"{values[0]} → {values[-1]} (at most {max(values)})"


def _others(document: dict[str, Any], fuzz: dict[str, Any] | None) -> Iterator[tuple[str, str]]:
    ticks, late, failed = (_sum(document["lives"], key) for key in ("ticks", "ticks_late", "ticks_failed"))
    yield "ticks", f"{ticks:,}; {late:,} started late, {failed} failed"
    taken, refused = (sum(life["reloads"].get(key, 0) for life in document["lives"]) for key in ("ok", "failed"))
    yield "reloads", f"{taken} taken, {refused} refused and the old configuration kept"
    yield loud_lines(document)
    if fuzz:
        targets = fuzz["targets"]
        executions = _sum(targets.values(), "executions")
        crashes = sum(len(found["crashes"]) for found in targets.values())
        slowest, what = max((found["slowest_s"], name) for name, found in targets.items())
        grown = max(found["peak_rss_bytes"] - found["rss_at_start_bytes"] for found in targets.values())
        value = f"{executions / 1e6:.1f} million inputs, {crashes} crashes; slowest {slowest * 1e3:.0f} ms ({what})"
        value += f", memory at most {mib(grown)} MiB more"
        yield f"coverage-guided fuzzing of {len(targets)} readers of outside input", value
    if scores := document.get("security"):
        value = ", ".join(f"{unit} {score}" for unit, score in scores.items())
        yield "`systemd-analyze security` (0 best, 10 worst)", value


def loud_lines(document: dict[str, Any]) -> tuple[str, str]:
    """Return a row with the number of loud lines in each log."""
    counts = {name: sum(lines.values()) for name, lines in document["log"].items()}
    return "log lines at WARNING and above", ", ".join(f"{name} {count}" for name, count in counts.items())
