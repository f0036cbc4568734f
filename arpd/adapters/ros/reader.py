"""One rclpy subscription as a handover sees it, and what a handover may change of it."""

from __future__ import annotations

import inspect
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rclpy.event_handler import QoSSubscriptionEventType

from arpd.adapters.ros.events import MissedDeadlines

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.event_handler import SubscriptionEventCallbacks
    from rclpy.node import Node

    from arpd.apply.endpoint.reader_swap import Key
    from arpd.model.endpoints import RefusalReason

Sample = tuple[Any, Any]  # message and MessageInfo


@dataclass(frozen=True, kw_only=True, slots=True)
class ReaderQos:
    """What a handover may change: depth (samples), requested deadline (ns, 0 = infinite), and the kind of reader."""

    depth: int
    deadline_ns: int
    reliability: Any
    durability: Any


@dataclass(frozen=True, kw_only=True, slots=True)
class SubscriptionState:
    """What is in force.

    Parameters
    ----------
    depth, deadline_ns : of the reader in force; ``deadline_ns`` 0 = infinite
    swaps_by_result : handovers so far
    deadlines_missed : requested deadlines the middleware counted as missed, over all readers so far
    refusal, refusal_reason : why the last one was refused, or any would be; empty and ``none`` if it was not
    """

    depth: int
    deadline_ns: int
    swaps_by_result: Mapping[str, int]
    deadlines_missed: int
    refusal: str
    refusal_reason: RefusalReason


class RosReader:
    """One rclpy subscription behind the `arpd.apply.endpoint.reader_swap.Reader` protocol.

    Attributes
    ----------
    subscription : given by whoever made the reader, because its callback has to know the reader
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._deadlines = MissedDeadlines(QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED)
        self.subscription: Any = None

    def listening_to(self, callbacks: SubscriptionEventCallbacks) -> SubscriptionEventCallbacks:
        """Return the application's callbacks for this reader, which counts what it tells them."""
        if callbacks.deadline is None:
            return callbacks
        counting = copy(callbacks)
        counting.deadline = self._deadlines.told_by(callbacks.deadline, if_=lambda _event: True)
        return counting

    def matched(self) -> int:
        """Count the matched writers."""
        return int(self.subscription.get_publisher_count())

    def take(self) -> tuple[Key, Sample] | None:
        """Return the next sample that arrived and that nobody took; never blocks."""
        with self.subscription.handle:
            taken = self.subscription.handle.take_message(self.subscription.msg_type, self.subscription.raw)
        return None if taken is None else (key_of(taken), taken)

    def deadlines_missed(self) -> int:
        """Count the requested deadlines missed since it was made; by a destroyed one, as far as known."""
        return self._deadlines.count(self.subscription)

    def destroy(self) -> None:
        """Destroy the subscription."""
        self.deadlines_missed()  # a last look
        self._node.destroy_subscription(self.subscription)


def key_of(sample: Sample) -> Key:
    """Return what tells a sample from all others."""
    info = sample[1]
    return info["source_timestamp"], info["publication_sequence_number"]


def arguments_of(callback: Callable[..., Any]) -> int:
    """Count the arguments a subscription's callback takes, by rclpy's own rule: one is tried before two."""
    signature = inspect.signature(callback)
    for count in (1, 2):
        try:
            signature.bind(*(object(),) * count)
        except TypeError:
            continue
        return count
    raise RuntimeError("a subscription's callback takes the message, or the message and its MessageInfo")
