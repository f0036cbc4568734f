"""Announcements of publishers, believed as far as the ROS graph confirms them."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import UInt8MultiArray

from arpd.adapters.ros.announcement import from_status, tag_of
from arpd.adapters.ros.counters import MOST_COUNTERS_BYTES, Counters, decode_counters, sender_of
from arpd.adapters.ros.names import COUNTERS_TOPIC, PUBLISHERS_TOPIC, is_full_name
from arpd.adapters.ros.plan_message import PlanAnswer
from arpd.adapters.ros.raw_reader import RawReader
from arpd.adapters.ros.serialized import octets, peek
from arpd.model.observation import MessageKind, MessageRefusal
from arpd.observe.rate_limits import SourceRateLimiter
from arpd.observe.registry import MOST_OF_NODE, Endpoints

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from arpd.adapters.ros.raw_reader import ReadingThread, Sample
    from arpd.adapters.ros.refused_messages import RefusedMessages
    from arpd.model.endpoints import PublisherState

_DEPTH = 1000  # messages that may wait while the thread is busy
_MOST_BYTES = 512 * 1024  # of a message: twice the size of MOST_OF_NODE endpoints
_HZ, _BURST = 8.0, 16.0  # messages of one node and kind; arpd sends five a second at most
_MOST_NODES = 500  # whose answers are kept
_STAMP_END = 12  # of the serialized message: all before it changes with every message
_MOST_STRANGERS = 64  # nodes whose messages wait until the graph shows them
_MOST_STRANGE_BYTES = 4 * 1024 * 1024  # of all of them
_MOST_OF_STRANGER = 256 * 1024  # bytes: MOST_OF_NODE publishers
_STALE_S = 3.5  # three announcements missed: the publisher is gone


class Announcements:
    """The live publishers.

    A node is heard when the graph shows that it may announce, each node at its own limited rate. The graph may show a
    node after its first message arrives; that message waits, undecoded, until the graph is read again.

    Parameters
    ----------
    node : rclpy node
    refused : counts refused messages
    thread : reads them
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        node: Any,
        *,
        refused: RefusedMessages,
        thread: ReadingThread,
        clock: Callable[[], float],
    ) -> None:
        self._refused = refused
        self._clock = clock
        self._lock = threading.Lock()
        self._endpoints = Endpoints(_STALE_S)
        self._limiter = SourceRateLimiter(rate_hz=_HZ, burst=_BURST, strangers_hz=_HZ, strangers_burst=_BURST)
        self._has_unnamed = False
        self._strangers: dict[str, list[bytes]] = {}  # messages by node
        self._strange_bytes = 0
        self._repeated: dict[str, tuple[int, tuple[tuple[str, str], ...]]] = {}  # hash and endpoints of the last one
        self._answers: dict[str, PlanAnswer] = {}
        self._reader = RawReader(
            node,
            DiagnosticArray,
            PUBLISHERS_TOPIC,
            QoSProfile(depth=_DEPTH),
            deliver=self._on_message,
            thread=thread,
            most_bytes=_MOST_BYTES,
            refuse=lambda: self._refuse(MessageRefusal.SIZE, "", "a message is longer than any announcement"),
        )

    @property
    def pending(self) -> int:
        """Number of endpoints and nodes that the graph has not shown yet."""
        with self._lock:
            return self._endpoints.pending + len(self._strangers)

    @property
    def topics(self) -> frozenset[str]:
        """Topics of the endpoints that announced themselves lately."""
        with self._lock:
            return self._endpoints.topics

    def live(
        self, now_s: float, known_of: Callable[[str, str], Mapping[str, Any]] = lambda _node, _topic: {}
    ) -> tuple[PublisherState, ...]:
        """Return the live endpoints, sorted by node and topic: the same tuple until one of them changes.

        Parameters
        ----------
        known_of : returns the fields of a node's endpoint on a topic that the graph shows
        """
        is_flooded = now_s < self._reader.flooded_until_s
        with self._lock:
            return self._endpoints.live(now_s, is_flooded=is_flooded, known_of=known_of)

    def answer_of(self, node: str) -> PlanAnswer:
        """Return a node's last answer to a plan."""
        with self._lock:
            return self._answers.get(node, PlanAnswer())

    def hears(self, node: str) -> bool:
        """Return whether the graph shows that a node may announce endpoints."""
        with self._lock:
            return self._limiter.knows(node) or self._has_unnamed

    def take_numbers(self, counters: Counters, now_s: float) -> None:
        """Take the numbers of a node's endpoints, and its answer to a plan."""
        common = {"generation": counters.answer.generation, "lease_s": counters.lease_s}
        with self._lock:
            self._note_answer(counters.node, counters.answer)
            self._endpoints.note_rows(counters.node, counters.incarnation, counters.rows, common=common, now_s=now_s)

    def _note_answer(self, node: str, answer: PlanAnswer) -> None:
        self._answers.pop(node, None)
        self._answers[node] = answer
        while len(self._answers) > _MOST_NODES:  # names that anybody may invent while the graph has unnamed nodes
            del self._answers[next(iter(self._answers))]

    def see(self, announcers: Collection[str], is_shown: Callable[[str, str], bool]) -> None:
        """Take in what the graph shows now.

        Parameters
        ----------
        announcers : nodes that may announce endpoints; the empty name is a node whose name is unknown
        is_shown : returns whether the graph has an endpoint of a node on a topic
        """
        now_s = self._clock()
        with self._lock:
            self._limiter.know(node for node in announcers if node)
            self._has_unnamed = "" in announcers
            self._endpoints.see(is_shown, now_s)
            strangers, self._strangers, self._strange_bytes = self._strangers, {}, 0
            if not self._has_unnamed:
                self._answers = {node: answer for node, answer in self._answers.items() if node in announcers}
                self._repeated = {node: last for node, last in self._repeated.items() if node in announcers}
        for node, messages in strangers.items():
            for data in messages if node in announcers else ():
                self._take(node, data, now_s)
            if node not in announcers:
                self._refuse(MessageRefusal.SOURCE, node, f"the graph shows no node {node} that announces publishers")

    def _on_message(self, sample: Sample) -> None:
        data = sample.data
        try:
            name, count = peek(data)
        except ValueError as fault:
            self._refuse(MessageRefusal.MALFORMED, "", str(fault))
            return
        node = name.partition(":")[0]
        with self._lock:
            is_heard = self._limiter.knows(node) or self._has_unnamed
            passes = is_heard and self._limiter.lets_pass(node, self._clock())
        if is_heard and not passes:
            self._refuse(MessageRefusal.RATE, node, f"{node} announces publishers more than {_HZ:g} times a second")
        elif not is_full_name(node):
            self._refuse(MessageRefusal.MALFORMED, "", "an announcement names no node")
        elif count > MOST_OF_NODE:
            self._refuse(MessageRefusal.QUOTA, node, f"{node} announces {count} publishers, above {MOST_OF_NODE}")
        elif is_heard:
            self._take(node, data, self._clock())
        else:
            self._keep(node, data)

    def _keep(self, node: str, data: bytes) -> None:
        with self._lock:
            kept: list[bytes] = self._strangers.get(node, [])
            is_kept = (
                (node in self._strangers or len(self._strangers) < _MOST_STRANGERS)
                and sum(map(len, kept)) + len(data) <= _MOST_OF_STRANGER
                and self._strange_bytes + len(data) <= _MOST_STRANGE_BYTES
            )
            if is_kept:
                self._strangers[node] = [*kept, data]
                self._strange_bytes += len(data)
        if not is_kept:
            self._refuse(MessageRefusal.SOURCE, "", "many nodes that the graph does not show announce publishers")

    def _take(self, node: str, data: bytes, now_s: float) -> None:
        content = hash(data[_STAMP_END:])
        with self._lock:
            last, keys = self._repeated.get(node, (None, ()))
            if last == content and self._endpoints.renew(keys, now_s):
                return  # nothing changed, so nothing is decoded
        try:
            statuses = deserialize_message(data, DiagnosticArray).status
        except (RuntimeError, ValueError):  # rclpy documents neither; the second means bytes that are no text
            self._refuse(MessageRefusal.MALFORMED, node, f"{node} announces publishers that cannot be decoded")
            return
        noted = [state for status in statuses if (state := self._note(node, status, now_s)) is not None]
        with self._lock:
            if len(noted) == len(statuses) and len(self._repeated) < _MOST_NODES:
                self._repeated[node] = content, tuple((state.node, state.topic) for state in noted)

    def _note(self, node: str, status: Any, now_s: float) -> PublisherState | None:
        """Note one status, and return its state, None if it is refused."""
        try:
            state, tag = from_status(status), tag_of(status)
        except ValueError as fault:
            self._refuse(MessageRefusal.MALFORMED, node, str(fault))
            return None
        if state.node != node:
            self._refuse(MessageRefusal.MALFORMED, node, f"{node} announces an endpoint of {state.node}")
            return None
        with self._lock:
            has_room = self._endpoints.note(state, now_s, tag)
        if not has_room:
            self._refuse(MessageRefusal.QUOTA, node, f"too many publishers; {state.topic} of {node} is left out")
            return None
        return state

    def _refuse(self, reason: MessageRefusal, source: str, words: str) -> None:
        self._refused.note(MessageKind.PUBLISHERS, reason, words, source=source)


