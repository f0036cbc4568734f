"""What AdaptiveSubscriptions of one node share: the plan's generation, its lease and the announcement."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Protocol

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64

from arpd.adapters.ros.announcement import reader_to_status
from arpd.adapters.ros.events import no_publisher_events, no_subscription_events
from arpd.adapters.ros.grant import Grant
from arpd.adapters.ros.names import GATE_TOPIC, READERS_GENERATION_PARAMETER, READERS_LEASE_PARAMETER, READERS_TOPIC

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.node import Node

    from arpd.model.endpoints import ReaderState

InvalidHandle = rclpy_implementation.InvalidHandle  # what a destroyed node or writer raises

_ATTRIBUTE = "_arpd_listening"
_ANNOUNCE_S = 1.0
_CALM = 3  # announcements without a change after which one of so many is enough: most readers live across the link
_COMPLAIN_S = 5.0


class Announced(Protocol):
    """A subscription as its node's shared half sees it: an AdaptiveSubscription."""

    @property
    def topic_name(self) -> str:
        """Fully qualified topic name."""

    def announced(self, *, generation: int, lease_s: float) -> ReaderState:
        """Return what to announce."""

    def return_to_baseline(self) -> str | None:
        """Go back to the application's QoS; return why that is refused, None if it is not."""


class NodeSubscriptions:
    """The shared half of all AdaptiveSubscriptions in one node; made by the first of them, and kept on the node.

    It does all its work in the node's executor, which the subscriptions need anyway.
    """

    def __init__(self, node: Node, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._clock = clock
        self._subscriptions: dict[str, Announced] = {}
        self._gate: Any = None
        self._unchanged = 0  # looks since something was new
        self._grant = Grant(
            node,
            generation_name=READERS_GENERATION_PARAMETER,
            lease_name=READERS_LEASE_PARAMETER,
            plan="plan last asked of the readers",
            whose="readers",
            clock=clock,
        )
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._apply)
        self._announcer = node.create_publisher(
            DiagnosticArray, READERS_TOPIC, QoSProfile(depth=5), event_callbacks=no_publisher_events()
        )
        # Groups of its own: what the application's callbacks take is not time the daemon should have to guess.
        self._group = MutuallyExclusiveCallbackGroup()
        node.create_timer(_ANNOUNCE_S, self._serve, self._group, Clock(clock_type=ClockType.STEADY_TIME))

    @classmethod
    def of(cls, node: Node) -> NodeSubscriptions:
        """Return the node's listening, made on first use."""
        listening = getattr(node, _ATTRIBUTE, None)
        if not isinstance(listening, NodeSubscriptions):
            listening = cls(node)
            setattr(node, _ATTRIBUTE, listening)
        return listening

    def adopt(self, subscription: Announced) -> None:
        """Announce a subscription from now on."""
        self._subscriptions = {**self._subscriptions, subscription.topic_name: subscription}
        self.note_news()

    def release(self, subscription: Announced) -> None:
        """Forget a subscription."""
        self._subscriptions = {
            topic: kept for topic, kept in self._subscriptions.items() if topic != subscription.topic_name
        }

    def note_news(self) -> None:
        """Announce at every look for a while: something of a subscription is new."""
        self._unchanged = 0

    def _serve(self) -> None:
        self._expire_plan()
        self._unchanged += 1
        if not self._subscriptions or (self._unchanged > _CALM and self._unchanged % _CALM):
            return
        states = [
            subscription.announced(generation=self._grant.generation, lease_s=self._grant.lease.granted_s)
            for subscription in self._subscriptions.values()
        ]
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [reader_to_status(state) for state in states]
        with suppress(InvalidHandle):  # the application has just destroyed the node
            self._announcer.publish(message)

    def _expire_plan(self) -> None:
        """Return every reader to its application's QoS when the daemon is silent for longer than it granted.

        A reader is refused that for as long as a writer would lose it; each second asks again.
        """
        if not self._grant.lease.is_over(self._clock()):
            return
        if self._grant.generation:
            self._node.get_logger().warning(
                f"nothing heard of arpd for {self._grant.lease.granted_s:g} s: the readers return to their own QoS"
            )
            self._grant.generation = 0  # whoever plans next may start anywhere
            self._node.set_parameters([Parameter(READERS_GENERATION_PARAMETER, value=0)])
        for subscription in self._subscriptions.values():
            if (refusal := subscription.return_to_baseline()) is not None:
                self._node.get_logger().info(
                    f"{subscription.topic_name} keeps its plan: {refusal}", throttle_duration_sec=_COMPLAIN_S
                )

    def _validate(self, parameters: Sequence[Any]) -> Any:
        try:
            self._grant.check(parameters)
        except ValueError as refusal:
            return SetParametersResult(successful=False, reason=str(refusal))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: Sequence[Any]) -> None:
        self.note_news()
        self._grant.take(parameters)
        self._listen_for_the_daemon()

    def _listen_for_the_daemon(self) -> None:
        """Hear the gate while there is a lease; without one it would cross the link for nothing."""
        if self._grant.lease.granted_s > 0 and self._gate is None:
            newest = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
            self._gate = self._node.create_subscription(
                Float64,
                GATE_TOPIC,
                self._on_gate,
                newest,
                callback_group=self._group,
                event_callbacks=no_subscription_events(),
            )
        elif self._grant.lease.granted_s == 0 and self._gate is not None:
            self._node.destroy_subscription(self._gate)
            self._gate = None

    def _on_gate(self, _message: Any) -> None:
        self._grant.lease.renew(self._clock())
