"""The figures of a course: the errors of the estimate, and its cost."""

from __future__ import annotations

from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING

from arpd.adapters.sim.result import percentile

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from scripts.bench.link_course import Belief, Instant, Scenario

START_S = 10.0  # the sources start at 0, the first plan follows, and swaps take a few seconds
SETTLED_S = 8.0  # the target for a rise is 7 s; a later difference is an error, not a reaction

#: figure → title, unit, and factor from base units; in the order of the table
FIGURES: dict[str, tuple[str, str, float]] = {
    "error_median": ("steady error, median", "%", 100.0),
    "error_p90": ("steady error, p90", "%", 100.0),
    "bias": ("steady bias", "%", 100.0),
    "reaction_s": ("estimate within 15 % of the new rate", "s", 1.0),
    "budget_s": ("budget at most a tenth above the new rate", "s", 1.0),
    "rise_s": ("estimate at 80 % of the new rate", "s", 1.0),
    "closed_s": ("budget closed after the link went", "s", 1.0),
    "recovery_s": ("estimate at 80 % after it came back", "s", 1.0),
    "traffic_back_s": ("traffic at 80 % of before", "s", 1.0),
    "peak_queue_s": ("peak queue delay", "ms", 1e3),
    "start_queue_s": ("peak queue delay at the start", "ms", 1e3),
    "utilisation": ("carried of what the link could", "%", 100.0),
    "probe_share": ("probes of capacity", "%", 100.0),
    "report_share": ("reports of capacity", "%", 100.0),
    "levels_per_minute": ("level changes", "1/min", 1.0),
    "swaps_per_minute": ("topic swaps", "1/min", 1.0),
}
_CLOSED = 0.1  # of the budget just before an outage
_NEAR = 0.15
_HOLD_S = 1.0  # a belief must stay right for so long


def figures(course: Sequence[Instant], scenario: Scenario) -> dict[str, float | None]:
    """Return the figures of this scenario, by the names of `FIGURES`; None = never.

    Only figures that name the start include the first seconds. The queue is that after the event; a queue before it
    belongs to the steady scenarios.
    """
    started = [instant for instant in course if instant.t_s > START_S]
    after = [instant for instant in started if instant.t_s > scenario.event_s]
    found: dict[str, float | None] = {
        "peak_queue_s": max(instant.queue_delay_s for instant in after),
        "start_queue_s": max(instant.queue_delay_s for instant in course if instant.t_s <= START_S),
    }
    found |= _carried(started)
    beliefs = [instant.belief for instant in started if instant.belief is not None]
    if beliefs:
        found |= _errors(course, scenario) | _costs(started, beliefs)
        if scenario.outages:
            found |= _outage(course, scenario)
        elif scenario.event_s:
            found |= _step(after, scenario)
    return found


def _errors(course: Sequence[Instant], scenario: Scenario) -> dict[str, float | None]:
    off = [
        instant.belief.estimate_bytes_per_second / instant.truth_bytes_per_second - 1.0
        for instant in course
        if instant.belief is not None
        and instant.truth_bytes_per_second > 0
        and instant.t_s - max(c for c in scenario.changes_s if c <= instant.t_s) >= SETTLED_S
    ]
    if not off:
        return {}
    sizes = [abs(error) for error in off]
    return {"error_median": median(sizes), "error_p90": percentile(sizes, 0.9), "bias": median(off)}


def _costs(course: Sequence[Instant], beliefs: Sequence[Belief]) -> dict[str, float | None]:
    first, last = beliefs[0], beliefs[-1]
    swaps = max(belief.swaps for belief in beliefs) - first.swaps  # silent publishers are missing from the last
    minutes = (course[-1].t_s - course[0].t_s) / 60.0
    levels = sum(last.levels_by_cause.values()) - sum(first.levels_by_cause.values())
    return {
        "probe_share": (last.probe_bytes - first.probe_bytes) / _could_carry(course),
        "report_share": (last.report_bytes - first.report_bytes) / _could_carry(course),
        "levels_per_minute": levels / minutes,
        "swaps_per_minute": swaps / minutes,
    }


