"""Announcements of one node's AdaptivePublishers: statuses when something changes, and numbers once a second."""

from __future__ import annotations

import math
import secrets
from array import array
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, fields
from itertools import count
from operator import attrgetter
from typing import TYPE_CHECKING, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.event_handler import QoSPublisherEventType
from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray

from arpd.adapters.ros.announcement import to_status
from arpd.adapters.ros.counters import NUMBERS, encode_counters, row_of
from arpd.adapters.ros.events import InvalidHandle, no_publisher_events, status_of
from arpd.adapters.ros.names import COUNTERS_TOPIC, PUBLISHERS_TOPIC
from arpd.model.endpoints import PublisherState
from arpd.observe.registry import MOST_OF_NODE, SERIALS, Tag

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from rclpy.node import Node

    from arpd.adapters.ros.plan_message import PlanAnswer

_COUNTERS_S = 1.0
_EARLY_S = 0.2  # least time between two messages: the daemon takes eight a second of each kind
_WARN_EVERY_S = 60.0
_ROLL_S = 15.0  # every publisher's status is sent about so often, for people, and in case one was lost
_MOST_STATUSES = 32  # in a message: 20 to 32 kB
# A new generation, or a lease, is in every message of numbers; a phase that is over shows at the end of the swap.
_QUIET = {*NUMBERS, "generation", "lease_s", "swap_seconds_by_phase"}
_news_of = attrgetter(*(field.name for field in fields(PublisherState) if field.name not in _QUIET))


P = TypeVar("P")


@dataclass(slots=True)
class _Told:
    """The last status of a publisher."""

    number: int
    serial: int
    state: PublisherState
    at_s: float


