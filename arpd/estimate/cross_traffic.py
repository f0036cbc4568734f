"""Cross traffic: bytes on the interface that arpd's topics and probes do not explain."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from arpd.model.endpoints import Direction
from arpd.model.wire import probe_wire_bytes, wire_size

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from arpd.model.endpoints import PublisherState
    from arpd.model.interface import LinkCounters
    from arpd.model.observation import Observation
    from arpd.model.probing import ProbeRequest
    from arpd.model.relay import RelaySummary

_WINDOW_S = 3.0  # announcements come once a second: three of them, so a lost one does not matter
_REMEMBERED_COSTS = 4  # announcements: as many as touch one window
_LOOK_S, _LOOK_S_PER_TOPIC = 0.45, 2e-3  # announcements of many nodes come many times a second
_MEMORY_S = 10.0
# Measured on the demo robot (14 participants, 12 topics; veth and tbf, 5 and 20 Mbit/s): the interface carries 0.10 to
# 0.25 Mbit/s more than the topics and probes explain: discovery, reports, messages of the daemon. The discovery of a
# swap adds 0.3 Mbit/s for a few seconds, and the wire model errs by one or two per cent, so a part of the allowance
# grows with the topics.
_CHATTER_BYTES_PER_SECOND = 40_000.0
_TOPICS_ALLOWANCE = 0.05


class CrossTraffic:
    """Measures the cross traffic; one `update` per tick.

    The counters of the interface come at every tick, those of the publishers once a second, each node at its own time.
    Both become curves over time. They are compared over a window that ends when the last publisher announced itself:
    later samples are unknown, and never guessed.
    """

    def __init__(self) -> None:
        self._carried: _Curve | None = None
        self._counted_bytes = 0  # the interface's own count at the end of `_carried`
        self._extra = _Curve(0.0)  # our own bytes besides the topics' samples
        self._topics: dict[tuple[str, str], _TopicTraffic] = {}
        self._noted: Sequence[PublisherState] | None = None
        self._relay: RelaySummary | None = None
        self._relayed: _Curve | None = None  # bytes of a relay's two ends, in place of the topics'
        self._end_s: float | None = None  # when the publisher that was silent for longest announced itself
        self._looked_s = self._measured_s = -math.inf
        self._rate = 0.0

    def update(self, observation: Observation) -> float:
        """Digest one observation and return the cross traffic, 0 while unknown (bytes/s)."""
        now_s = observation.now_s
        self._note_interface(observation.counters, now_s)
        if observation.relay is not None:
            self._note_relay(observation.relay, now_s)
        elif observation.publishers is not self._noted:
            self._noted, self._relay, self._relayed = observation.publishers, None, None
            ends_s = [self._note_publisher(publisher, now_s) for publisher in observation.publishers]
            self._end_s = min(ends_s, default=None)
        if now_s - self._looked_s < max(_LOOK_S, _LOOK_S_PER_TOPIC * len(self._topics)):
            return self._rate
        self._looked_s = now_s
        self._forget(now_s - 1.5 * _MEMORY_S)
        end_s = now_s if self._end_s is None else self._end_s
        known_s = -math.inf if self._relayed is None else self._relayed.oldest_s
        if self._carried is None or end_s - _WINDOW_S < max(known_s, self._carried.oldest_s):
            self._rate = 0.0
        elif end_s != self._measured_s:
            self._measured_s, self._rate = end_s, self._measure(self._carried, end_s)
        return self._rate

    def note_probe(self, request: ProbeRequest, now_s: float, *, peers: int) -> None:
        """Note a probe of ours: before the first estimate, trains exceed every allowance."""
        self._extra.jump(now_s, peers * request.packets * probe_wire_bytes(request.packet_bytes))

    def probe_bytes(self, since_s: float) -> float:
        """Return the bytes of our own that no topic sent since then (bytes)."""
        return self._extra.since(since_s)

    def note_outage(self, start_s: float, end_s: float) -> None:
        """Note that nothing arrived in a span of time: writers send its samples again now."""
        before, after = self._sent_by(np.array([start_s, end_s]))
        self._extra.jump(end_s, after - before)

    def _measure(self, carried: _Curve, end_s: float) -> float:
        """Return the bytes of the window without topics, probes and allowances (bytes/s)."""
        window = np.array([end_s - _WINDOW_S, end_s])
        sent = self._sent_by(window)
        unexplained = float(np.diff(carried.each_at(window) - sent - self._extra.each_at(window))[0])
        allowed = _TOPICS_ALLOWANCE * float(sent[1] - sent[0])
        return max(0.0, (unexplained - allowed) / _WINDOW_S - _CHATTER_BYTES_PER_SECOND)

    def _sent_by(self, moments: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the bytes that all topics put on the link up to each moment; only differences mean something."""
        if self._relayed is not None:
            return self._relayed.each_at(moments)
        return sum((topic.sent_by(moments) for topic in self._topics.values()), np.zeros_like(moments))

    def _note_interface(self, counters: LinkCounters | None, now_s: float) -> None:
        if counters is None:
            self._carried = None
            return
        counted = counters.tx_bytes + counters.rx_bytes
        if self._carried is None:
            self._carried = _Curve(now_s)  # a new interface: nobody knows what it carried meanwhile
        else:
            self._carried.grow(now_s, counted - self._counted_bytes)
        self._counted_bytes = counted

    def _note_relay(self, relay: RelaySummary, now_s: float) -> None:
        """Note what a relay's two ends say: a large sample of theirs takes long, and calls are no topic."""
        last, self._relay = self._relay, relay
        if self._relayed is None or last is None or relay.link_bytes < last.link_bytes:
            self._relayed = _Curve(now_s)
        elif relay is not last:
            self._relayed.grow(now_s, relay.link_bytes - last.link_bytes)
        self._end_s = self._relayed.newest_s

    def _note_publisher(self, publisher: PublisherState, now_s: float) -> float:
        """Note the announcement of a publisher, and return the time of its last one (s)."""
        key = publisher.node, publisher.topic
        at_s = min(now_s, publisher.announced_at_s)
        if (topic := self._topics.get(key)) is None:
            topic = self._topics[key] = _TopicTraffic(publisher, at_s)
        elif topic.publisher is not publisher:
            topic.note(publisher, at_s)
        return topic.samples.newest_s

    def _forget(self, before_s: float) -> None:
        self._extra.forget(before_s)
        if self._relayed is not None:
            self._relayed.forget(before_s)
        if self._carried is not None:
            self._carried.forget(before_s)
        # A publisher that left stays for as long as its samples matter.
        self._topics = {key: topic for key, topic in self._topics.items() if topic.samples.newest_s >= before_s}
        for topic in self._topics.values():
            topic.samples.forget(before_s)