def _carried(course: Sequence[Instant]) -> dict[str, float | None]:
    first, last = course[0].carried_bytes, course[-1].carried_bytes
    if first is None or last is None:
        return {}
    return {"utilisation": (last - first) / _could_carry(course)}


def _could_carry(course: Sequence[Instant]) -> float:
    return sum(now.truth_bytes_per_second * (now.t_s - before.t_s) for before, now in pairwise(course))


def _step(after: Sequence[Instant], scenario: Scenario) -> dict[str, float | None]:
    before = scenario.rates.rate_at(0.0)
    truth = scenario.rates.rate_at(scenario.event_s)
    if truth > before:
        return {"rise_s": _delay_s(after, scenario.event_s, _knows(0.8 * truth))}

    def is_near(belief: Belief) -> bool:
        return abs(belief.estimate_bytes_per_second / truth - 1.0) <= _NEAR

    return {
        "reaction_s": _delay_s(after, scenario.event_s, is_near),
        "budget_s": _delay_s(after, scenario.event_s, lambda belief: belief.budget_bytes_per_second <= 1.1 * truth),
    }


def _outage(course: Sequence[Instant], scenario: Scenario) -> dict[str, float | None]:
    (start_s, end_s), *_ = scenario.outages
    gone = [instant for instant in course if start_s < instant.t_s <= end_s]
    back = [instant for instant in course if instant.t_s > end_s]
    truth = scenario.rates.rate_at(end_s)
    usual = [i.belief.budget_bytes_per_second for i in course if i.belief is not None and i.t_s <= start_s]
    little = _CLOSED * usual[-1] if usual else 0.0
    found = {
        "closed_s": _delay_s(gone, start_s, lambda belief: belief.budget_bytes_per_second <= little),
        "recovery_s": _delay_s(back, end_s, _knows(0.8 * truth)),
    }
    if course[0].carried_bytes is not None:
        found["traffic_back_s"] = _traffic_back_s(course, start_s, end_s)
    return found


def _traffic_back_s(course: Sequence[Instant], start_s: float, end_s: float) -> float | None:
    """Return when a second of traffic is 80 % of that before the outage (s); None = never."""
    carried = {round(instant.t_s, 1): instant.carried_bytes or 0 for instant in course}

    def within(from_s: float, to_s: float) -> float:
        return (carried[round(to_s, 1)] - carried[round(from_s, 1)]) / (to_s - from_s)

    usual = within(start_s - SETTLED_S / 2, start_s)
    for instant in course:
        if instant.t_s >= end_s + 1.0 and within(instant.t_s - 1.0, instant.t_s) >= 0.8 * usual:
            return instant.t_s - end_s
    return None


def _knows(least: float) -> Callable[[Belief], bool]:
    return lambda belief: belief.estimate_bytes_per_second >= least


def _delay_s(course: Sequence[Instant], since_s: float, is_so: Callable[[Belief], bool]) -> float | None:
    """Return how long after ``since_s`` ``is_so`` begins to hold for a second (s); None = never."""
    began_s: float | None = None
    for instant in course:
        if instant.belief is None:
            continue  # the answer was late
        if not is_so(instant.belief):
            began_s = None
        elif began_s is None:
            began_s = instant.t_s
        if began_s is not None and instant.t_s - began_s >= _HOLD_S - 1e-6:
            return began_s - since_s
    return None


def gather(runs: Sequence[dict[str, float | None]], name: str) -> tuple[float | None, float | None] | None:
    """Return median and worst of a figure over some runs, with None for never; None if no run has the figure.

    The worst bias is the one farthest from 0; the worst utilisation is the least.
    """
    values = [run[name] for run in runs if name in run]
    if not values:
        return None
    known = sorted((value for value in values if value is not None), key=_badness(name))
    ordered = [*known, *[None] * (len(values) - len(known))]
    middle = ordered[(len(ordered) - 1) // 2] if None in ordered else median(known)
    return middle, ordered[-1]


def _badness(name: str) -> Callable[[float], float]:
    return {"bias": abs, "utilisation": lambda value: -value}.get(name, lambda value: value)
