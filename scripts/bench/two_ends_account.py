"""Accounting of `two_ends.py`: what was sent, what arrived, and where the rest stayed."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

NEAR, FAR = "near", "far"


@dataclass(frozen=True, kw_only=True, slots=True)
class Death:
    """A kill of an end, and when its next process could reach the other end (monotonic s).

    Parameters
    ----------
    host : of the end
    killed_s : time of the kill
    started_s : start of the next process; with the link out, the end of the outage
    """

    host: str
    killed_s: float
    started_s: float


def reachable(death: Death, outages: Iterable[tuple[float, float]]) -> Death:
    """Return a death that lasts until the end of the outage in which the next process starts.

    Parameters
    ----------
    outages : begin and end of each (monotonic s)
    """
    over_s = max((over_s for begin_s, over_s in outages if begin_s <= death.started_s), default=death.started_s)
    return replace(death, started_s=max(death.started_s, over_s))


@dataclass(frozen=True, kw_only=True, slots=True)
class Gap:
    """The time around a death in which a writer's samples did not cross (monotonic s).

    Parameters
    ----------
    end : ``near`` if the end on the writer's host died, else ``far``
    begin_s : when the last sample was sent that crossed before the kill
    over_s : when the first sample was sent that crossed after the new start
    again_s : time from the new start to that sample; None if the next kill came first
    """

    end: str
    begin_s: float
    over_s: float
    again_s: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Reading:
    """Counters of a publisher on the link, as arpd's status shows them (samples)."""

    at_s: float
    offered: int
    published: int
    withheld: int


def unfolded(spans: Iterable[Sequence[int]]) -> set[int]:
    """Return the numbers in spans of first and last."""
    return {number for first, last in spans for number in range(first, last + 1)}


def gaps(sent_s: Sequence[float], arrived: set[int], deaths: Iterable[Death], host: str) -> list[Gap]:
    """Return a gap per death, in order.

    Parameters
    ----------
    sent_s : when each sample was sent, by its number
    arrived : numbers that arrived
    host : host of the writer
    """
    crossed_s = [sent_s[number] for number in sorted(arrived)]
    found = []
    ordered = sorted(deaths, key=lambda each: each.killed_s)
    for death in ordered:
        before, after = bisect_left(crossed_s, death.killed_s), bisect_left(crossed_s, death.started_s)
        over_s = crossed_s[after] if after < len(crossed_s) else float("inf")
        is_cut_short = any(death.killed_s < other.killed_s < over_s for other in ordered)
        found.append(
            Gap(
                end=NEAR if death.host == host else FAR,
                begin_s=crossed_s[before - 1] if before else float("-inf"),
                over_s=over_s,
                again_s=None if is_cut_short else over_s - death.started_s,
            )
        )
    return found


def missing(sent_s: Sequence[float], arrived: set[int], found: Sequence[Gap]) -> tuple[dict[str, int], list[int]]:
    """Count the missing samples that the gaps explain, by the end that was dead; list the others.

    Where both ends were dead, the sample counts for the near one: it never reached arpd.
    """
    counts, others = {NEAR: 0, FAR: 0}, []
    for number, at_s in enumerate(sent_s):
        if number not in arrived:
            ends = {gap.end for gap in found if gap.begin_s < at_s < gap.over_s}
            if ends:
                counts[NEAR if NEAR in ends else FAR] += 1
            else:
                others.append(number)
    return counts, others


def widened(found: Sequence[Gap], readings: Sequence[Reading]) -> list[Gap]:
    """Let each gap begin and end with a reading, so that the counters outside of the gaps are known."""
    times = [reading.at_s for reading in readings]
    wide = []
    for gap in found:
        before, after = bisect_right(times, gap.begin_s), bisect_left(times, gap.over_s)
        wide.append(
            Gap(
                end=gap.end,
                begin_s=times[before - 1] if before else float("-inf"),
                over_s=times[after] if after < len(times) else float("inf"),
                again_s=gap.again_s,
            )
        )
    return wide


def withheld_outside(readings: Sequence[Reading], found: Sequence[Gap]) -> int:
    """Count what pacing withheld outside of the gaps; the counters start again with each life of the publisher."""
    total = 0
    before = Reading(at_s=float("-inf"), offered=0, published=0, withheld=0)
    for reading in readings:
        base = before.withheld if reading.offered >= before.offered else 0
        is_inside = any(gap.begin_s < reading.at_s <= gap.over_s for gap in found)
        if not is_inside:
            total += reading.withheld - base
        before = reading
    return total


def withheld(readings: Sequence[Reading]) -> int:
    """Count everything that pacing withheld."""
    return withheld_outside(readings, [])


def sets_of(arrived: Sequence[set[int]]) -> tuple[set[int], set[int]]:
    """Return the sets that arrived complete, and those that arrived in part."""
    complete = set.intersection(*arrived)
    return complete, set.union(*arrived) - complete


def row(
    writers: Sequence[tuple[str, Sequence[float], dict[str, Any]]],
    readings: Sequence[Reading],
    deaths: Sequence[Death],
    *,
    host: str,
) -> dict[str, Any]:
    """Return what became of the samples of one topic's writers on one host.

    Parameters
    ----------
    writers : of each its name, when it sent its samples, and what the reader noted
    readings : counters of the topic's publisher on the link, which has the samples of all these writers
    """
    by_writer = []
    for name, sent_s, noted in writers:
        arrived = unfolded(noted["spans"])
        around = gaps(sent_s, arrived, deaths, host)
        found = widened(around, readings) if (thinned := withheld(readings) > 0) else around
        counts, others = missing(sent_s, arrived, found)
        by_writer.append(
            {
                "writer": name,
                "sent": len(sent_s),
                "received": len(arrived),
                "while_near_dead": counts[NEAR],
                "while_far_dead": counts[FAR],
                "doubled": noted["doubled"],
                "reordered": noted["late"],
                "missing_otherwise": len(others),
                "first_missing_s": [] if thinned else [sent_s[number] for number in others[:20]],
                "again_s": [gap.again_s for gap in around if gap.again_s is not None and gap.over_s != float("inf")],
                "never_again": sum(gap.over_s == float("inf") for gap in around),
            }
        )
    _, sent_s, noted = writers[0]
    found = gaps(sent_s, unfolded(noted["spans"]), deaths, host)
    outside = withheld_outside(readings, widened(found, readings))
    return {
        "host": host,
        "writers": by_writer,
        "withheld": withheld(readings),
        "withheld_outside": outside,
        "lost": sum(each["missing_otherwise"] for each in by_writer) - outside,
    }