class _TopicTraffic:
    """Bytes that one publisher put on the link, by its announcements.

    A sample takes the most bytes that recent announcements imply: the graph shows a reader up to a second after that
    reader's first sample, and a reader that left received what was sent before.

    Parameters
    ----------
    publisher : its first announcement; up to then it is assumed to have published steadily
    at_s : time of that announcement (s)
    """

    def __init__(self, publisher: PublisherState, at_s: float) -> None:
        rate_hz = min(publisher.rate_hz, publisher.source_rate_hz)
        steady_s = min(_MEMORY_S, publisher.published / rate_hz) if rate_hz > 0 else 0.0
        self.publisher = publisher  # as announced last
        self._published = publisher.published
        self.samples = _Curve(at_s - steady_s)
        self.samples.grow(at_s, steady_s * rate_hz)
        self._costs = deque([_wire_bytes(publisher, rate_hz)], maxlen=_REMEMBERED_COSTS)

    def note(self, publisher: PublisherState, at_s: float) -> None:
        """Note an announcement; a repeated one changes nothing."""
        self.publisher = publisher
        if at_s <= self.samples.newest_s:
            return
        if publisher.published < self._published:
            self._published = 0  # the node restarted and counts from zero
        samples, self._published = publisher.published - self._published, publisher.published
        self._costs.append(_wire_bytes(publisher, samples / (at_s - self.samples.newest_s)))
        self.samples.grow(at_s, samples)

    def sent_by(self, moments: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return its bytes on the link up to each moment; only differences mean something."""
        return max(self._costs) * self.samples.each_at(moments)


class _Curve:
    """Sum over time, known at some moments and linear between them; 0 at the first moment, ``at_s``."""

    def __init__(self, at_s: float) -> None:
        self._times = [at_s]
        self._sums = [0.0]

    @property
    def oldest_s(self) -> float:
        return self._times[0]

    @property
    def newest_s(self) -> float:
        return self._times[-1]

    def since(self, at_s: float) -> float:
        """Return what came after a moment, of a curve that only jumps."""
        return self._sums[-1] - self._sums[max(0, bisect_right(self._times, at_s) - 1)]

    def grow(self, at_s: float, amount: float) -> None:
        """Add an amount that came since the last moment; an earlier moment counts as that one."""
        self._times.append(max(at_s, self._times[-1]))
        self._sums.append(self._sums[-1] + amount)

    def jump(self, at_s: float, amount: float) -> None:
        """Add an amount that came at once."""
        self.grow(at_s, 0.0)
        self.grow(at_s, amount)

    def each_at(self, moments: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sum at each moment; it is constant before the first and after the last known one."""
        return np.interp(moments, self._times, self._sums)

    def forget(self, before_s: float) -> None:
        """Forget what only moments before ``before_s`` need."""
        gone = bisect_right(self._times, before_s) - 1
        if gone > 0:
            del self._times[:gone], self._sums[:gone]


def _wire_bytes(publisher: PublisherState, rate_hz: float) -> float:
    """Return the link bytes of one sample, as in `arpd.solve.topics`; 0 when no other host reads the topic."""
    if publisher.direction is Direction.LOCAL:
        return 0.0
    return wire_size(publisher.payload_bytes, rate_hz=rate_hz)[0] * publisher.copies
