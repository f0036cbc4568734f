"""The topics of this host and beyond, for `arpd topics`: who uses them where, and for some seconds their rate and size.

No message is decoded. It never brings a topic over the link, and costs the robot little: a best-effort reader makes no
writer wait, and a topic of which enough is known is read no more.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rclpy.qos import QoSProfile

from arpd.model.link_topics import LinkTopic, TopicList, TopicTraffic
from arpd.relay.ends.types import UnknownTypeError, message_class
from arpd.ros.graph import ON_EVERY_NODE, GraphView, policies_of
from arpd.ros.names import is_full_name
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample
from arpd.ros.rmw import current_rmw
from arpd.ros.runtime import PROFILE_VARIABLE, UDP_PROFILE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from rclpy.node import Node

    from arpd.ros.graph import Endpoint
    from arpd.ros.rmw import Rmw

_RELAYS = "arpd_relay"  # names of its nodes begin so, unless the user gives another one (--node-name)
_OWN_NODES = frozenset({"/arpd", "/arpd_peer"})  # what the daemon and the peer publish is no traffic of the robot
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


@dataclass(frozen=True, slots=True)
class FoundTopic:
    """One topic with all its endpoints, without those of this process."""

    types: tuple[str, ...]
    writers: tuple[Endpoint, ...]
    readers: tuple[Endpoint, ...]


def is_confined(environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether ROS in this process sees the nodes of this host only."""
    wanted = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    is_profiled = environment.get(PROFILE_VARIABLE) == str(UDP_PROFILE)  # which stands for that range
    return is_profiled or wanted == "LOCALHOST" or environment.get("ROS_LOCALHOST_ONLY") == "1"


def cannot_tell_hosts(rmw: Rmw, environment: Mapping[str, str] = os.environ) -> str:
    """Return why no endpoint shows its host; empty if each does, or if all are on this one."""
    if rmw.tells_hosts or is_confined(environment):
        return ""
    return (
        "the middleware does not show on which host a node is (no Fast DDS, or SROS 2); with "
        "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST `arpd topics` sees and measures the nodes of this host"
    )


class LinkGraph:
    """The topics of a graph, and the sides of their endpoints.

    Where the middleware tells no hosts, no endpoint is on this one, unless this process sees no other.
    """

    def __init__(self, view: GraphView, rmw: Rmw) -> None:
        self.view, self._rmw = view, rmw
        self._is_confined = is_confined()
        self._relays: frozenset[bytes] = frozenset()  # processes on this host; their ghosts stand for nodes beyond
        self._topics: dict[str, FoundTopic] = {}
        self._changes = -1  # of the graph, when it was read last

    def __getitem__(self, name: str) -> FoundTopic:
        return self._topics[name]

    def look(self) -> bool:
        """Read the graph; return whether its topics have changed. A topic that left stays as it was."""
        if self._changes == (changes := self.view.look()):
            return False
        before, self._changes, view = self._topics, changes, self.view
        found = {
            name: FoundTopic(tuple(sorted(types)), self._others(view.writers(name)), self._others(view.readers(name)))
            for name, types in view.types.items()
            if is_full_name(name)
        }
        self._topics = before | {name: topic for name, topic in found.items() if topic.writers or topic.readers}
        relays = (each for each in view.writers(ON_EVERY_NODE) if each.node.rpartition("/")[2].startswith(_RELAYS))
        self._relays = frozenset(each.participant for each in relays if self._is_here(each))
        return self._topics != before

    def topics(self, *, prefix: str) -> list[LinkTopic]:
        """Return every topic, sorted by name, with the sides of its endpoints; the prefix is that of `TopicSurvey`."""
        found = self._topics
        outputs = {name: prefix + name for name in found if prefix and self._is_output(found.get(prefix + name))}
        topics = []
        for name in sorted(found.keys() - set(outputs.values())):
            topic = found[name]
            far_readers = [each for each in topic.readers if not self._is_ours(each)]
            if name in outputs:
                all_readers = (*topic.readers, *found[outputs[name]].readers)
                far_readers = [each for each in all_readers if not self._is_here(each)]
            topics.append(
                LinkTopic(
                    name=name,
                    types=topic.types,
                    writers=_names(filter(self._is_ours, topic.writers)),
                    readers=_names(filter(self._is_ours, topic.readers)),
                    far_writers=_names(each for each in topic.writers if not self._is_ours(each)),
                    far_readers=_names(far_readers),
                    is_latched=any(endpoint.is_latched for endpoint in topic.writers or topic.readers),
                    relayed_as=outputs.get(name, ""),
                )
            )
        return topics

    def obstacle(self, name: str) -> str:
        """Return why a reader of this process would disturb, or would get nothing; empty if it may measure."""
        topic = self._topics[name]
        if not topic.writers:
            return "nobody publishes it now"
        if len(topic.types) > 1:
            return f"it has {len(topic.types)} types: {', '.join(topic.types)}"
        if not all(map(self._is_here, topic.writers)):
            return "it comes from beyond this host, and measuring would bring it over the link once more"
        if not (all(map(self._is_ours, topic.writers)) or any(map(self._is_ours, topic.readers))):
            return "it would cross the link only to be measured: nobody here reads it"
        return ""

    def _others(self, endpoints: Iterable[Endpoint]) -> tuple[Endpoint, ...]:
        own = self.view.own.participant
        return tuple(each for each in endpoints if each.participant != own and each.node not in _OWN_NODES)

    def _is_here(self, endpoint: Endpoint) -> bool:
        return self._is_confined or (self._rmw.tells_hosts and endpoint.host == self.view.own.host)

    def _is_ours(self, endpoint: Endpoint) -> bool:
        """Return whether it belongs to a node of this host; a relay's ghosts do not."""
        return self._is_here(endpoint) and endpoint.participant not in self._relays

    def _is_output(self, topic: FoundTopic | None) -> bool:
        """Return whether a relay on this host alone writes it."""
        writers = topic.writers if topic else ()
        return bool(writers) and all(each.participant in self._relays for each in writers)


def _names(endpoints: Iterable[Endpoint]) -> tuple[str, ...]:
    return tuple(sorted({endpoint.node for endpoint in endpoints}))


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