class Announcer(Generic[P]):
    """Tells what the publishers of a node are and do; one thread calls `turn`.

    A status leaves when more than numbers changed, for all publishers when a listener joins, and for each about every
    15 s. Statuses that are due together leave in messages of at most 32 kB, with a pause between. The numbers of all
    publishers leave once a second in one small message, which is also their sign of life.

    Parameters
    ----------
    node : node of the publishers
    state_of : returns the state of one of them
    """

    def __init__(self, node: Node, state_of: Callable[[P], PublisherState]) -> None:
        self._node = node
        self._name = node.get_fully_qualified_name()
        self._state_of = state_of
        self._incarnation = secrets.randbits(64)
        self._numbers = count(1)
        self._told: dict[P, _Told] = {}
        self._due: dict[P, None] = {}  # their status is due, in this order
        self._hurried: deque[P] = deque()
        self._joined_before = 0
        self._counted_s = self._stated_s = -math.inf  # when numbers, and statuses, left last
        self._is_answer_due = False
        self._statuses = node.create_publisher(
            DiagnosticArray, PUBLISHERS_TOPIC, QoSProfile(depth=10), event_callbacks=no_publisher_events()
        )
        self._counters = node.create_publisher(
            UInt8MultiArray, COUNTERS_TOPIC, QoSProfile(depth=5), event_callbacks=no_publisher_events()
        )

    @property
    def due_s(self) -> float:
        """When `turn` has something to do (s)."""
        return min(self._counters_s, self._stated_s + _EARLY_S if self._due or self._hurried else math.inf)

    @property
    def _counters_s(self) -> float:
        return self._counted_s + (_EARLY_S if self._is_answer_due else _COUNTERS_S)

    def hurry(self, publisher: P) -> None:
        """Let a publisher's status leave soon; for any thread."""
        self._hurried.append(publisher)

    def hurry_answer(self) -> None:
        """Let the numbers leave soon, with the answer to a plan; for any thread."""
        self._is_answer_due = True

    def turn(self, now_s: float, publishers: Collection[P], *, answer: PlanAnswer, lease_s: float) -> None:
        """Send what is due.

        Parameters
        ----------
        publishers : all of the node
        answer, lease_s : answer to the last plan, and lease of the plan in force (s)
        """
        if self._hurried:
            self._put_first([self._hurried.popleft() for _ in range(len(self._hurried))])
        states: dict[P, PublisherState] | None = None
        if now_s >= self._counters_s:
            self._is_answer_due, self._counted_s = False, now_s
            states = self._states(publishers)
            self._find_due(states, now_s)
        if self._due and now_s >= self._stated_s + _EARLY_S:
            self._stated_s = now_s
            self._send_statuses(publishers, now_s)
        if states is not None:
            self._send_counters(states, answer, lease_s)

    def _states(self, publishers: Iterable[P]) -> dict[P, PublisherState]:
        """Return the states of the publishers that no other thread has just destroyed."""
        found: dict[P, PublisherState] = {}
        for publisher in publishers:
            with suppress(InvalidHandle):
                found[publisher] = self._state_of(publisher)
        return found

    def _put_first(self, publishers: Iterable[P]) -> None:
        self._due = {**dict.fromkeys(publishers), **self._due}

    def _find_due(self, states: Mapping[P, PublisherState], now_s: float) -> None:
        """Note whose status is due: of all when somebody joins, of each in turn, and first of those with news."""
        told = self._told = {publisher: last for publisher, last in self._told.items() if publisher in states}
        joined = self._joined()
        if joined > self._joined_before:
            self._due |= dict.fromkeys(states)
        self._joined_before = joined
        turns = math.ceil(len(states) * _COUNTERS_S / _ROLL_S)
        oldest = sorted(told, key=lambda publisher: told[publisher].at_s)[:turns]
        self._due |= dict.fromkeys(each for each in oldest if now_s - told[each].at_s > _ROLL_S / 2)
        self._put_first(
            publisher
            for publisher, state in states.items()
            if publisher not in told or _news_of(told[publisher].state) != _news_of(state)
        )

    def _joined(self) -> int:
        """Count the listeners so far, also those that left; where the middleware does not, those there are."""
        matched = status_of(self._statuses, QoSPublisherEventType.RCL_PUBLISHER_MATCHED)
        return self._statuses.get_subscription_count() if matched is None else int(matched.total_count)

    def _send_statuses(self, publishers: Collection[P], now_s: float) -> None:
        live = set(publishers)
        waiting = [publisher for publisher in self._due if publisher in live]
        chosen, rest = waiting[:_MOST_STATUSES], waiting[_MOST_STATUSES:]
        self._due = dict.fromkeys(rest)
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        told: dict[P, _Told] = {}
        for publisher, state in self._states(chosen).items():
            last = self._told.get(publisher)
            number = next(self._numbers) if last is None else last.number
            serial = 0 if last is None else (last.serial + 1) % SERIALS
            told[publisher] = _Told(number, serial, state, now_s)
            message.status.append(to_status(state, Tag(self._incarnation, number, serial)))
        if told:  # the last one may just be destroyed, and an empty message is none
            self._statuses.publish(message)
            self._told |= told

    def _send_counters(self, states: Mapping[P, PublisherState], answer: PlanAnswer, lease_s: float) -> None:
        if len(states) > MOST_OF_NODE:
            left_out = [state.topic for state in states.values()][MOST_OF_NODE:]
            self._node.get_logger().warning(
                f"{len(states)} publishers in one node: arpd manages {MOST_OF_NODE}, and not {left_out[0]}, for "
                "example; make another node for the rest",
                throttle_duration_sec=_WARN_EVERY_S,
                skip_first=False,
            )
        rows = [
            row_of(last.number, last.serial, told=last.state, now=state)
            for publisher, state in states.items()
            if (last := self._told.get(publisher)) is not None
        ][:MOST_OF_NODE]
        data = encode_counters(self._name, rows, incarnation=self._incarnation, answer=answer, lease_s=lease_s)
        self._counters.publish(UInt8MultiArray(data=array("B", data)))
