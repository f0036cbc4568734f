"""Silence of the peers: a dead peer or a dead link."""

from __future__ import annotations

import math
from collections import deque
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


class Silence:
    """Distinguishes a dead peer from a dead link: over a link that works, readers keep acknowledging.

    It compares the packets that the interface receives with their usual number while a peer was heard. Where they are
    too few to judge by, the silence is an outage for some seconds, and for longer only while next to nothing passes in
    one direction.
    """

    def __init__(self) -> None:
        self._looks: deque[tuple[float, LinkCounters]] = deque()
        self._usual_hz = 0.0
        self._heard_s = math.inf  # when a peer was heard last, or the interface came up since; at first none ever was
        self._quiet: tuple[float, LinkCounters] | None = None  # start of the span that counts

    def note(self, now_s: float, counters: LinkCounters | None, *, is_usual: bool) -> None:
        """Note the counters of the interface; ``is_usual`` is True while a peer is heard."""
        if counters is None or not counters.is_up:
            self._looks.clear()
            self._quiet = None
            if self._heard_s < math.inf:
                self._heard_s = now_s
            return
        if is_usual:
            self._heard_s, self._quiet = now_s, None
            if self._looks and (elapsed_s := now_s - self._looks[-1][0]) > 0:
                rate_hz = (counters.rx_packets - self._looks[-1][1].rx_packets) / elapsed_s
                self._usual_hz -= math.expm1(-elapsed_s / _USUAL_S) * (rate_hz - self._usual_hz)
        elif self._quiet is None and now_s - self._heard_s >= _UNDER_WAY_S:
            self._quiet = now_s, counters
        self._looks.append((now_s, counters))
        while len(self._looks) > 1 and now_s - self._looks[1][0] >= _TRICKLE_S:
            self._looks.popleft()

    @property
    def is_answered(self) -> bool:
        """True when about as many packets as usual arrived lately."""
        if not self._looks or self._usual_hz < _LEAST_HZ:
            return False
        now_s, now = self._looks[-1]
        since_s, before = next((each for each in reversed(self._looks) if now_s - each[0] >= _LATELY_S), self._looks[0])
        span_s = now_s - since_s
        return span_s >= 0.5 * _LATELY_S and now.rx_packets - before.rx_packets >= _PART * self._usual_hz * span_s

    @property
    def is_cut(self) -> bool:
        """True while next to nothing passes in one direction: there is no link, or nobody behind it."""
        if self._quiet is None:
            return False
        (since_s, quiet), (now_s, now) = self._quiet, self._looks[-1]
        if now_s - since_s >= _LONG_S and now.rx_packets - quiet.rx_packets < _BROADCAST_HZ * (now_s - since_s):
            return True
        # Next to nothing leaves although more waits: a trickle is no capacity.
        looks = [each for each in self._looks if each[0] >= since_s]
        since_s, before = looks[0]
        # A few drops are a bad moment of an idle link, so drops must outnumber departures.
        is_refused = now.tx_dropped - before.tx_dropped > now.tx_packets - before.tx_packets
        wants_more = is_refused or all(counters.backlog_bytes for _, counters in looks)
        is_trickle = now.tx_bytes - before.tx_bytes < _TRICKLE_BYTES_PER_SECOND * (now_s - since_s)
        return now_s - since_s >= _TRICKLE_S and wants_more and is_trickle
