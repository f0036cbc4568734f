"""The course of a run of `adapt.py` in tenths of a second: the link as the kernel has it, and arpd's belief of it.

Rate and queue are those of the robot's token bucket, read fifty times a second. Beliefs are arpd's status document,
read ten times a second: every reaction time is known to a tenth of a second and includes the reading.
"""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from pyroute2 import IPRoute

from arpd.model.probing import PeerReport
from arpd.model.wire import probe_wire_bytes
from scripts.bench.adapt_figures import TIMELINE_S
from scripts.bench.adapt_links import OUTAGE_BYTES_PER_SECOND
from scripts.netns.namespaces import inside

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from scripts.netns.simlink import Host
    from scripts.robot.run import Side

INSTANT_S = 0.1
_BUCKET_S, _STATUS_S = 0.02, 0.1
_STALE_S = 0.5
_ALSO_COUNTED = "undelivered"  # such a swap has a second result


@dataclass(frozen=True, kw_only=True, slots=True)
class BucketReading:
    """A reading of the robot's token bucket: its rate, the bytes in its queue, and all bytes that have left it.

    Parameters
    ----------
    at_s : monotonic clock (s)
    """

    at_s: float
    rate_bytes_per_second: float
    backlog_bytes: int
    sent_bytes: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Belief:
    """The state of arpd at one moment.

    Parameters
    ----------
    estimate_bytes_per_second, budget_bytes_per_second : capacity, and total that the topics may use now (bytes/s)
    levels, swaps : plans and QoS swaps so far
    probe_bytes, report_bytes : cost of measuring so far, both ways (wire bytes)
    """

    estimate_bytes_per_second: float
    budget_bytes_per_second: float
    levels: int
    swaps: int
    probe_bytes: int
    report_bytes: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Instant:
    """One tenth of a second.

    Parameters
    ----------
    t_s : time since the sources began to publish (s)
    truth_bytes_per_second : rate of the link, 0 while nothing passes (bytes/s)
    queue_delay_s : longest queue of this tenth, from its bytes and the rate; 0 while nothing passes (s)
    carried_bytes : bytes that have left the robot since the start
    belief : None without arpd, or while it does not answer
    """

    t_s: float
    truth_bytes_per_second: float
    queue_delay_s: float
    carried_bytes: int
    belief: Belief | None = None


class Readings:
    """What two threads read during the ``with`` block of `reading`."""

    def __init__(self, side: Side) -> None:
        self._side = side
        self._report_wire_bytes = report_wire_bytes()
        self.buckets: list[BucketReading] = []
        self.beliefs: list[tuple[float, Belief]] = []
        self.is_over = threading.Event()

    def watch_bucket(self, host: Host) -> None:
        """Read the bucket, from within its namespace."""
        with IPRoute() as route:
            index = route.link_lookup(ifname=host.interface)[0]
            while not self.is_over.wait(_BUCKET_S):
                (bucket,) = (q for q in route.get_qdiscs(index) if q.get("TCA_KIND") == "tbf")
                stats = bucket.get("TCA_STATS2")
                self.buckets.append(
                    BucketReading(
                        at_s=time.monotonic(),
                        rate_bytes_per_second=bucket.get("TCA_OPTIONS").get("TCA_TBF_PARMS")["rate"],
                        backlog_bytes=stats.get("TCA_STATS_QUEUE")["backlog"],
                        sent_bytes=stats.get("TCA_STATS_BASIC")["bytes"],
                    )
                )

    def watch_status(self) -> None:
        """Ask arpd; there is no belief while it does not answer."""
        while not self.is_over.wait(_STATUS_S):
            if document := self._side.status():
                self.beliefs.append((time.monotonic(), believed(document, report_wire_bytes=self._report_wire_bytes)))


@contextmanager
def reading(side: Side) -> Iterator[Readings]:
    """Read the robot's end of the link, and arpd if it runs."""
    readings, host = Readings(side), side.link.robot
    jobs: list[Callable[[], None]] = [partial(inside, host.namespace, partial(readings.watch_bucket, host))]
    jobs += [readings.watch_status] if side.url else []
    with ThreadPoolExecutor(max_workers=len(jobs)) as pool:
        watching = [pool.submit(job) for job in jobs]
        try:
            yield readings
        finally:
            readings.is_over.set()
        for watch in watching:
            watch.result()  # raises the error that ended it early


def report_wire_bytes() -> int:
    """Return the wire size of a report with one delay and no train, as nearly all are (bytes)."""
    from arpd.adapters.ros.probe_messages import encode_report

    report = PeerReport(peer="ceddp", received_at_s=0.0, interval_s=0.1, rx_bytes=0, rx_packets=0, delays_s=(0.0,))
    return probe_wire_bytes(len(encode_report(report).data))


def believed(document: dict[str, Any], *, report_wire_bytes: int) -> Belief:
    """Read a status document, which counts reports but not their bytes."""
    totals = document["totals"]
    return Belief(
        estimate_bytes_per_second=document["link"]["capacity_bytes_per_second"],
        budget_bytes_per_second=document["allocation"]["capacity_bytes_per_second"],
        levels=sum(totals["levels"].values()),
        swaps=sum(
            sum(count for result, count in topic["swaps"].items() if result != _ALSO_COUNTED)
            for topic in document["topics"]
        ),
        probe_bytes=totals["probe_bytes"],
        report_bytes=totals["reports"] * report_wire_bytes,
    )


def course_of(
    buckets: Sequence[BucketReading], beliefs: Sequence[tuple[float, Belief]], *, started_s: float, duration_s: float
) -> list[Instant]:
    """Bring readings at different times to a common grid.

    The queue of an instant is the longest one read in it; rate and belief are the last ones.

    Parameters
    ----------
    buckets, beliefs : readings in the order of time
    started_s : start of the course (monotonic clock, s)
    """
    instants = []
    waiting, answers = list(reversed(buckets)), list(reversed(beliefs))
    newest: tuple[float, Belief] | None = None
    before: BucketReading | None = None
    sent_at_start: int | None = None
    for k in range(round(duration_s / INSTANT_S)):
        end_s = started_s + (k + 1) * INSTANT_S
        seen = []
        while waiting and waiting[-1].at_s <= end_s:
            before = waiting.pop()
            if before.at_s >= started_s:
                seen.append(before)
            else:
                sent_at_start = before.sent_bytes
        while answers and answers[-1][0] <= end_s:
            newest = answers.pop()
        if before is None:
            continue
        if sent_at_start is None:
            sent_at_start = before.sent_bytes
        rate = before.rate_bytes_per_second
        instants.append(
            Instant(
                t_s=(k + 1) * INSTANT_S,
                truth_bytes_per_second=rate if rate > OUTAGE_BYTES_PER_SECOND else 0.0,
                queue_delay_s=max(map(_queue_s, seen or [before])),
                carried_bytes=before.sent_bytes - sent_at_start,
                belief=newest[1] if newest and end_s - newest[0] <= _STALE_S else None,
            )
        )
    return instants


def estimates_over_time(course: Sequence[Instant]) -> list[int | None]:
    """Return the estimate every TIMELINE_S (bytes/s); None where there is no belief."""
    beliefs = [instant.belief for instant in course[:: round(TIMELINE_S / INSTANT_S)]]
    return [None if belief is None else round(belief.estimate_bytes_per_second) for belief in beliefs]


def _queue_s(bucket: BucketReading) -> float:
    passes = bucket.rate_bytes_per_second > OUTAGE_BYTES_PER_SECOND
    return bucket.backlog_bytes / bucket.rate_bytes_per_second if passes else 0.0
