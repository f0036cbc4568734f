"""The targets of `overhead.py`, and the arithmetic of its figures."""

from __future__ import annotations

import math
from statistics import linear_regression, median
from typing import TYPE_CHECKING, Any

from scripts.bench.overhead_sides import AFTER
from scripts.bench.report import Target

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

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


def judge(document: dict[str, Any]) -> list[Target]:
    """Return every target of this tree; a missed one has its parts, the largest first."""
    found = []
    for topics in sorted({run["topics"] for run in document["runs"]}):
        runs = runs_of(document, AFTER, topics)
        whole = [run for run in runs if "failed" not in run]
        if wrong := sum(map(went_wrong, runs)):
            found.append(Target(f"{topics} topics: runs that failed", wrong, 0))
        if not whole:
            continue
        if topics == DEMO_TOPICS:
            found += _of_twelve(whole)
        if topics in MOST_RUN_CPU_SHARE:
            used = median(cpu(span, "run") for span in spans_of(whole, "load"))
            found.append(Target(f"{topics} topics: CPU of run, of a core", used, MOST_RUN_CPU_SHARE[topics], "{:.1%}"))
        least = min(run.get(what, 0) for run in runs for what in ("found", "planned", "confirmed"))
        found.append(Target(f"{topics} topics: confirmed in the worst run", least, topics, at_least=True))
        prices = [plan["price_s"] for run in runs for plan in run["plans"] if plan["cause"] == "fall"]
        price_s = max(prices) if prices and None not in prices else None
        found.append(Target(f"{topics} topics: price after 20 → 5 Mbit/s", price_s, MOST_PRICE_S, "{:.2f} s"))
    if (slope := fitted(document, AFTER, least_topics=MANY)) is not None:
        what = f"exponent of a plan's discovery over the topics, from {MANY} on"
        found.append(Target(what, slope, MOST_EXPONENT, "{:.2f}"))
    if (steady := document.get("steady")) and "steady" in steady:
        calm = steady["steady"]
        where = f"{steady['topics']} topics, {calm['lasted_s'] / 60:.0f} minutes after a fall"
        causeless = sum(count for cause, count in calm["plans"].items() if cause != "budget")
        found.append(Target(f"{where}: plans but those for swaps that it left", causeless, 0))
        found.append(Target(f"{where}: swaps of one topic", calm["most_swaps"], 1))
    return found


def _of_twelve(runs: Sequence[Run]) -> list[Target]:
    found = []
    name = f"{DEMO_TOPICS} topics"
    for phase, words in PHASES.items():
        if spans := spans_of(runs, phase):
            used = median(cpu(span, *CONTROL) for span in spans)
            parts = _ranked({each: median(cpu(span, each) for span in spans) for each in CONTROL}, "{:.1%}")
            what = f"{name}, {words}: CPU of run and peer, of a core"
            found.append(Target(what, used, MOST_CPU_SHARE[phase], "{:.1%}", parts=parts))
            share = median(control(span) / span["link_bytes_per_second"] for span in spans)
            kinds = spans[0]["control_bytes_per_second"]
            middle = {kind: median(span["control_bytes_per_second"][kind] for span in spans) / 1e3 for kind in kinds}
            what = f"{name}, {words}: bytes of run and peer, of the link"
            found.append(Target(what, share, MOST_LINK_SHARE, "{:.2%}", parts=_ranked(middle, "{:.1f} kB/s")))
    spans = [span for run in runs for span in run["spans"]]
    sizes = {each: max(span["rss_bytes"][each] for span in spans) for each in CONTROL}
    parts = _ranked({each: size / MIB for each, size in sizes.items()}, "{:.0f} MiB")
    loaded = sum(bool(span["has_cvxpy"]) for span in spans)
    return [
        *found,
        Target(
            f"{name}: RSS of run and of peer",
            max(sizes.values()) / MIB,
            MOST_RSS_BYTES / MIB,
            "{:.0f} MiB",
            parts=parts,
        ),
        Target(f"{name}: spans with cvxpy loaded", loaded, 0),
    ]


def _ranked(parts: dict[str, float], form: str) -> str:
    return ", ".join(f"{name} {form.format(size)}" for name, size in sorted(parts.items(), key=lambda part: -part[1]))
