"""Plans on their way to nodes: one message per node with all of its rows, repeated until the node answers."""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.exceptions import NameValidationException
from std_msgs.msg import String

from arpd.adapters.ros.daemon_messages import plan_qos
from arpd.adapters.ros.events import no_publisher_events
from arpd.adapters.ros.names import plan_topic
from arpd.adapters.ros.plan_message import crc_of, encode_plan

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from arpd.adapters.ros.plan_message import PlanAnswer
    from arpd.model.plan import TopicPlan, Transition

log = logging.getLogger(__name__)

_TIMEOUT_S = 2.5  # a node answers with its next announcement, a second later at most
_MAX_BACKOFF_S = 12.0
_ACCEPTED_S = 6.0  # an accepted plan leads to a swap of three to four seconds, and then an announcement
_LEAST_S = 0.2  # between two messages to a node
_MOST_NODES = 500  # writers kept; the one used longest ago goes


class _Asked(NamedTuple):
    """All that is now asked of a node."""

    generation: int
    lease_s: float
    publishers: Mapping[str, TopicPlan]


@dataclass(slots=True)
class _Node:
    publisher: Any
    asked: _Asked | None = None
    message: Any = None
    crc: int = 0
    sent_at_s: float = 0.0
    next_at_s: float = 0.0
    backoff_s: float = _TIMEOUT_S
    is_awaited: bool = False  # its answer is missing


class PlanSender:
    """Sends transitions as plan messages, and remembers the answers that it waits for.

    The caller repeats a transition at every whole turn until the node announces its settings; this class decides when
    to send the plan again. New rows are sent at once, and unconfirmed ones after a growing back-off. A node that starts
    later finds its last plan, which the writer keeps for it.

    Parameters
    ----------
    node : rclpy node of the writers
    answer_of : returns a node's last answer
    """

    def __init__(self, node: Any, *, answer_of: Callable[[str], PlanAnswer]) -> None:
        self._ros = node
        self._answer_of = answer_of
        self._nodes: dict[str, _Node] = {}
        self._waiting: set[str] = set()  # nodes that owe an answer
        self._results: Counter[str] = Counter()

    @property
    def results(self) -> Mapping[str, int]:
        """Answers so far, by result: ``ok``, ``refused``, ``timeout``, ``unreachable``, ``failed``."""
        return dict(self._results)

    def apply(self, transitions: Iterable[Transition], *, now_s: float) -> None:
        """Send what is new or due again; returns at once."""
        for name in tuple(self._waiting):
            self._read_answers(name, self._nodes[name], now_s)
        for transition in transitions:
            name = transition.node
            asked = _Asked(transition.generation, float(transition.lease_s), transition.topics)
            try:
                node = self._nodes.pop(name) if name in self._nodes else self._new(name)
                self._nodes[name] = node  # the one used last at the end
                self._send_if_due(name, node, asked, now_s)
            except (RuntimeError, ValueError, NameValidationException) as error:  # rclpy documents none
                self._results["failed"] += 1
                log.warning("%s: its plan cannot be sent: %s", name, error)

    def forget(self) -> None:
        """Take back all plans: their writers go, with what they kept for nodes that start later."""
        for node in self._nodes.values():
            self._ros.destroy_publisher(node.publisher)
        self._nodes.clear()
        self._waiting.clear()

    def _new(self, name: str) -> _Node:
        while len(self._nodes) >= _MOST_NODES:
            oldest = next(iter(self._nodes))
            self._waiting.discard(oldest)
            self._ros.destroy_publisher(self._nodes.pop(oldest).publisher)
        publisher = self._ros.create_publisher(
            String, plan_topic(name), plan_qos(), event_callbacks=no_publisher_events()
        )
        return _Node(publisher)

    def _send_if_due(self, name: str, node: _Node, asked: _Asked, now_s: float) -> None:
        if node.asked is None or (asked != node.asked and now_s >= node.sent_at_s + _LEAST_S):
            text = encode_plan(generation=asked.generation, lease_s=asked.lease_s, publishers=asked.publishers)
            node.asked, node.message, node.crc = asked, String(data=text), crc_of(text)
            node.backoff_s = _TIMEOUT_S
        elif now_s < node.next_at_s:
            return
        node.sent_at_s, node.next_at_s = now_s, now_s + node.backoff_s
        node.backoff_s = min(2 * node.backoff_s, _MAX_BACKOFF_S)
        node.publisher.publish(node.message)
        node.is_awaited = True
        self._waiting.add(name)

    def _read_answers(self, name: str, node: _Node, now_s: float) -> None:
        answer = self._answer_of(name)
        if node.asked is not None and answer.crc == node.crc:
            if answer.refusal:
                self._results["refused"] += 1
                log.warning("%s refused plan %d: %r", name, node.asked.generation, answer.refusal)
                node.is_awaited = False
            elif answer.generation == node.asked.generation:
                self._results["ok"] += 1
                node.next_at_s = max(node.next_at_s, node.sent_at_s + _ACCEPTED_S)
                node.is_awaited = False
        if node.is_awaited and now_s - node.sent_at_s >= _TIMEOUT_S:
            is_there = node.publisher.get_subscription_count() > 0
            self._results["timeout" if is_there else "unreachable"] += 1
            words = "answer" if is_there else "receive"
            log.warning("%s did not %s its plan within %.1f s", name, words, _TIMEOUT_S)
            node.is_awaited = False
        if not node.is_awaited:
            self._waiting.discard(name)
