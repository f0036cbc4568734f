"""Silence of the peers: a dead peer or a dead link."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from arpd.model.interface import LinkCounters

_LATELY_S = 0.3
_USUAL_S = 5.0  # time constant of the usual rate
_LEAST_HZ = 30.0  # packets; fewer show nothing within `_LATELY_S`, and some are the peer's own reports
_PART = 0.5  # of the usual rate
_UNDER_WAY_S = 1.0  # what was on its way when the peer fell silent has arrived by then
_LONG_S = 5.0
_BROADCAST_HZ = 0.5  # packets; a host that reads anything acknowledges more often, and its DDS announces itself
_TRICKLE_S = 3.0
# A full frame takes 0.3 s at this rate; a ping or report behind one is late enough for an outage.
_TRICKLE_BYTES_PER_SECOND = 5_000.0


@dataclass(frozen=True, kw_only=True, slots=True)
class _Departures:
    """Counters of what left the interface, and whether more waited."""

    at_s: float
    sent_bytes: int
    sent_packets: int
    dropped: int
    waits: bool


class Silence:
    """Distinguishes a dead peer from a dead link: over a link that works, readers keep acknowledging.

    It compares the packets that the interface receives with their usual number while a peer was heard. Where they are
    too few to judge by, the silence is an outage for some seconds, and for longer only while next to nothing passes in
    one direction.
    """

    def __init__(self) -> None:
        self._looks: deque[tuple[float, int]] = deque()  # time s, packets received
        self._usual_hz = 0.0
        self._was_heard = False  # any peer, ever
        self._unheard_s: float | None = None  # since when no peer is heard
        self._quiet: tuple[float, int] | None = None  # start s and packets of the span that counts
        self._departures: deque[_Departures] = deque()  # in that span

    def note(self, now_s: float, counters: LinkCounters | None, *, is_usual: bool) -> None:
        """Note the counters of the interface; ``is_usual`` is True while a peer is heard."""
        if counters is None or not counters.is_up:
            self._looks.clear()
            self._unheard_s = self._quiet = None
            self._departures.clear()
            return
        self._follow_silence(now_s, counters.rx_packets, is_usual=is_usual)
        self._follow_departures(now_s, counters)
        if is_usual and self._looks and (elapsed_s := now_s - self._looks[-1][0]) > 0:
            rate_hz = (counters.rx_packets - self._looks[-1][1]) / elapsed_s
            self._usual_hz += (1.0 - math.exp(-elapsed_s / _USUAL_S)) * (rate_hz - self._usual_hz)
        self._looks.append((now_s, counters.rx_packets))
        while len(self._looks) > 1 and now_s - self._looks[1][0] >= _LATELY_S:
            self._looks.popleft()

    @property
    def is_answered(self) -> bool:
        """True when about as many packets as usual arrived lately."""
        if not self._looks or (span_s := self._looks[-1][0] - self._looks[0][0]) < 0.5 * _LATELY_S:
            return False
        lately_hz = (self._looks[-1][1] - self._looks[0][1]) / span_s
        return self._usual_hz >= _LEAST_HZ and lately_hz >= _PART * self._usual_hz

    @property
    def is_cut(self) -> bool:
        """True while next to nothing passes in one direction: there is no link, or nobody behind it."""
        return self.has_received_nothing or self.has_sent_nothing

    @property
    def has_received_nothing(self) -> bool:
        """True when next to nothing has arrived since a peer was heard."""
        if self._quiet is None or not self._looks:
            return False
        (since_s, before), (now_s, packets) = self._quiet, self._looks[-1]
        return now_s - since_s >= _LONG_S and packets - before < _BROADCAST_HZ * (now_s - since_s)

    @property
    def has_sent_nothing(self) -> bool:
        """True when next to nothing leaves although more waits: a trickle is no capacity."""
        if self._quiet is None or not self._departures:
            return False
        oldest, newest = self._departures[0], self._departures[-1]
        span_s = newest.at_s - oldest.at_s
        # A few drops are a bad moment of an idle link, so drops must outnumber departures.
        is_refused = newest.dropped - oldest.dropped > newest.sent_packets - oldest.sent_packets
        wants_more = is_refused or all(each.waits for each in self._departures)
        return (
            span_s >= _TRICKLE_S
            and wants_more
            and newest.sent_bytes - oldest.sent_bytes < _TRICKLE_BYTES_PER_SECOND * span_s
        )

    def _follow_departures(self, now_s: float, counters: LinkCounters) -> None:
        if self._quiet is None:
            self._departures.clear()
            return
        self._departures.append(
            _Departures(
                at_s=now_s,
                sent_bytes=counters.tx_bytes,
                sent_packets=counters.tx_packets,
                dropped=counters.tx_dropped,
                waits=bool(counters.backlog_bytes),
            )
        )
        while len(self._departures) > 1 and now_s - self._departures[1].at_s >= _TRICKLE_S:
            self._departures.popleft()

    def _follow_silence(self, now_s: float, packets: int, *, is_usual: bool) -> None:
        self._was_heard |= is_usual
        if is_usual or not self._was_heard:
            self._unheard_s = self._quiet = None
        elif self._unheard_s is None:
            self._unheard_s = now_s
        elif self._quiet is None and now_s - self._unheard_s >= _UNDER_WAY_S:
            self._quiet = now_s, packets
