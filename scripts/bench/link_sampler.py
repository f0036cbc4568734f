"""Readings of a real run: the token bucket's queue from the kernel, arpd's beliefs from its status page."""

from __future__ import annotations

import contextlib
import json
import threading
import time
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from pyroute2 import IPRoute

from scripts.bench.link_course import Belief, Instant
from scripts.netns.namespaces import inside

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from scripts.netns.simlink import Host

BUCKET_S = 0.02
STATUS_S = 0.1
INSTANT_S = 0.1
_STALE_S = 0.5
_ALSO_COUNTED = "undelivered"  # such a swap has a second result


@dataclass(frozen=True, kw_only=True, slots=True)
class BucketReading:
    """The robot's token bucket: its rate, the bytes in its queue, and all bytes that have left it.

    Parameters
    ----------
    at_s : monotonic clock (s)
    """

    at_s: float
    rate_bytes_per_second: float
    backlog_bytes: int
    sent_bytes: int


class Sampler:
    """The readings of two threads inside the robot's namespace, during the ``with`` block of `sampling`.

    Parameters
    ----------
    url : arpd's status page, as seen from the robot
    report_wire_bytes : size of one of the peer's reports on the link (bytes)
    """

    def __init__(self, url: str, report_wire_bytes: int) -> None:
        self._url = url
        self._report_wire_bytes = report_wire_bytes
        self.buckets: list[BucketReading] = []
        self.beliefs: list[tuple[float, Belief]] = []
        self._is_over = threading.Event()

    def stop(self) -> None:
        """End both threads."""
        self._is_over.set()

    def watch_bucket(self, host: Host) -> None:
        """Read the bucket fifty times a second."""
        with IPRoute() as route:
            index = route.link_lookup(ifname=host.interface)[0]
            while not self._is_over.wait(BUCKET_S):
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
        """Ask arpd ten times a second; there is no belief while it does not answer."""
        while not self._is_over.wait(STATUS_S):
            with (
                contextlib.suppress(OSError, urllib.error.URLError, json.JSONDecodeError),
                urllib.request.urlopen(self._url, timeout=3.0) as answer,
            ):
                document = json.load(answer)
                self.beliefs.append((time.monotonic(), believed(document, report_wire_bytes=self._report_wire_bytes)))

    def course(self, *, started_s: float, duration_s: float) -> tuple[Instant, ...]:
        """Return the run in tenths of a second."""
        return make_course(self.buckets, self.beliefs, started_s=started_s, duration_s=duration_s)


@contextlib.contextmanager
def sampling(host: Host, *, is_managed: bool, url: str, report_wire_bytes: int) -> Iterator[Sampler]:
    """Read the robot's end of the link, and arpd if it runs; the other parameters are those of `Sampler`."""
    sampler = Sampler(url, report_wire_bytes)
    jobs: list[Callable[[], None]] = [partial(sampler.watch_bucket, host)]
    jobs += [sampler.watch_status] if is_managed else []
    with ThreadPoolExecutor(max_workers=len(jobs)) as pool:
        watching = [pool.submit(partial(inside, host.namespace, job)) for job in jobs]
        try:
            yield sampler
        finally:
            sampler.stop()
        for watch in watching:
            watch.result()  # raises the error that ended it early


def believed(document: dict[str, Any], *, report_wire_bytes: int) -> Belief:
    """Read a status document, which counts reports but not their bytes."""
    link, totals = document["link"], document["totals"]
    return Belief(
        estimate_bytes_per_second=link["capacity_bytes_per_second"],
        foreign_bytes_per_second=link["foreign_bytes_per_second"],
        budget_bytes_per_second=document["allocation"]["capacity_bytes_per_second"],
        level_bytes_per_second=document["level_bytes_per_second"],
        kind=link["kind"],
        state=link["state"],
        queue_delay_s=link["queue_delay_seconds"],
        generation=document["plan"]["generation"],
        levels_by_cause=totals["levels"],
        swaps=sum(
            sum(count for result, count in topic["swaps"].items() if result != _ALSO_COUNTED)
            for topic in document["topics"]
        ),
        probe_bytes=totals["probe_bytes"],
        report_bytes=totals["reports"] * report_wire_bytes,
    )


def make_course(
    buckets: Sequence[BucketReading], beliefs: Sequence[tuple[float, Belief]], *, started_s: float, duration_s: float
) -> tuple[Instant, ...]:
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
        instants.append(
            Instant(
                t_s=(k + 1) * INSTANT_S,
                truth_bytes_per_second=before.rate_bytes_per_second,
                queue_delay_s=max(b.backlog_bytes / b.rate_bytes_per_second for b in seen or [before]),
                carried_bytes=before.sent_bytes - sent_at_start,
                belief=newest[1] if newest and end_s - newest[0] <= _STALE_S else None,
            )
        )
    return tuple(instants)
