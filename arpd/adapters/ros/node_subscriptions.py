"""The shared half of one node's AdaptiveSubscriptions: the plan's generation, its lease, and the announcement."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Protocol

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64MultiArray

from arpd.adapters.ros.announcement import reader_to_status
from arpd.adapters.ros.attached import attached
from arpd.adapters.ros.events import no_publisher_events, no_subscription_events
from arpd.adapters.ros.grant import Grant
from arpd.adapters.ros.names import PRICE_TOPIC, READERS_GENERATION_PARAMETER, READERS_LEASE_PARAMETER, READERS_TOPIC
from arpd.adapters.ros.own_parameters import OwnParameters
from arpd.adapters.ros.plan_listener import PlanListener
from arpd.adapters.ros.plan_message import Setting

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from rclpy.node import Node

    from arpd.adapters.ros.plan_message import NodePlan
    from arpd.adapters.ros.reader import ReaderQos
    from arpd.model.endpoints import ReaderState

InvalidHandle = rclpy_implementation.InvalidHandle  # raised by a destroyed node or writer

_ANNOUNCE_S = 1.0
_CALM = 3  # without news only every third announcement is sent, because most readers live across the link
_WARN_EVERY_S = 5.0
_RESTS = 2.0  # times the duration of a creation: eleven readers in a row took 70 ms, in which /imu sends 14 samples


class Announced(Protocol):
    """An AdaptiveSubscription as `NodeSubscriptions` sees it."""

    @property
    def topic_name(self) -> str:
        """Fully qualified topic name."""

    @property
    def parameters(self) -> Mapping[str, str]:
        """Field of its QoS by the name of its parameter."""

    @property
    def baseline(self) -> ReaderQos:
        """QoS of the application."""

    def state(self, *, generation: int, lease_s: float) -> ReaderState:
        """Return the state to announce."""

    def check(self, parameters: Sequence[Any]) -> None:
        """Refuse values of its parameters with a ValueError."""

    def follow_parameters(self) -> None:
        """Request the QoS that its parameters have."""


class NodeSubscriptions:
    """Tunes and announces all AdaptiveSubscriptions of one node, in its executor; the first of them makes it."""

    def __init__(self, node: Node, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._clock = clock
        self._own = OwnParameters(node)
        self._subscriptions: dict[str, Announced] = {}
        self._by_parameter: dict[str, Announced] = {}
        self._rows: Mapping[str, Mapping[str, Any]] = {}  # of the plan in force, also of topics that are not there yet
        self._price: Any = None  # subscription
        self._unchanged = 0  # timer calls since the last news
        self.create_from_s = -math.inf  # from then on one of them may make a reader
        self._grant = Grant(
            node,
            generation_name=READERS_GENERATION_PARAMETER,
            lease_name=READERS_LEASE_PARAMETER,
            plan="plan last requested of the readers",
            whose="readers",
            clock=clock,
        )
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._apply)
        self._announcer = node.create_publisher(
            DiagnosticArray, READERS_TOPIC, QoSProfile(depth=5), event_callbacks=no_publisher_events()
        )
        # A group of its own, so that the application's callbacks do not delay it.
        self._group = MutuallyExclusiveCallbackGroup()
        PlanListener.of(node).serve(self)
        node.create_timer(_ANNOUNCE_S, self._serve, self._group, Clock(clock_type=ClockType.STEADY_TIME))

    @classmethod
    def of(cls, node: Node) -> NodeSubscriptions:
        """Return the node's own, made on first use and stored on the node."""
        return attached(node, cls, lambda: cls(node))

    def adopt(self, subscription: Announced) -> None:
        """Announce a subscription from now on."""
        self._subscriptions = {**self._subscriptions, subscription.topic_name: subscription}
        self._by_parameter |= dict.fromkeys(subscription.parameters, subscription)
        if self._grant.generation and (row := self._rows.get(subscription.topic_name)) is not None:
            with suppress(ValueError):  # the row of a predecessor with other QoS
                self._request_checked({subscription: _settings(subscription, row)})
        self.note_news()

    def release(self, subscription: Announced) -> None:
        """Forget a subscription."""
        self._subscriptions = {
            topic: kept for topic, kept in self._subscriptions.items() if topic != subscription.topic_name
        }
        for name in subscription.parameters:
            self._by_parameter.pop(name, None)

    def note_news(self) -> None:
        """Announce every second for a while, because a subscription changed."""
        self._unchanged = 0

    def note_creation(self, began_s: float) -> None:
        """Let the executor serve others before the next reader is made; many at once would overrun histories."""
        now_s = self._clock()
        self.create_from_s = now_s + _RESTS * (now_s - began_s)

    def _serve(self) -> None:
        self._expire_plan()
        self._unchanged += 1
        if not self._subscriptions or (self._unchanged > _CALM and self._unchanged % _CALM):
            return
        states = [
            subscription.state(generation=self._grant.generation, lease_s=self._grant.lease.granted_s)
            for subscription in self._subscriptions.values()
        ]
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        first, *others = states
        message.status = [reader_to_status(first, self._grant.answer), *map(reader_to_status, others)]
        with suppress(InvalidHandle):  # the application has just destroyed the node
            self._announcer.publish(message)

    def _expire_plan(self) -> None:
        """Return every reader to its application's QoS when the lease has run out.

        While a writer would lose the reader that is refused, and requested again every second.
        """
        if not self._grant.lease.is_over(self._clock()):
            return
        if self._grant.generation:
            self._node.get_logger().warning(
                f"no sign of arpd for {self._grant.lease.granted_s:g} s: the readers return to their own QoS"
            )
            self._grant.end()
            self._rows = {}
            self.note_news()
        for subscription in self._subscriptions.values():
            if (refusal := self._return_to_baseline(subscription)) is not None:
                self._node.get_logger().info(
                    f"{subscription.topic_name} keeps its plan for now: {refusal}", throttle_duration_sec=_WARN_EVERY_S
                )

    def _return_to_baseline(self, subscription: Announced) -> str | None:
        """Request the application's QoS; return why that is refused, None if it is not."""
        own = [Setting(name, getattr(subscription.baseline, field)) for name, field in subscription.parameters.items()]
        try:
            if any(self._node.get_parameter(name).value != value for name, value in own):
                self._request_checked({subscription: own})
        except ValueError as refusal:
            return str(refusal)
        except ParameterNotDeclaredException:
            return None  # another thread has just destroyed it
        return None

    def take_plan(self, plan: NodePlan, crc: int) -> None:
        """Take all rows of a plan for this node's readers, or none of them; the next announcement has the answer."""
        if not plan.readers:
            return
        rows = {
            subscription: _settings(subscription, row)
            for topic, subscription in self._subscriptions.items()
            if (row := plan.readers.get(topic)) is not None
        }
        try:
            self._grant.check_plan(plan)
            self._request_checked(rows)
        except ValueError as refusal:
            self.refuse_plan(crc, str(refusal))
            return
        self._grant.take_plan(plan, crc)
        self._rows = plan.readers
        self.note_news()
        self._follow_price()

    def refuse_plan(self, crc: int, words: str) -> None:
        """Answer that a plan is refused, and why."""
        self._grant.refuse_plan(crc, words)
        self.note_news()

    def _request_checked(self, rows: Mapping[Announced, Sequence[Setting]]) -> None:
        """Request QoS of some subscriptions, or of none if one of them refuses with a ValueError."""
        for subscription, settings in rows.items():
            subscription.check(settings)
        for subscription, settings in rows.items():
            self._own.show(dict(settings))
            subscription.follow_parameters()

    def _validate(self, parameters: Sequence[Any]) -> Any:
        try:
            self._grant.check(parameters)
            for subscription in self._subscriptions_of(parameters):
                subscription.check(parameters)
        except ValueError as refusal:
            return SetParametersResult(successful=False, reason=str(refusal))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: Sequence[Any]) -> None:
        self.note_news()
        self._grant.take(parameters)
        for subscription in self._subscriptions_of(parameters):
            subscription.follow_parameters()
        self._follow_price()

    def _subscriptions_of(self, parameters: Sequence[Any]) -> Collection[Announced]:
        """Return the subscriptions that have some of these parameters."""
        found = (self._by_parameter.get(parameter.name) for parameter in parameters)
        return dict.fromkeys(subscription for subscription in found if subscription is not None)

    def _follow_price(self) -> None:
        """Subscribe to the price, as a sign of the daemon, while there is a lease; otherwise spare the link."""
        if self._grant.lease.granted_s > 0 and self._price is None:
            newest = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
            self._price = self._node.create_subscription(
                Float64MultiArray,
                PRICE_TOPIC,
                self._on_price,
                newest,
                callback_group=self._group,
                event_callbacks=no_subscription_events(),
            )
        elif self._grant.lease.granted_s == 0 and self._price is not None:
            self._node.destroy_subscription(self._price)
            self._price = None

    def _on_price(self, _message: Any) -> None:
        self._grant.lease.renew(self._clock())


def _settings(subscription: Announced, row: Mapping[str, Any]) -> list[Setting]:
    return [Setting(name, row[field]) for name, field in subscription.parameters.items()]
