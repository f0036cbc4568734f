"""One rclpy subscription as a reader swap sees it, and the QoS that a swap may change."""

from __future__ import annotations

import inspect
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rclpy.event_handler import QoSSubscriptionEventType

from arpd.adapters.ros.events import MissedDeadlines

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.event_handler import SubscriptionEventCallbacks
    from rclpy.node import Node

    from arpd.apply.endpoint.reader_swap import Key

Sample = tuple[Any, Any]  # message and MessageInfo


@dataclass(frozen=True, kw_only=True, slots=True)
class ReaderQos:
    """QoS that a swap may change: depth (samples), requested deadline (ns, 0 = infinite), and the kind of reader."""

    depth: int
    deadline_ns: int
    reliability: Any
    durability: Any


class RosReader:
    """One rclpy subscription behind the `arpd.apply.endpoint.reader_swap.Reader` protocol.

    Attributes
    ----------
    subscription : set by the maker, because the subscription's callback needs the reader
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._deadlines = MissedDeadlines(QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED)
        self.subscription: Any = None

    def counting(self, callbacks: SubscriptionEventCallbacks) -> SubscriptionEventCallbacks:
        """Return the application's callbacks for this reader, which counts their events."""
        if callbacks.deadline is None:
            return callbacks
        counted = copy(callbacks)
        counted.deadline = self._deadlines.counting(callbacks.deadline, if_=lambda _event: True)
        return counted

    def matched(self) -> int:
        """Count the matched writers."""
        return int(self.subscription.get_publisher_count())

    def take(self) -> tuple[Key, Sample] | None:
        """Take the next sample that arrived; never blocks."""
        with self.subscription.handle:
            taken = self.subscription.handle.take_message(self.subscription.msg_type, self.subscription.raw)
        return None if taken is None else (key_of(taken), taken)

    def deadlines_missed(self) -> int:
        """Count the requested deadlines missed since it was made; a destroyed reader keeps its last known count."""
        return self._deadlines.count(self.subscription)

    def destroy(self) -> None:
        """Destroy the subscription."""
        self.deadlines_missed()  # updates the last known count
        self._node.destroy_subscription(self.subscription)


def key_of(sample: Sample) -> Key:
    """Return the identity of a sample."""
    info = sample[1]
    return info["source_timestamp"], info["publication_sequence_number"]


def arguments_of(callback: Callable[..., Any]) -> int:
    """Count the arguments of a subscription's callback by rclpy's own rule: it tries one before two."""
    signature = inspect.signature(callback)
    for count in (1, 2):
        try:
            signature.bind(*(object(),) * count)
        except TypeError:
            continue
        return count
    raise RuntimeError("a subscription's callback takes the message, or the message and its MessageInfo")
