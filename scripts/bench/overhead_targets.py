"""The targets of `overhead.py`, and the arithmetic of its figures."""

from __future__ import annotations

import math
from statistics import linear_regression, median
from typing import TYPE_CHECKING, Any

from scripts.bench.overhead_sides import AFTER

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

CONTROL = ("run", "peer")
PHASES = {"rest": "at rest", "load": "all carried", "paced": "paced"}
DEMO_TOPICS = 12
MOST_CPU_SHARE = {"rest": 0.025, "load": 0.04, "paced": 0.04}
MOST_RUN_CPU_SHARE = {100: 0.06, 500: 0.10, 1000: 0.15}
MOST_RSS_BYTES, MOST_LINK_SHARE, MOST_PRICE_S, MOST_EXPONENT = 100 * 2**20, 0.01, 0.5, 1.1
MANY = 100  # topics from which on a plan's discovery must grow linearly
MIB = 2**20

Run = dict[str, Any]
Span = dict[str, Any]


def runs_of(document: dict[str, Any], side: str, topics: int) -> list[Run]:
    """Return the runs of one side with so many topics."""
    return [run for run in document["runs"] if (run["side"], run["topics"]) == (side, topics)]


def went_wrong(run: Run) -> bool:
    """Return whether a run failed, or has a figure that cannot be true."""
    return "failed" in run or bool(run["complaints"])


def spans_of(runs: Iterable[Run], phase: str) -> list[Span]:
    """Return the spans of one phase."""
    return [span for run in runs for span in run["spans"] if span["phase"] == phase]


def cpu(span: Span, *names: str) -> float:
    """Return the CPU of processes together; `relay` stands for all relays (share of a core)."""
    return float(
        sum(share for name, share in span["cpu_share"].items() if name.rstrip("0123456789") in names or name in names)
    )


def control(span: Span) -> float:
    """Return the bytes of the control plane on the link (bytes/s)."""
    return float(sum(span["control_bytes_per_second"].values()))


def discovery_bytes(run: Run, plan: dict[str, Any], where: str = "discovery_bytes") -> float:
    """Return the discovery that a plan caused: what there was, less what flows at rest (bytes).

    Parameters
    ----------
    where : `discovery_bytes` on the link, or `listener_bytes` to a process of the robot
    """
    rest = spans_of([run], "rest")
    idle = rest[0][f"{where}_per_second"] if rest else 0.0
    return float(max(0.0, plan[where] - idle * plan["lasted_s"]))


def bytes_for_all(runs: Sequence[Run]) -> float | None:
    """Return the discovery on the link of a plan that swaps every topic (bytes), None without a swap.

    The budget may spread the swaps of a plan beyond the time that was counted, so this is the median of the bytes per
    swap, times the topics.
    """
    each = [
        discovery_bytes(run, plan) / plan["swaps"] * run["topics"]
        for run in runs
        for plan in run["plans"]
        if plan["swaps"] > 0
    ]
    return median(each) if each else None


def exponent(sizes: Sequence[int], values: Sequence[float]) -> float:
    """Return the exponent of the power of the size that fits the values best, by least squares of the logarithms."""
    return linear_regression([math.log(size) for size in sizes], [math.log(value) for value in values]).slope


def fitted(document: dict[str, Any], side: str, *, least_topics: int = 1) -> float | None:
    """Return the exponent of a plan's discovery over the numbers of topics, None with fewer than two."""
    found = {}
    for topics in sorted({run["topics"] for run in document["runs"]}):
        value = bytes_for_all(runs_of(document, side, topics))
        if value and topics >= least_topics:
            found[topics] = value
    return exponent(list(found), list(found.values())) if len(found) > 1 else None


def verdicts(document: dict[str, Any]) -> list[str]:
    """Return for every target whether this tree meets it; for a missed one, its parts, the largest first."""
    sizes = sorted({run["topics"] for run in document["runs"]})
    said = [sentence for topics in sizes for sentence in _of_size(topics, runs_of(document, AFTER, topics))]
    slope = fitted(document, AFTER, least_topics=MANY)
    if slope is not None:
        what = f"Exponent of a plan's discovery bytes over the topics, from {MANY} on"
        said.append(_judged(what, slope, MOST_EXPONENT, "{:.2f}"))
    if (steady := document.get("steady")) and "steady" in steady:
        found = steady["steady"]
        causes = {cause: count for cause, count in found["plans"].items() if cause != "budget"}
        words = ", ".join(f"{count} by {cause}" for cause, count in sorted(found["plans"].items())) or "none"
        said.append(
            f"In {found['lasted_s'] / 60:.0f} minutes after a fall nothing flaps with {steady['topics']} topics: plans "
            f"{words}; {found['swaps']} swaps that the fall had left, at most {found['most_swaps']} of a topic; "
            f"{met(is_met=not causes and found['most_swaps'] <= 1)}."
        )
    return said


