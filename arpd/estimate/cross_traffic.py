"""Cross traffic: bytes on the interface that arpd's topics and probes do not explain."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

from arpd.model.wire import probe_wire_bytes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.model.endpoints import PublisherState
    from arpd.model.interface import LinkCounters
    from arpd.model.observation import Observation
    from arpd.model.probing import ProbeRequest
    from arpd.model.relay import RelaySummary

_WINDOW_S = 3.0  # announcements come once a second: three of them, so a lost one does not matter
_REMEMBERED_COSTS = 4  # announcements: as many as touch one window
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
    They are compared over a window that ends when the last publisher announced itself: later samples are unknown, and
    never guessed.
    """

    def __init__(self) -> None:
        self._carried, self._sent, self._probes = _Bins(), _Bins(), _Bins()
        self._counted: tuple[float, int] | None = None  # when the interface was read last (s), and its bytes
        self._topics: dict[tuple[str, str], _TopicTraffic] = {}
        self._noted: Sequence[PublisherState] | None = None
        self._told_s = math.inf  # last announcement of the publisher that was silent for longest (s)
        self._relay: tuple[float, RelaySummary] | None = None  # when it was told first (s)
        self._known_from_s = math.inf
        self._resent_until_s, self._most = -math.inf, math.inf
        self._rate = 0.0

    def update(self, observation: Observation) -> float:
        """Digest one observation and return the cross traffic, 0 while unknown (bytes/s)."""
        now_s, end_s = observation.now_s, observation.now_s
        self._note_interface(observation.counters, now_s)
        if observation.relay is not None:
            end_s = self._note_relay(observation.relay, now_s)
        elif observation.publishers is not self._noted:
            if self._relay is not None:
                self._relay, self._sent = None, _Bins()
            self._noted = observation.publishers
            self._topics = {key: topic for key, topic in self._topics.items() if now_s - topic.told_s <= _MEMORY_S}
            for publisher in observation.publishers:
                self._note_publisher(publisher, now_s)
            told_s = (self._topics[each.node, each.topic].told_s for each in observation.publishers)
            self._told_s = min(told_s, default=math.inf)
        if self._relay is None:
            end_s = min(end_s, self._told_s)
        if end_s - _WINDOW_S >= self._resent_until_s:
            self._most = math.inf
        if end_s - _WINDOW_S < self._known_from_s:
            self._rate = 0.0
        else:
            carried, sent, probes = (bins.before(end_s) for bins in (self._carried, self._sent, self._probes))
            unexplained = (carried - (1.0 + _TOPICS_ALLOWANCE) * sent - probes) / _WINDOW_S
            self._rate = min(self._most, max(0.0, unexplained - _CHATTER_BYTES_PER_SECOND))
        return self._rate

    def note_probe(self, request: ProbeRequest, now_s: float, *, peers: int) -> None:
        """Note a probe of ours: before the first estimate, trains exceed every allowance."""
        self._probes.add(now_s, now_s, peers * request.packets * probe_wire_bytes(request.packet_bytes))

    def bound(self, until_s: float) -> None:
        """Let what crosses before then show no more than was known: after an outage, what it took is sent again."""
        self._resent_until_s = until_s
        if math.isinf(self._most):
            self._most = self._rate

    def probe_bytes(self, since_s: float) -> float:
        """Return the bytes of the probes since then (bytes)."""
        return self._probes.since(since_s)

    def _note_interface(self, counters: LinkCounters | None, now_s: float) -> None:
        if counters is None:
            self._counted, self._known_from_s = None, math.inf
            return
        counted = counters.tx_bytes + counters.rx_bytes
        if self._counted is None:
            self._known_from_s = now_s  # a new interface: nobody knows what it carried meanwhile
        else:
            before_s, before = self._counted
            self._carried.add(before_s, now_s, counted - before)
        self._counted = now_s, counted

    def _note_relay(self, relay: RelaySummary, now_s: float) -> float:
        """Note what a relay's two ends say, and return when: a large sample takes long, and calls are no topic (s)."""
        at_s, last = self._relay or (now_s, None)
        if last is None or relay.link_bytes < last.link_bytes:
            self._sent, self._known_from_s = _Bins(), now_s
        elif relay is not last:
            self._sent.add(at_s, now_s, relay.link_bytes - last.link_bytes)
        if relay is not last:
            self._relay = now_s, relay
        return at_s if relay is last else now_s

    def _note_publisher(self, publisher: PublisherState, now_s: float) -> None:
        at_s, key = min(now_s, publisher.announced_at_s), (publisher.node, publisher.topic)
        if (topic := self._topics.get(key)) is None:
            # It is assumed to have published steadily before its first announcement.
            rate_hz = min(publisher.rate_hz, publisher.source_rate_hz)
            steady_s = min(_MEMORY_S, publisher.published / rate_hz) if rate_hz > 0 else 0.0
            topic = self._topics[key] = _TopicTraffic(at_s - steady_s, publisher.published - steady_s * rate_hz)
        if at_s > topic.told_s:
            topic.note(publisher, at_s, self._sent)


class _TopicTraffic:
    """Bytes that one publisher put on the link, by its announcements.

    A sample takes the most bytes that recent announcements imply: the graph shows a reader up to a second after that
    reader's first sample, and a reader that left received what was sent before.

    Parameters
    ----------
    told_s, published : time of its last announcement (s), and its samples by then
    """

    def __init__(self, told_s: float, published: float) -> None:
        self.told_s, self._published = told_s, published
        self._costs = deque([0.0], maxlen=_REMEMBERED_COSTS)
        self._since_s, self._samples, self._cost = told_s, 0.0, 0.0  # of the announcement before

    def note(self, publisher: PublisherState, at_s: float, sent: _Bins) -> None:
        """Note an announcement; a node that restarted counts from zero."""
        is_again = publisher.published < self._published
        samples = publisher.published - (0.0 if is_again else self._published)
        self._costs.append(publisher.wire_bytes(samples / (at_s - self.told_s)))
        cost = max(self._costs)
        sent.add(self._since_s, self.told_s, self._samples * max(0.0, cost - self._cost))
        sent.add(self.told_s, at_s, samples * cost)
        self._since_s, self._samples, self._cost = self.told_s, samples, cost
        self.told_s, self._published = at_s, publisher.published


class _Bins:
    """Bytes over the last seconds, in tenths."""

    def __init__(self) -> None:
        self._bytes: dict[int, float] = {}

    def add(self, start_s: float, end_s: float, amount: float) -> None:
        """Spread an amount over a span, or over a moment; at times, forget what is much older."""
        first, last = math.floor(start_s * 10.0), math.floor(end_s * 10.0)
        for each in range(max(first, last - round(10 * _MEMORY_S)), last + 1):
            covered_s = min(end_s, (each + 1) / 10.0) - max(start_s, each / 10.0)
            part = covered_s / (end_s - start_s) if last > first else 1.0
            self._bytes[each] = self._bytes.get(each, 0.0) + part * amount
        if len(self._bytes) > 20 * _MEMORY_S:
            self._bytes = {each: amount for each, amount in self._bytes.items() if each > last - 10 * _MEMORY_S}

    def before(self, end_s: float) -> float:
        """Return the bytes of the window before a moment."""
        last = math.floor(end_s * 10.0)
        return sum(self._bytes.get(each, 0.0) for each in range(last - round(10 * _WINDOW_S), last))

    def since(self, start_s: float) -> float:
        """Return the bytes since about a moment."""
        first = math.floor(start_s * 10.0)
        return sum(amount for each, amount in self._bytes.items() if each >= first)
