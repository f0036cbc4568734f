"""Announcements of the endpoints of one kind, believed as far as the ROS graph confirms them."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message

from arpd.adapters.ros.names import is_full_name
from arpd.adapters.ros.raw_subscription import Pause, RawSubscription, peek
from arpd.model.endpoints import PublisherState, ReaderState
from arpd.model.observation import MessageRefusal
from arpd.observe.rate_limits import SourceRateLimiter
from arpd.observe.registry import MOST_OF_NODE, Endpoints

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from arpd.adapters.ros.raw_subscription import RefusedMessages
    from arpd.model.observation import MessageKind

_DEPTH = 1000  # messages that may wait while the executor is busy
_MOST_BYTES = 512 * 1024  # of a message: twice the size of MOST_OF_NODE publishers
_HZ, _BURST = 4.0, 8.0  # messages of one node; arpd sends one a second
_MOST_STRANGERS = 64  # nodes whose message waits until the graph shows them
_MOST_STRANGE_BYTES = 32 * 1024

S = TypeVar("S", PublisherState, ReaderState)


class Announcements(Generic[S]):
    """The live endpoints of one kind.

    A node is heard when the graph shows that it may announce, each node at its own limited rate. The graph may show a
    node after its first message arrives; that message waits, undecoded, until the graph is read again.

    Parameters
    ----------
    node : rclpy node; its owner spins it
    topic : topic of the announcements
    kind : kind of the endpoints
    decode : decodes one status
    stale_s : silence after which an endpoint is gone (s)
    refused : counts refused messages
    pause : taken by the executor in a flood
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        node: Any,
        topic: str,
        kind: MessageKind,
        decode: Callable[[Any], S],
        *,
        stale_s: float,
        refused: RefusedMessages,
        pause: Pause,
        clock: Callable[[], float],
    ) -> None:
        self._kind = kind
        self._decode: Callable[[Any], S] = decode
        self._refused = refused
        self._clock = clock
        self._lock = threading.Lock()
        self._endpoints: Endpoints[S] = Endpoints(stale_s)
        self._limiter = SourceRateLimiter(rate_hz=_HZ, burst=_BURST, strangers_hz=_HZ, strangers_burst=_BURST)
        self._has_unnamed = False
        self._strangers: dict[str, bytes] = {}  # last message by node
        self._subscription = RawSubscription(
            node,
            DiagnosticArray,
            topic,
            QoSProfile(depth=_DEPTH, reliability=QoSReliabilityPolicy.BEST_EFFORT),
            most_bytes=_MOST_BYTES,
            take=self._on_message,
            refuse=lambda: self._refuse(MessageRefusal.SIZE, "", "a message is longer than any announcement"),
            pause=pause,
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

    def live(self, now_s: float, known_of: Callable[[S], Mapping[str, Any]] = lambda _state: {}) -> list[S]:
        """Return the live endpoints with the age of their announcement (s), sorted by node and topic.

        Parameters
        ----------
        known_of : returns the fields of a state that the graph shows
        """
        is_flooded = self._subscription.is_flooded
        with self._lock:
            return self._endpoints.live(now_s, is_flooded=is_flooded, known_of=known_of)

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
            strangers, self._strangers = self._strangers, {}
        for node, data in strangers.items():
            if node in announcers:
                self._take(node, data, now_s)
            else:
                self._refuse(MessageRefusal.SOURCE, node, f"the graph shows no node {node} that announces {self._kind}")

    def _on_message(self, data: bytes, _info: Any) -> None:
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
            self._refuse(MessageRefusal.RATE, node, f"{node} announces {self._kind} more than {_HZ:g} times a second")
        elif not is_full_name(node):
            self._refuse(MessageRefusal.MALFORMED, "", "an announcement names no node")
        elif count > MOST_OF_NODE:
            self._refuse(MessageRefusal.QUOTA, node, f"{node} announces {count} {self._kind}, above {MOST_OF_NODE}")
        elif is_heard:
            self._take(node, data, self._clock())
        else:
            self._keep(node, data)

    def _keep(self, node: str, data: bytes) -> None:
        with self._lock:
            has_room = node in self._strangers or len(self._strangers) < _MOST_STRANGERS
            if is_kept := has_room and len(data) <= _MOST_STRANGE_BYTES:
                self._strangers[node] = data
        if not is_kept:
            self._refuse(MessageRefusal.SOURCE, "", f"many nodes that the graph does not show announce {self._kind}")

    def _take(self, node: str, data: bytes, now_s: float) -> None:
        try:
            statuses = deserialize_message(data, DiagnosticArray).status
        except (RuntimeError, ValueError):  # rclpy documents neither; the second means bytes that are no text
            self._refuse(MessageRefusal.MALFORMED, node, f"{node} announces {self._kind} that cannot be decoded")
            return
        for status in statuses:
            try:
                state = self._decode(status)
            except ValueError as fault:
                self._refuse(MessageRefusal.MALFORMED, node, str(fault))
                continue
            if state.node != node:
                self._refuse(MessageRefusal.MALFORMED, node, f"{node} announces an endpoint of {state.node}")
                continue
            with self._lock:
                has_room = self._endpoints.note(state, now_s)
            if not has_room:
                self._refuse(MessageRefusal.QUOTA, node, f"too many {self._kind}; {state.topic} of {node} is left out")

    def _refuse(self, reason: MessageRefusal, source: str, words: str) -> None:
        self._refused.note(self._kind, reason, words, source=source)
