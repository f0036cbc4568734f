"""The shared half of one node's AdaptivePublishers: parameters, price and announcement."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64MultiArray

from arpd.adapters.ros.announcer import Announcer
from arpd.adapters.ros.attached import attached
from arpd.adapters.ros.events import no_subscription_events
from arpd.adapters.ros.grant import Grant
from arpd.adapters.ros.names import PRICE_TOPIC, parameter_name
from arpd.adapters.ros.own_parameters import OwnParameters
from arpd.adapters.ros.plan_listener import PlanListener
from arpd.adapters.ros.price_message import decode_price
from arpd.adapters.ros.profile import missing_here, warn_once
from arpd.adapters.ros.publisher_settings import SETTINGS, checked, checked_row, parameters_of
from arpd.adapters.ros.rmw import current_rmw
from arpd.adapters.ros.writing_thread import InvalidHandle, WritingThread
from arpd.apply.endpoint.queue import PacedQueue, Whole
from arpd.model.plan import TopicPlan

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rclpy.context import Context
    from rclpy.node import Node

    from arpd.adapters.ros.plan_message import NodePlan
    from arpd.model.endpoints import PublisherState, WriterQos
    from arpd.model.price import Price

_CHECK_S, _RETRY_S = 1.0, 0.1
_SILENT_S = 5.0  # a daemon sends its price every second; one that is silent for so long will plan nothing soon
_WARN_EVERY_S = 5.0
_LARGE_BYTES = 250_000  # at 20 Mbit/s others wait for 0.1 s


class Paced(Protocol):
    """An AdaptivePublisher as `NodePublishers` sees it."""

    @property
    def topic_name(self) -> str:
        """Fully qualified topic name."""

    @property
    def plan(self) -> TopicPlan:
        """Settings requested last."""

    @property
    def baseline(self) -> WriterQos:
        """QoS of the application."""

    @property
    def payload_bytes(self) -> float:
        """Mean size of a sample."""

    def retune(self, plan: TopicPlan) -> None:
        """Take new settings."""

    def set_price(self, price: Price | None) -> None:
        """Take the price of the link; None = no daemon is there."""

    def state(self, *, generation: int, lease_s: float, lacks_profile: bool) -> PublisherState:
        """Return the state to announce."""


class NodePublishers:
    """Tunes and announces all AdaptivePublishers of one node; the first of them makes it.

    The thread of its participant announces, so that this neither depends on the node's executor nor blocks it. Plans,
    parameters and the price arrive through the executor. The lease ends there too, so no plan can interfere.

    Attributes
    ----------
    thread : writes the samples of all nodes of the participant, and serves their publishers
    """

    def __init__(self, node: Node, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._clock = clock
        self.thread = attached(node.context, WritingThread, lambda: _started(node.context, clock))
        self._publishers: dict[str, Paced] = {}
        self._own = OwnParameters(node)
        self._parameters: dict[str, tuple[str, str]] = {}  # parameter name → (topic, field of TopicPlan)
        self._rows: Mapping[str, Mapping[str, Any]] = {}  # of the plan in force, also of topics that are not there yet
        self._price: Price | None = None  # the last one; it stays when the daemon falls silent, as the plan does
        self._check_s = clock()
        self._grant = Grant(node, clock=clock)
        # Only Fast DDS has profiles, and only its writers can be swapped.
        self._lacks_profile = current_rmw().can_swap and bool(missing := missing_here())
        if self._lacks_profile:
            warn_once(node.get_logger(), missing)
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._apply)
        newest = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(
            Float64MultiArray, PRICE_TOPIC, self._on_price, newest, event_callbacks=no_subscription_events()
        )
        node.create_timer(_CHECK_S, self._expire_plan, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._announcer: Announcer[Paced] = Announcer(node, self._state_of)
        PlanListener(node, self)
        self.thread.wake(self)

    @classmethod
    def of(cls, node: Node) -> NodePublishers:
        """Return the node's own, made on first use and stored on the node."""
        return attached(node, cls, lambda: cls(node))

    def adopt(self, publisher: Paced) -> None:
        """Declare the publisher's parameters, and give it its price and its row of the plan."""
        topic = publisher.topic_name
        if topic in self._publishers:
            raise ValueError(
                f"{self._node.get_fully_qualified_name()} already has an AdaptivePublisher on {topic}; "
                "their parameters would share one name"
            )
        for setting, (field, description) in SETTINGS.items():
            name = parameter_name(topic, setting)
            self._parameters[name] = (topic, field)
            self._own.declare(name, getattr(publisher.plan, field), description)
        self._publishers = {**self._publishers, topic: publisher}
        # Overrides given at the start (--ros-args -p qos_overrides…) are in force from the beginning.
        plan = self._plans([self._node.get_parameter(parameter_name(topic, name)) for name in SETTINGS])[topic]
        if plan != publisher.plan:
            publisher.retune(plan)
        self._show_price(publisher)
        self._give_row(publisher)

    def release(self, publisher: Paced) -> None:
        """Forget a publisher and its parameters."""
        topic = publisher.topic_name
        self._publishers = {name: kept for name, kept in self._publishers.items() if name != topic}
        for setting in SETTINGS:
            name = parameter_name(topic, setting)
            if self._parameters.pop(name, None):
                self._own.undeclare(name)

    def note_swap(self, publisher: Paced) -> None:
        """Announce a publisher soon, because a swap of it has ended; for any thread."""
        self._announcer.hurry(publisher)
        self.thread.wake(self)

    def service(self, now_s: float) -> float:
        """Announce what is due; return when to call again (s)."""
        try:
            if now_s >= self._check_s:
                self._check_s = now_s + _CHECK_S
                self._note_silence(now_s)
                self._warn_of_large()
            if now_s >= self._announcer.due_s:
                answer, lease_s = self._grant.answer, self._grant.lease.granted_s
                self._announcer.turn(now_s, self._publishers.values(), answer=answer, lease_s=lease_s)
        except InvalidHandle:
            if not self._has_node:
                raise
            return now_s + _RETRY_S  # only a publisher was destroyed, between two looks
        except Exception as error:  # noqa: BLE001 - a message that cannot be made must not end the announcements
            self._node.get_logger().error(
                f"announcements failed: {error}; arpd tries again", throttle_duration_sec=_WARN_EVERY_S
            )
            return now_s + _RETRY_S
        return min(self._check_s, self._announcer.due_s)

    @property
    def _has_node(self) -> bool:
        """False after the application destroyed the node."""
        try:
            with self._node.handle:
                return True
        except InvalidHandle:
            return False

    def _state_of(self, publisher: Paced) -> PublisherState:
        grant = self._grant
        return publisher.state(
            generation=grant.generation, lease_s=grant.lease.granted_s, lacks_profile=self._lacks_profile
        )

    def _on_price(self, message: Any) -> None:
        try:
            self._price = decode_price(message.data)
        except ValueError as fault:
            self._node.get_logger().warning(f"a price is ignored: {fault}", once=True)
            return
        self._grant.lease.renew(self._clock())
        self._show_price(*self._publishers.values())

    def _note_silence(self, now_s: float) -> None:
        if self._grant.lease.is_silent(now_s, for_s=_SILENT_S):
            self._show_price(*self._publishers.values())

    def _warn_of_large(self) -> None:
        """Say once which topic makes the others of its participant wait."""
        if self.thread.topics < 2:
            return
        for topic, publisher in self._publishers.items():
            if publisher.payload_bytes >= _LARGE_BYTES:
                self._node.get_logger().warning(
                    f"{topic} has samples of {publisher.payload_bytes / 1e6:.1f} MB: while one is written to a slow "
                    "link, the other topics of this process wait inside Fast DDS; publish it from a process of its own",
                    once=True,
                )

    def _show_price(self, *publishers: Paced) -> None:
        """Give publishers the last price.

        To one without a plan a price only says that a daemon is there, which will plan it. Silence ends that.
        """
        price = self._price
        if is_silent := self._grant.lease.is_silent(self._clock(), for_s=_SILENT_S):
            price = None if price is None else replace(price, is_stale=True)
        for publisher in publishers:
            publisher.set_price(None if is_silent and not publisher.plan.weight else price)

    def _expire_plan(self) -> None:
        """Return every publisher to its application's QoS when the lease has run out."""
        grant = self._grant
        if grant.generation == 0 or not grant.lease.is_over(self._clock()):
            return
        self._node.get_logger().warning(
            f"no sign of arpd for {grant.lease.granted_s:g} s: the publishers return to their own QoS",
            throttle_duration_sec=_WARN_EVERY_S,
        )
        grant.end()
        self._rows = {}
        for topic, publisher in self._publishers.items():
            own = publisher.baseline
            plan = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=own.deadline_ns, depth=own.depth)
            self._retune(topic, publisher, plan)
        self._price = None
        self._show_price(*self._publishers.values())

    def take_plan(self, plan: NodePlan, crc: int) -> None:
        """Take all rows of a plan for this node's publishers, or none of them; the next announcement has the answer."""
        if not plan.publishers:
            return
        try:
            self._grant.check_plan(plan)
            rows = {
                topic: (publisher, checked_row(topic, row, publisher.baseline))
                for topic, publisher in self._publishers.items()
                if (row := plan.publishers.get(topic)) is not None
            }
        except ValueError as refusal:
            self.refuse_plan(crc, str(refusal))
            return
        is_repeated = self._grant.take_plan(plan, crc)
        self._rows = plan.publishers
        for topic, (publisher, wanted) in rows.items():
            if is_repeated or wanted != publisher.plan:  # the daemon repeats a plan when a swap failed, for example
                self._retune(topic, publisher, wanted)
        for topic, publisher in self._publishers.items():
            if topic not in rows:  # made meanwhile, by another thread
                self._give_row(publisher)
        self._tell_answer()

    def refuse_plan(self, crc: int, words: str) -> None:
        """Answer that a plan is refused, and why."""
        self._grant.refuse_plan(crc, words)
        self._tell_answer()

    def _tell_answer(self) -> None:
        self._announcer.hurry_answer()
        self.thread.wake(self)

    def _give_row(self, publisher: Paced) -> None:
        """Give a new publisher its row of the plan in force, which its node has answered for it too."""
        topic = publisher.topic_name
        if self._grant.generation and (row := self._rows.get(topic, {})).get("weight"):
            with suppress(ValueError):  # the row of a predecessor with other QoS
                self._retune(topic, publisher, checked_row(topic, row, publisher.baseline))

    def _retune(self, topic: str, publisher: Paced, plan: TopicPlan) -> None:
        publisher.retune(plan)
        self._own.show(parameters_of(topic, plan))
        self._show_price(publisher)

    def _validate(self, parameters: Sequence[Any]) -> Any:
        try:
            self._plans(parameters)
            self._grant.check(parameters)
        except ValueError as refusal:
            return SetParametersResult(successful=False, reason=str(refusal))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: Sequence[Any]) -> None:
        self._grant.take(parameters)
        for topic, plan in self._plans(parameters).items():
            self._publishers[topic].retune(plan)
            self._show_price(self._publishers[topic])

    def _plans(self, parameters: Sequence[Any]) -> dict[str, TopicPlan]:
        """Return the plan of each topic with changed parameters; raise ValueError with a reason for a bad value."""
        changes: dict[str, dict[str, Any]] = {}
        for parameter in parameters:
            if parameter.name in self._parameters:
                topic, field = self._parameters[parameter.name]
                if (publisher := self._publishers.get(topic)) is not None:
                    changes.setdefault(topic, {})[field] = checked(parameter, field, publisher.baseline)
        return {topic: replace(self._publishers[topic].plan, **fields) for topic, fields in changes.items()}


def _started(context: Context, clock: Callable[[], float]) -> WritingThread:
    """Return the thread of a participant, which ends with it."""
    thread = WritingThread(PacedQueue(Whole()), name="arpd-writing", is_alive=context.ok, clock=clock)
    thread.start()
    context.on_shutdown(thread.stop)
    return thread
