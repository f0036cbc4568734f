"""Measures the topics of this host for some seconds: rate and size, without decoding a message.

It never brings a topic over the link, and costs the robot little: a best-effort reader makes no writer wait, and a
topic of which enough is known is read no more.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile

from arpd.model.link_topics import LinkTopic, TopicList
from arpd.relay.ends.types import UnknownTypeError, message_class
from arpd.ros.graph import policies_of
from arpd.ros.graph_view import GraphView
from arpd.ros.link_topics import (
    FoundTopic,
    cannot_tell_hosts,
    find_sides,
    find_topics,
    obstacle,
    sorted_topics,
)
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample
from arpd.ros.rmw import current_rmw
from arpd.ros.topic_meter import TopicMeter

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

# Processes announce themselves every three seconds; a busy one misses the first announcements of this one.
_DISCOVERY_S, _QUIET_S, _LONGEST_DISCOVERY_S = 3.2, 0.7, 8.0
_LOOK_S, _LOOK_AGAIN_S = 0.1, 1.0  # between looks at the graph, before measuring and while it lasts
_HISTORY_S = 1.0  # in which the history of a latched topic arrives
_DEPTH = 5  # samples that wait for the thread; a lost one counts all the same
_TURN_S = 0.05


@dataclass(slots=True)
class _Measured:
    """A topic that is measured: its reader, None once enough is known, and when that was (s)."""

    meter: TopicMeter
    reader: RawReader | None
    ended_s: float | None = None


class TopicSurvey:
    """Finds the topics of the graph, and measures those of this host.

    Parameters
    ----------
    node : node of this process in the robot's domain; nobody needs to spin it
    prefix : under which a relay with one end republishes topics; empty = there is none
    is_of_interest : returns whether to list a topic, by its name
    on_progress : called with the time of the measurement that has passed (s), and what happens
    clock : monotonic clock (s)
    sleep : waits for the given time (s)
    """

    def __init__(
        self,
        node: Node,
        *,
        prefix: str,
        is_of_interest: Callable[[str], bool],
        on_progress: Callable[[float, str], None] = lambda _elapsed_s, _what: None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._node = node
        self._prefix = prefix
        self._is_of_interest = is_of_interest
        self._on_progress = on_progress
        self._clock = clock
        self._sleep = sleep
        self._view = GraphView.of(node)
        self._changes = -1  # of the graph, when it was read last
        self._rmw = current_rmw()
        self._blind = cannot_tell_hosts(self._rmw)
        self._found: dict[str, FoundTopic] = {}
        self._sides = find_sides(self._view, self._rmw)
        self._measured: dict[str, _Measured] = {}
        self._reasons: dict[str, str] = {}
        self._thread = ReadingThread()

    def run(self, seconds: float) -> TopicList:
        """Return all topics of interest with what was measured in this time (s)."""
        try:
            self._discover()
            self._measure(seconds)
        finally:
            for each in self._measured.values():
                self._end(each)
            self._thread.stop()
        return TopicList(
            topics=tuple(map(self._with_traffic, self._listed())),
            seconds=seconds,
            domain_id=self._node.context.get_domain_id(),
            cannot_tell_hosts=self._blind,
        )

    def _discover(self) -> None:
        """Read the graph until it has not changed for a while."""
        self._on_progress(0.0, "looking for nodes")
        begun_s = changed_s = self._clock()
        while (now_s := self._clock()) - begun_s < _LONGEST_DISCOVERY_S:
            if now_s - begun_s >= _DISCOVERY_S and now_s - changed_s >= _QUIET_S + self._view.rest_s:
                break
            if self._look():
                changed_s = self._clock()
            self._sleep(_LOOK_S)

    def _measure(self, seconds: float) -> None:
        """Measure for a while, also topics that appear meanwhile; without a topic there is nothing to wait for."""
        begun_s = self._clock()
        look_s = begun_s + _LOOK_AGAIN_S
        self._begin_all()
        while self._measured and (elapsed_s := self._clock() - begun_s) < seconds:
            running = [each for each in self._measured.values() if each.reader is not None]
            self._on_progress(elapsed_s, f"measuring {len(running)} topics")
            for each in running:
                if each.meter.has_enough:
                    self._end(each)
            if (now_s := self._clock()) >= look_s:
                look_s = now_s + _LOOK_AGAIN_S
                if self._look():
                    self._begin_all()
            self._sleep(min(_TURN_S, seconds - elapsed_s))

    def _listed(self) -> list[LinkTopic]:
        found = sorted(self._found.values(), key=lambda topic: topic.name)
        listed = sorted_topics(found, self._sides, prefix=self._prefix)
        return [topic for topic in listed if self._is_of_interest(topic.name)]

    def _look(self) -> bool:
        """Read the graph; return whether its topics have changed. A topic that left stays as it was."""
        if self._changes == (changes := self._view.look()):
            return False
        before, self._changes = self._found, changes
        self._found = before | {topic.name: topic for topic in find_topics(self._view)}
        self._sides = find_sides(self._view, self._rmw)
        return self._found != before

    def _begin_all(self) -> None:
        """Begin to measure each topic that may be and is not yet."""
        for topic in self._listed():
            if topic.name in self._measured:
                continue
            reason = self._begin(self._found[topic.name])
            self._reasons[topic.name] = "its host is unknown" if self._blind and topic.far_writers else reason

    def _begin(self, topic: FoundTopic) -> str:
        """Begin to measure a topic; return why not, or an empty text."""
        if reason := obstacle(topic, self._sides):
            return reason
        if not self._rmw.is_fast_dds:
            return f"{self._rmw.name} does not number samples, which measuring needs"
        is_latched = any(writer.is_latched for writer in topic.writers)
        # A reader gets nothing from a writer that offers less than it asks, and a history only if it is reliable.
        keeps = all(writer.is_latched and writer.is_reliable for writer in topic.writers)
        qos = QoSProfile(depth=_DEPTH, **policies_of(is_reliable=keeps, is_latched=keeps))
        now_s = self._clock()
        meter = TopicMeter(rated_from_s=now_s + _HISTORY_S if is_latched else now_s)

        def deliver(sample: Sample) -> None:
            meter.add(writer=sample.writer, number=sample.sequence, size_bytes=len(sample.data), at_s=self._clock())

        try:
            message: Any = message_class(topic.types[0])
            reader = RawReader(self._node, message, topic.name, qos, deliver=deliver, thread=self._thread)
        except (UnknownTypeError, RuntimeError, ValueError) as fault:
            return " ".join(str(fault).split())
        self._measured[topic.name] = _Measured(meter=meter, reader=reader)
        return ""

    def _end(self, each: _Measured) -> None:
        if each.reader is not None:
            each.ended_s = self._clock()
            each.reader.destroy()
            each.reader = None

    def _with_traffic(self, topic: LinkTopic) -> LinkTopic:
        each = self._measured.get(topic.name)
        if each is None or each.ended_s is None:
            return replace(topic, unmeasured=self._reasons.get(topic.name, ""))
        return replace(topic, traffic=each.meter.traffic(each.ended_s))