class CounterMessages:
    """Receives the numbers of live publishers between their announcements.

    Parameters
    ----------
    node : rclpy node
    publishers : announcements that the numbers belong to
    refused : counts refused messages
    thread : reads them
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        node: Any,
        publishers: Announcements,
        *,
        refused: RefusedMessages,
        thread: ReadingThread,
        clock: Callable[[], float],
    ) -> None:
        self._publishers = publishers
        self._refused = refused
        self._clock = clock
        self._lock = threading.Lock()
        self._limiter = SourceRateLimiter(rate_hz=_HZ, burst=_BURST, strangers_hz=_HZ, strangers_burst=_BURST)
        self._strangers: set[str] = set()
        self._reader = RawReader(
            node,
            UInt8MultiArray,
            COUNTERS_TOPIC,
            QoSProfile(depth=_DEPTH, reliability=QoSReliabilityPolicy.BEST_EFFORT),
            deliver=self._on_message,
            thread=thread,
            most_bytes=MOST_COUNTERS_BYTES,
            refuse=lambda: self._refuse(MessageRefusal.SIZE, "", "a message is longer than any numbers of a node"),
        )

    def see(self, announcers: Collection[str]) -> None:
        """Take in which nodes the graph shows as announcers of publishers."""
        with self._lock:
            self._limiter.know(node for node in announcers if node)
            strangers, self._strangers = self._strangers, set()
        for node in strangers.difference(announcers):
            self._refuse(MessageRefusal.SOURCE, node, f"the graph shows no node {node} that announces publishers")

    def _on_message(self, sample: Sample) -> None:
        try:
            content = octets(sample.data)
            node = sender_of(content)
        except ValueError as fault:
            self._refuse(MessageRefusal.MALFORMED, "", str(fault))
            return
        if not self._publishers.hears(node):
            self._note_stranger(node)  # the graph may show it soon, and a second later come new numbers
            return
        with self._lock:
            passes = self._limiter.lets_pass(node, self._clock())
        if not passes:
            self._refuse(MessageRefusal.RATE, node, f"{node} tells numbers more than {_HZ:g} times a second")
            return
        try:
            counters = decode_counters(content)
        except ValueError as fault:
            self._refuse(MessageRefusal.MALFORMED, node, str(fault))
            return
        if (rows := len(counters.rows)) > MOST_OF_NODE:
            self._refuse(MessageRefusal.QUOTA, node, f"{node} tells of {rows} publishers, above {MOST_OF_NODE}")
            return
        self._publishers.take_numbers(counters, self._clock())

    def _note_stranger(self, node: str) -> None:
        with self._lock:
            if has_room := len(self._strangers) < _MOST_STRANGERS:
                self._strangers.add(node)
        if not has_room:
            self._refuse(MessageRefusal.SOURCE, "", "many nodes that the graph does not show tell numbers")

    def _refuse(self, reason: MessageRefusal, source: str, words: str) -> None:
        self._refused.note(MessageKind.PUBLISHERS, reason, words, source=source)
