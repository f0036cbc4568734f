"""The errors, the reactions and the cost of arpd's estimate, from the course of a run of `adapt.py`."""

from __future__ import annotations

from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING

from arpd.adapters.sim.result import percentile

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from scripts.bench.adapt_course import Belief, Instant
    from scripts.bench.adapt_links import Link

Figures = dict[str, float | None]  # None = never

START_S = 10.0  # on a steady link: the first plan follows the sources' start, and its swaps take a few seconds
SETTLED_S = 8.0  # the target for a rise is 7 s; a later difference is an error, not a reaction
_CLOSED = 0.1  # of the budget just before an outage
_NEAR = 0.15
_HOLD_S = 1.0  # a belief must stay right for so long


def estimate_figures(course: Sequence[Instant], link: Link) -> Figures:
    """Return the figures that apply to this link; only ``start_queue_s`` is from before its first change.

    Without arpd, these are the queue and the share of the link that was carried.
    """
    event_s = link.changes_s[0] if link.changes_s else START_S
    after = [instant for instant in course if instant.t_s > event_s]
    could_carry = sum(now.truth_bytes_per_second * (now.t_s - before.t_s) for before, now in pairwise(after))
    found: Figures = {
        "start_queue_s": max(instant.queue_delay_s for instant in course if instant.t_s <= event_s),
        "peak_queue_s": max(instant.queue_delay_s for instant in after),
        "utilisation": (after[-1].carried_bytes - after[0].carried_bytes) / could_carry,
    }
    if beliefs := [instant.belief for instant in after if instant.belief is not None]:
        found |= _errors(course, link) | _costs(beliefs, could_carry, after[-1].t_s - after[0].t_s)
        if link.outages:
            found |= _outage(course, link)
        elif len(link.changes_s) == 1 and not link.losses:
            found |= _step(after, link)
    return found


def _errors(course: Sequence[Instant], link: Link) -> Figures:
    """Return the errors of the estimate while the link has been as it is for some time."""
    off = [
        instant.belief.estimate_bytes_per_second / instant.truth_bytes_per_second - 1.0
        for instant in course
        if instant.belief is not None
        and instant.truth_bytes_per_second > 0
        and instant.t_s - max((c for c in link.changes_s if c <= instant.t_s), default=0.0) >= SETTLED_S
    ]
    if not off:
        return {}
    sizes = [abs(error) for error in off]
    return {"error_median": median(sizes), "error_p90": percentile(sizes, 0.9), "bias": median(off)}


def _costs(beliefs: Sequence[Belief], could_carry: float, duration_s: float) -> Figures:
    first, last = beliefs[0], beliefs[-1]
    swaps = max(belief.swaps for belief in beliefs) - first.swaps  # silent publishers are missing from the last
    return {
        "probe_share": (last.probe_bytes - first.probe_bytes) / could_carry,
        "report_share": (last.report_bytes - first.report_bytes) / could_carry,
        "plans_per_minute": (last.levels - first.levels) * 60.0 / duration_s,
        "swaps_per_minute": swaps * 60.0 / duration_s,
    }


def _step(after: Sequence[Instant], link: Link) -> Figures:
    (event_s,) = link.changes_s
    before, truth = link.rates.rate_at(0.0), link.rates.rate_at(event_s)
    if truth > before:
        return {"rise_s": _delay_s(after, event_s, _knows(0.8 * truth))}

    def is_near(belief: Belief) -> bool:
        return abs(belief.estimate_bytes_per_second / truth - 1.0) <= _NEAR

    return {
        "reaction_s": _delay_s(after, event_s, is_near),
        "budget_s": _delay_s(after, event_s, lambda belief: belief.budget_bytes_per_second <= 1.1 * truth),
    }


def _outage(course: Sequence[Instant], link: Link) -> Figures:
    (start_s, end_s), *_ = link.outages
    gone = [instant for instant in course if start_s < instant.t_s <= end_s]
    back = [instant for instant in course if instant.t_s > end_s]
    usual = [i.belief.budget_bytes_per_second for i in course if i.belief is not None and i.t_s <= start_s]
    little = _CLOSED * usual[-1] if usual else 0.0
    return {
        "closed_s": _delay_s(gone, start_s, lambda belief: belief.budget_bytes_per_second <= little),
        "recovery_s": _delay_s(back, end_s, _knows(0.8 * link.rates.rate_at(end_s))),
        "traffic_back_s": _traffic_back_s(course, start_s, end_s),
    }


def _traffic_back_s(course: Sequence[Instant], start_s: float, end_s: float) -> float | None:
    """Return when a second of traffic is 80 % of that before the outage (s); None = never."""
    carried = {round(instant.t_s, 1): instant.carried_bytes for instant in course}

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
