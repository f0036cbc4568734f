"""Measures the topics of this host for some seconds: rate and size, without decoding a message.

It never brings a topic over the link, and costs the robot little: a best-effort reader makes no writer wait, and a
topic of which enough is known is read no more.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rclpy.qos import QoSProfile

from arpd.model.link_topics import LinkTopic, TopicList, TopicTraffic
from arpd.relay.ends.types import UnknownTypeError, message_class
from arpd.ros.graph import GraphView, policies_of
from arpd.ros.link_topics import LinkGraph, cannot_tell_hosts
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample
from arpd.ros.rmw import current_rmw

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

# Processes announce themselves every three seconds; a busy one misses the first announcements of this one.
_DISCOVERY_S, _QUIET_S, _LONGEST_DISCOVERY_S = 3.2, 0.7, 8.0
_LOOK_S, _LOOK_AGAIN_S = 0.1, 1.0  # between looks at the graph, before measuring and while it lasts
_HISTORY_S = 1.0  # in which the history of a latched topic arrives
_DEPTH = 5  # samples that wait for the thread; a lost one counts all the same
_TURN_S = 0.05
_ENOUGH_BYTES, _ENOUGH_SAMPLES = 32e6, 2000
_LEAST_SAMPLES = 10  # of large messages, so that their rate is known
_INSTANT_S = 1e-3  # arrivals are not known better
_SILENT = 10.0  # times as long


@dataclass(slots=True)
class _Writer:
    """Numbers and arrivals of the first and the last sample of one writer (s), and how many arrived."""

    first: int
    first_s: float
    last: int
    last_s: float
    arrived: int = 1

    def rate_hz(self, now_s: float, since_s: float) -> float:
        """Return its rate.

        Between the first and the last of n samples there are n - 1 periods. In a burst these are short, but where none
        was lost there are only n samples until now; a steady writer has at least as many as its periods say. Where some
        were lost the last ones may be, too, but not for ten times as long as all others took.
        """
        samples = self.last - self.first + 1
        if samples == 1:  # its period is unknown, but as long as the wait
            return 1.0 / max(now_s - since_s, _INSTANT_S)
        steady_hz = (samples - 1) / max(self.last_s - self.first_s, _INSTANT_S)
        if self.arrived < samples and now_s - self.last_s < _SILENT * (self.last_s - self.first_s):
            return steady_hz
        return min(steady_hz, samples / max(now_s - self.first_s, _INSTANT_S))


class TopicMeter:
    """Counts the samples of one topic.

    Each writer numbers its samples, so a sample that a best-effort reader lost still counts for the rate. Those of a
    latched topic's history arrive before ``rated_from_s`` (monotonic clock) and count for the size alone.
    """

    def __init__(self, *, rated_from_s: float) -> None:
        self._rated_from_s = rated_from_s
        self._writers: dict[bytes, _Writer] = {}
        self._samples = self._bytes = self._largest = 0

    def add(self, *, writer: bytes, number: int, size_bytes: int, at_s: float) -> None:
        """Take one sample: its writer, its number there, and when it arrived, by the monotonic clock (s)."""
        self._samples += 1
        self._bytes += size_bytes
        self._largest = max(self._largest, size_bytes)
        if at_s < self._rated_from_s:
            return
        known = self._writers.setdefault(writer, _Writer(number, at_s, number, at_s))
        if number > known.last:
            known.last, known.last_s = number, at_s
            known.arrived += 1

    @property
    def has_enough(self) -> bool:
        """True if more samples would cost more than they tell."""
        return self._samples >= _ENOUGH_SAMPLES or (self._bytes >= _ENOUGH_BYTES and self._samples >= _LEAST_SAMPLES)

    def traffic(self, now_s: float) -> TopicTraffic:
        """Return what the samples so far tell; later ones do not count."""
        return TopicTraffic(
            samples=self._samples,
            rate_hz=sum(writer.rate_hz(now_s, self._rated_from_s) for writer in self._writers.values()),
            mean_bytes=self._bytes / self._samples if self._samples else None,
            largest_bytes=self._largest or None,
        )


class TopicSurvey:
    """Finds the topics of the graph, and measures those of this host.

    Parameters
    ----------
    node : node of this process in the robot's domain; nobody needs to spin it
    prefix : under which a relay with one end republishes topics; empty = there is none
    is_of_interest : returns whether to list a topic, by its name
    on_progress : called with the time of the measurement that has passed (s), and what happens
    """

    def __init__(
        self,
        node: Node,
        *,
        prefix: str,
        is_of_interest: Callable[[str], bool],
        on_progress: Callable[[float, str], None],
    ) -> None:
        self._node, self._prefix = node, prefix
        self._is_of_interest, self._on_progress = is_of_interest, on_progress
        self._rmw = current_rmw()
        self._blind = cannot_tell_hosts(self._rmw)
        self._graph = LinkGraph(GraphView.of(node), self._rmw)
        self._running: dict[str, tuple[TopicMeter, RawReader]] = {}
        self._traffic: dict[str, TopicTraffic] = {}  # of topics of which enough is known
        self._reasons: dict[str, str] = {}
        self._thread = ReadingThread()

    def run(self, seconds: float) -> TopicList:
        """Return all topics of interest with what was measured in this time (s)."""
        try:
            self._discover()
            self._measure(seconds)
        finally:
            for name in tuple(self._running):
                self._end(name)
            self._thread.stop()
        return TopicList(
            topics=tuple(
                replace(topic, traffic=self._traffic.get(topic.name), unmeasured=self._reasons.get(topic.name, ""))
                for topic in self._listed()
            ),
            seconds=seconds,
            domain_id=self._node.context.get_domain_id(),
            cannot_tell_hosts=self._blind,
        )

    def _discover(self) -> None:
        """Read the graph until it has not changed for a while."""
        self._on_progress(0.0, "looking for nodes")
        begun_s = changed_s = time.monotonic()
        while (now_s := time.monotonic()) - begun_s < _LONGEST_DISCOVERY_S:
            if now_s - begun_s >= _DISCOVERY_S and now_s - changed_s >= _QUIET_S + self._graph.view.rest_s:
                break
            if self._graph.look():
                changed_s = time.monotonic()
            time.sleep(_LOOK_S)

    def _measure(self, seconds: float) -> None:
        """Measure also topics that appear meanwhile; without a topic there is nothing to wait for."""
        begun_s = time.monotonic()
        look_s = begun_s + _LOOK_AGAIN_S
        self._begin_all()
        while (self._running or self._traffic) and (elapsed_s := time.monotonic() - begun_s) < seconds:
            self._on_progress(elapsed_s, f"measuring {len(self._running)} topics")
            for name in [name for name, (meter, _reader) in self._running.items() if meter.has_enough]:
                self._end(name)
            if (now_s := time.monotonic()) >= look_s:
                look_s = now_s + _LOOK_AGAIN_S
                if self._graph.look():
                    self._begin_all()
            time.sleep(min(_TURN_S, seconds - elapsed_s))

    def _listed(self) -> list[LinkTopic]:
        return [topic for topic in self._graph.topics(prefix=self._prefix) if self._is_of_interest(topic.name)]

    def _begin_all(self) -> None:
        for topic in self._listed():
            if topic.name not in self._running and topic.name not in self._traffic:
                reason = self._begin(topic.name)
                self._reasons[topic.name] = "its host is unknown" if self._blind and topic.far_writers else reason

    def _begin(self, name: str) -> str:
        """Begin to measure a topic; return why not, or an empty text."""
        if reason := self._graph.obstacle(name):
            return reason
        if not self._rmw.is_fast_dds:
            return f"{self._rmw.name} does not number samples, which measuring needs"
        topic = self._graph[name]
        # A reader gets nothing from a writer that offers less than it asks, and a history only if it is reliable.
        keeps = all(writer.is_latched and writer.is_reliable for writer in topic.writers)
        qos = QoSProfile(depth=_DEPTH, **policies_of(is_reliable=keeps, is_latched=keeps))
        has_history = any(writer.is_latched for writer in topic.writers)
        meter = TopicMeter(rated_from_s=time.monotonic() + _HISTORY_S * has_history)

        def deliver(sample: Sample) -> None:
            meter.add(writer=sample.writer, number=sample.sequence, size_bytes=len(sample.data), at_s=time.monotonic())

        try:
            kind = message_class(topic.types[0])
            reader = RawReader(self._node, kind, name, qos, deliver=deliver, thread=self._thread)
        except (UnknownTypeError, RuntimeError, ValueError) as fault:
            return " ".join(str(fault).split())
        self._running[name] = meter, reader
        return ""

    def _end(self, name: str) -> None:
        meter, reader = self._running.pop(name)
        reader.destroy()
        self._traffic[name] = meter.traffic(time.monotonic())
