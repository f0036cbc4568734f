"""The results of `reliability.py` and `fuzz.py` as a table for docs/results.md."""

from __future__ import annotations

from itertools import groupby
from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.record import described
from scripts.bench.reliability_course import HOUR_MINUTES
from scripts.bench.report import markdown_table

if TYPE_CHECKING:
    from collections.abc import Sequence

TARGET_S = 5.0
_MIB = 2**20
_NAMES = {
    "rate": "changes of capacity",
    "reload": "reloads (one in six refused)",
    "kill run": "kill -9 of run",
    "kill peer": "of the peer",
    "kill relay": "of the relay",
    "restart run": "clean restarts of run",
    "outage": "outages",
    "interface": "interface down and up",
}


def markdown(document: dict[str, Any], fuzz: dict[str, Any] | None = None) -> str:
    """Return the conditions and a table of all figures, with those of `fuzz.py` if there are any."""
    # Memory counts from this age of a process on; a short run has no time for an older one.
    warm_s = 10.0 if document["minutes"] < HOUR_MINUTES / 2 else 60.0
    happened = ", ".join(f"{document['events'].get(kind, 0)} {words}" for kind, words in _NAMES.items())
    head = (
        f"{document['minutes']:g} minutes with what happens in a bad hour: {happened}; the demo robot on a link of "
        f"2 to 20 Mbit/s ({described(document)}; {document['load_average'][2]:.1f} at the end)."
    )
    rows = [
        *_messages(document),
        *_recoveries(document["recoveries"]),
        *_ticks(document["lives"]),
        *_growth(document["footprints"], warm_s),
        _logs(document["log"]),
        *_fuzz(fuzz),
        *_security(document.get("security", {})),
    ]
    return "\n".join([head, "", *markdown_table("l", ["", ""], rows)])


def _messages(document: dict[str, Any]) -> list[tuple[str, str]]:
    losses, silences = [], []
    for kind in ("adaptive", "plain"):
        topics = [topic for name, topic in document["topics"].items() if f"/{kind}/" in name]
        lost, sent, doubled, late = (sum(topic[key] for topic in topics) for key in ("lost", "sent", "doubled", "late"))
        losses.append(f"{lost:,} of {sent:,} lost, {doubled} doubled, {late} out of order")
        silences.append(f"{max(topic['silence_s'] for topic in topics):.1f} s")
    return [
        ("reliable messages of a running application with AdaptivePublishers", losses[0]),
        ("the same without arpd, at the same time", losses[1]),
        ("longest silence at their reader", f"{silences[0]}; without arpd {silences[1]}"),
    ]


def _recoveries(recoveries: Sequence[dict[str, Any]]) -> list[tuple[str, str]]:
    words = {
        "calm kill": "from the start after a kill -9 of run to the plan confirmed, on a steady link and configuration",
        "kill run": "the same while both change all the time",
        "restart run": "from the start after a clean stop of run to the plan confirmed",
        "kill relay": "from the relay's start to all its topics under the plan again",
        "kill peer": "from the peer's start to its report at the daemon",
    }
    rows = []
    for kind, what in words.items():
        took = [one["whole_s"] for one in recoveries if one["kind"] == kind]
        came = sorted(seconds for seconds in took if seconds is not None)
        if not took:
            continue
        value = f"median {median(came):.1f} s, longest {came[-1]:.1f} s" if came else "–"
        value += f"; within {TARGET_S:g} s: {sum(s <= TARGET_S for s in came)} of {len(took)}"
        if len(came) < len(took):
            value += f"; {len(took) - len(came)} not before the next event"
        if "run" in what:
            value += f"; it answers after {_median(recoveries, kind, 'answered_s')}"
            value += f" and has planned for all after {_median(recoveries, kind, 'planned_s')}"
        rows.append((what, value))
    return rows


def _median(recoveries: Sequence[dict[str, Any]], kind: str, key: str) -> str:
    took = [one[key] for one in recoveries if one["kind"] == kind and one[key] is not None]
    return f"{median(took):.1f} s" if took else "–"


def _ticks(lives: Sequence[dict[str, Any]]) -> list[tuple[str, str]]:
    ticks, late, failed = (sum(life[key] for life in lives) for key in ("ticks", "ticks_late", "ticks_failed"))
    refused = sum(life["reloads"].get("failed", 0) for life in lives)
    taken = sum(life["reloads"].get("ok", 0) for life in lives)
    return [
        ("ticks", f"{ticks:,}; {late:,} started late, {failed} failed"),
        ("reloads", f"{taken} taken, {refused} refused and the old configuration kept"),
    ]


def _growth(footprints: dict[str, list[dict[str, Any]]], warm_s: float) -> list[tuple[str, str]]:
    rows = []
    for name, notes in footprints.items():
        lives = [list(life) for _, life in groupby(notes, key=lambda note: note["pid"])]
        longest = max(lives, key=lambda life: life[-1]["at_s"] - life[0]["at_s"])
        warm = [note for note in longest if note["at_s"] - longest[0]["at_s"] >= warm_s]
        if len(warm) < 3:
            continue
        begin, middle, end = warm[0], warm[len(warm) // 2], warm[-1]
        rss = " → ".join(f"{note['rss_bytes'] / _MIB:.1f}" for note in (begin, middle, end))
        value = f"{rss} MiB over {(end['at_s'] - begin['at_s']) / 60:.1f} min ({_slope(warm) * 3600 / _MIB:+.1f} MiB/h)"
        value += f", threads {_change(warm, 'threads')}, open files {_change(warm, 'files')}"
        rows.append((f"arpd {name}, its longest life without a restart, from {warm_s:g} s on", value))
    return rows


def _change(notes: Sequence[dict[str, Any]], key: str) -> str:
    values = [note[key] for note in notes]
    return f"{values[0]}" if min(values) == max(values) else f"{values[0]} → {values[-1]} (at most {max(values)})"


def _slope(notes: Sequence[dict[str, Any]]) -> float:
    """Return the growth by least squares (bytes/s)."""
    times = [note["at_s"] for note in notes]
    values = [note["rss_bytes"] for note in notes]
    mean_t, mean_v = sum(times) / len(times), sum(values) / len(values)
    spread = sum((t - mean_t) ** 2 for t in times)
    return float(sum((t - mean_t) * (v - mean_v) for t, v in zip(times, values, strict=True)) / spread)


def _logs(log: dict[str, dict[str, int]]) -> tuple[str, str]:
    counts = {name: sum(lines.values()) for name, lines in log.items()}
    return ("log lines at WARNING and above", ", ".join(f"{name} {count}" for name, count in counts.items()))


def _fuzz(fuzz: dict[str, Any] | None) -> list[tuple[str, str]]:
    if not fuzz:
        return []
    targets = fuzz["targets"]
    executions = sum(found["executions"] for found in targets.values())
    crashes = sum(len(found["crashes"]) for found in targets.values())
    slowest, what = max((found["slowest_s"], name) for name, found in targets.items())
    grown = max(found["peak_rss_bytes"] - found["rss_at_start_bytes"] for found in targets.values())
    value = f"{executions / 1e6:.1f} million inputs, {crashes} crashes; slowest {slowest * 1e3:.0f} ms ({what})"
    value += f", memory at most {grown / _MIB:.0f} MiB more"
    return [(f"coverage-guided fuzzing of {len(targets)} readers of outside input", value)]


def _security(scores: dict[str, str]) -> list[tuple[str, str]]:
    value = ", ".join(f"{unit} {score}" for unit, score in scores.items())
    return [("`systemd-analyze security` (0 best, 10 worst)", value)] if scores else []