def _of_size(topics: int, runs: Sequence[Run]) -> list[str]:
    if not runs or all("failed" in run for run in runs):
        return [f"{topics} topics: failed."]
    said = _of_twelve(runs) if topics == DEMO_TOPICS else []
    if wrong := sum(map(went_wrong, runs)):
        said.append(f"{topics} topics: {wrong} of {len(runs)} runs failed; missed.")
    if topics in MOST_RUN_CPU_SHARE:
        used = median(cpu(span, "run") for span in spans_of(runs, "load"))
        said.append(_judged(f"CPU of run with {topics} topics", used, MOST_RUN_CPU_SHARE[topics], "{:.1%} of a core"))
    counted = {what: min(run.get(what, 0) for run in runs) for what in ("found", "planned", "confirmed")}
    words = ", ".join(f"{number} {what}" for what, number in counted.items())
    said.append(f"Of {topics} publishers in the worst run: {words}; {met(is_met=min(counted.values()) >= topics)}.")
    falls = [plan for run in runs for plan in run["plans"] if plan["cause"] == "fall"]
    if falls and all(plan["price_s"] is not None for plan in falls):
        worst = max(plan["price_s"] for plan in falls)
        said.append(
            _judged(f"Price after 20 to 5 Mbit/s with {topics} topics", worst, MOST_PRICE_S, "at most {:.2f} s")
        )
    else:
        said.append(f"Price after 20 to 5 Mbit/s with {topics} topics: not in every run; missed.")
    return said


def _of_twelve(runs: Sequence[Run]) -> list[str]:
    processors, link = [], []
    for phase, words in PHASES.items():
        if spans := spans_of(runs, phase):
            used = median(cpu(span, *CONTROL) for span in spans)
            parts = {name: median(cpu(span, name) for span in spans) for name in CONTROL}
            what = f"CPU of run and peer with {DEMO_TOPICS} topics, {words}"
            processors.append(_judged(what, used, MOST_CPU_SHARE[phase], "{:.1%} of a core", parts, part="{:.1%}"))
            share = median(control(span) / span["link_bytes_per_second"] for span in spans)
            form = f"{{:.2%}} of {spans[0]['link_bytes_per_second'] * 8e-6:g} Mbit/s"
            what = f"Bytes of run and peer on the link with {DEMO_TOPICS} topics, {words}"
            link.append(_judged(what, share, MOST_LINK_SHARE, form, _by_kind(spans), part="{:.1f} kB/s"))
    spans = [span for run in runs for span in run["spans"]]
    mib = {name: max(span["rss_bytes"][name] for span in spans) / MIB for name in CONTROL}
    what = f"RSS of run and of peer with {DEMO_TOPICS} topics"
    memory = _judged(what, max(mib.values()), MOST_RSS_BYTES / MIB, "at most {:.0f} MiB", mib, part="{:.0f} MiB")
    has_cvxpy = any(span["has_cvxpy"] for span in spans)
    return [
        *processors,
        memory,
        f"cvxpy: {'loaded' if has_cvxpy else 'not loaded'}; {met(is_met=not has_cvxpy)}.",
        *link,
    ]


def _by_kind(spans: Sequence[Span]) -> dict[str, float]:
    kinds = spans[0]["control_bytes_per_second"]
    return {kind: median(span["control_bytes_per_second"][kind] for span in spans) / 1e3 for kind in kinds}


def _judged(
    what: str, value: float, most: float, form: str, parts: dict[str, float] | None = None, *, part: str = ""
) -> str:
    """Judge a value, written as ``form`` has it; a missed target names its parts, the largest first."""
    ranked = sorted((parts or {}).items(), key=lambda part: -part[1])
    why = ", ".join(f"{name} {part.format(size)}" for name, size in ranked)
    allowed = f"allowed {form.removeprefix('at most ').format(most)}"
    verdict = "met" if value <= most else f"missed ({'; '.join(filter(None, (allowed, why)))})"
    return f"{what}: {form.format(value)}; {verdict}."


def met(*, is_met: bool) -> str:
    """Return the word for a target."""
    return "met" if is_met else "missed"


def spread(values: Sequence[float | None], show: Callable[[float], str]) -> str:
    """Return median and worst; a value that never came is the worst."""
    known = sorted(value for value in values if value is not None)
    if not values:
        return ""
    if len(known) < len(values):
        return f"never in {len(values) - len(known)} of {len(values)}"
    middle, worst = show(median(known)), show(known[-1])
    return middle if len(known) == 1 or middle == worst else f"{middle} ({worst})"
