"""The shared half of one node's AdaptivePublishers: pacing thread, parameters, price and announcement."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from dataclasses import replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Protocol

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64MultiArray

from arpd.adapters.ros.announcement import to_status
from arpd.adapters.ros.attached import attached
from arpd.adapters.ros.bounds import (
    MOST_DEPTH,
    checked_deadline_ns,
    checked_depth,
    checked_floor_hz,
    checked_packets,
    checked_rate_hz,
    checked_weight,
    checked_wire_bytes,
)
from arpd.adapters.ros.events import no_publisher_events, no_subscription_events
from arpd.adapters.ros.grant import Grant
from arpd.adapters.ros.names import (
    DEADLINE,
    DEPTH,
    GENERATION_PARAMETER,
    LEASE_PARAMETER,
    MIN_RATE,
    PACKETS,
    PRICE_TOPIC,
    PUBLISHERS_TOPIC,
    RATE,
    WEIGHT,
    WIRE_BYTES,
    parameter_name,
)
from arpd.adapters.ros.own_parameters import OwnParameters
from arpd.adapters.ros.price_message import decode_price
from arpd.adapters.ros.profile import missing_here, warn_once
from arpd.adapters.ros.rmw import current_rmw
from arpd.adapters.ros.wakeups import Wakeups
from arpd.apply.endpoint.link_clock import LinkClock
from arpd.model.plan import TopicPlan

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from rclpy.node import Node

    from arpd.model.endpoints import PublisherState, WriterQos
    from arpd.model.price import Price

InvalidHandle = rclpy_implementation.InvalidHandle  # raised by a destroyed node or writer
_ANNOUNCE_S = 1.0
_EARLY_S = 0.4  # least time between two announcements of finished swaps: the daemon takes four a second, of any kind
_SILENT_S = 5.0  # a daemon sends its price every second; one that is silent for so long will plan nothing soon
_RETRY_S = 0.1
QUICK_S = 0.005  # longest write that nothing blocks; 20 MB took 5 to 9 ms on loopback
_LOOK_S = 0.001  # a write that nothing blocks mostly takes less
_BLOCKED_S = 0.05  # a scheduler takes less; the history of a reader at 200 Hz does not bridge two such waits
_SHUN = 20.0  # times the duration of the write, so that writes block a caller for a twentieth of its time at most
_WARN_EVERY_S = 5.0
_SETTINGS = {
    DEPTH: ("depth", "KEEP_LAST depth, 1..5000 samples"),
    DEADLINE: ("deadline_ns", "offered deadline period in ns, 0 = infinite"),
    RATE: ("rate_hz", "ceiling of the publish rate in Hz, .inf = unpaced, 0 = paused"),
    MIN_RATE: ("min_rate_hz", "floor in Hz, which the price keeps while the link carries all floors"),
    WEIGHT: ("weight", "share of link time relative to other topics, 0 = the price does not apply"),
    WIRE_BYTES: ("wire_bytes", "bytes of a sample on the link, over all copies"),
    PACKETS: ("packets", "packets of a sample on the link, over all copies"),
}


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

    def service(self, now_s: float) -> float:
        """Write samples that are due, none after a write that took long; return when to call again (s)."""

    def set_price(self, price: Price | None) -> None:
        """Take the price of the link; None = no daemon is there."""

    def state(self, *, generation: int, lease_s: float, lacks_profile: bool) -> PublisherState:
        """Return the state to announce."""


class NodePublishers:
    """Paces, tunes and announces all AdaptivePublishers of one node; the first of them makes it.

    One thread paces and drives swaps, so that neither depends on the node's executor nor blocks it. Parameters and the
    price arrive through the executor. The lease ends there too, so no parameter call can interfere.
    """

    def __init__(self, node: Node, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._clock = clock
        self.link = attached(node.context, LinkClock, LinkClock)  # all nodes of a process share the link
        self._publishers: dict[str, Paced] = {}
        self._parameters: dict[str, tuple[str, str]] = {}  # parameter name → (topic, field of TopicPlan)
        self._price: Price | None = None  # the last one; it stays when the daemon falls silent, as the plan does
        self._wakeups: Wakeups[Paced] = Wakeups(attrgetter("payload_bytes"))
        self._swapped: deque[Paced] = deque()  # publishers whose end of a swap is not announced yet
        self._suspect_until_s = -math.inf
        self.finished_s = clock()  # when the pacing thread last finished a turn
        self.quick_from_s = -math.inf  # from then on a thread that offers a sample may write it
        self._stopping = False
        self._grant = Grant(
            node,
            generation_name=GENERATION_PARAMETER,
            lease_name=LEASE_PARAMETER,
            plan="plan in force",
            whose="publishers",
            clock=clock,
        )
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
        node.create_timer(_ANNOUNCE_S, self._expire_plan, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._announcer = node.create_publisher(
            DiagnosticArray, PUBLISHERS_TOPIC, QoSProfile(depth=5), event_callbacks=no_publisher_events()
        )
        self._thread = threading.Thread(target=self._run, name="arpd-pacing", daemon=True)
        self._thread.start()
        node.context.on_shutdown(self.stop)

    @classmethod
    def of(cls, node: Node) -> NodePublishers:
        """Return the node's own, made on first use and stored on the node."""
        return attached(node, cls, lambda: cls(node))

    def adopt(self, publisher: Paced) -> None:
        """Declare the publisher's parameters and begin to pace it."""
        topic = publisher.topic_name
        if topic in self._publishers:
            raise ValueError(
                f"{self._node.get_fully_qualified_name()} already has an AdaptivePublisher on {topic}; "
                "their parameters would share one name"
            )
        for setting, (field, description) in _SETTINGS.items():
            name = parameter_name(topic, setting)
            self._parameters[name] = (topic, field)
            OwnParameters.of(self._node).declare(name, getattr(publisher.plan, field), description)
        self._publishers = {**self._publishers, topic: publisher}
        # Overrides given at the start (--ros-args -p qos_overrides…) are in force from the beginning.
        plan = self._plans([self._node.get_parameter(parameter_name(topic, name)) for name in _SETTINGS])[topic]
        if plan != publisher.plan:
            publisher.retune(plan)
        self._show_price(publisher)
        self.wake(publisher)

    def release(self, publisher: Paced) -> None:
        """Forget a publisher and its parameters."""
        topic = publisher.topic_name
        self._publishers = {name: kept for name, kept in self._publishers.items() if name != topic}
        for setting in _SETTINGS:
            name = parameter_name(topic, setting)
            if self._parameters.pop(name, None):
                OwnParameters.of(self._node).undeclare(name)

    def wake(self, publisher: Paced) -> None:
        """Let the pacing thread serve a publisher at once."""
        self._wakeups.wake(publisher)

    def note_swap(self, publisher: Paced) -> None:
        """Announce a publisher soon, because a swap of it has ended; for any thread."""
        self._swapped.append(publisher)
        self._wakeups.end()

    def shun_writing(self, took_s: float) -> None:
        """Leave writes of `offer` to the pacing thread for a while: writes block, and all share the link's queue."""
        now_s = self._clock()
        # One short wait may come from the scheduler; a full link blocks the next write too.
        if took_s > _BLOCKED_S or now_s < self._suspect_until_s:
            self.quick_from_s = max(self.quick_from_s, now_s + _SHUN * took_s)
        self._suspect_until_s = now_s + _SHUN * took_s

    def stop(self) -> None:
        """End the pacing thread; the publishers stay as they are."""
        self._stopping = True
        self._wakeups.end()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout=1.0)

    def _run(self) -> None:
        announce_s = early_s = self._clock()
        while not self._stopping and self._node.context.ok():
            try:
                self._service(self._clock(), until_s=announce_s)
                now_s = self.finished_s = self._clock()
                if now_s >= announce_s:
                    announce_s = now_s + _ANNOUNCE_S
                    self._swapped.clear()
                    self._note_silence(now_s)
                    self._announce(self._publishers.values())
                elif self._swapped and now_s >= early_s:
                    early_s = now_s + _EARLY_S
                    swapped = {self._swapped.popleft() for _ in range(len(self._swapped))}
                    self._announce(one for one in self._publishers.values() if one in swapped)
            except InvalidHandle:
                if not self._has_node:
                    return
                continue  # only a publisher was destroyed, between two looks
            next_s = min(announce_s, self._wakeups.next_s(), early_s if self._swapped else math.inf)
            self._wakeups.wait(next_s - self._clock())

    @property
    def _has_node(self) -> bool:
        """False after the application destroyed the node."""
        try:
            with self._node.handle:
                return True
        except InvalidHandle:
            return False

    def _service(self, now_s: float, *, until_s: float) -> None:
        """Serve the publishers that are due, and those that become due while a write blocks."""
        looked_s = now_s
        self._wakeups.look(now_s)
        while now_s < until_s and (publisher := self._wakeups.take(now_s)) is not None:
            if self._publishers.get(publisher.topic_name) is publisher:  # it may be destroyed by now
                self._wakeups.set(publisher, self._serve(publisher, now_s))
            now_s = self._clock()
            if now_s - looked_s > _LOOK_S:
                looked_s = now_s
                self._wakeups.look(now_s)

    def _serve(self, publisher: Paced, now_s: float) -> float:
        """Serve one publisher and return when to serve it again (s); its faults do not stop the others."""
        try:
            return publisher.service(now_s)
        except InvalidHandle:
            raise
        except Exception as error:  # noqa: BLE001 - one topic's failure must not stop the others' pacing
            self._node.get_logger().error(
                f"{publisher.topic_name}: pacing or a swap failed: {error}; arpd tries again",
                throttle_duration_sec=_WARN_EVERY_S,
                skip_first=False,
            )
            return now_s + _RETRY_S

    def _announce(self, publishers: Iterable[Paced]) -> None:
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        generation, lease_s = self._grant.generation, self._grant.lease.granted_s
        lacks_profile = self._lacks_profile
        message.status = [
            to_status(one.state(generation=generation, lease_s=lease_s, lacks_profile=lacks_profile))
            for one in publishers
        ]
        if message.status:  # the last one may just be destroyed, and an empty message is none
            self._announcer.publish(message)

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
        parameters = [Parameter(GENERATION_PARAMETER, value=0)]
        for topic, publisher in self._publishers.items():
            own = publisher.baseline
            plan = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=own.deadline_ns, depth=own.depth)
            parameters += [
                Parameter(parameter_name(topic, setting), value=getattr(plan, field))
                for setting, (field, _) in _SETTINGS.items()
            ]
        generation, grant.generation = grant.generation, 0  # the next daemon may begin with any generation
        try:
            result = self._node.set_parameters_atomically(parameters)
        except ParameterNotDeclaredException:
            result = SetParametersResult(successful=False, reason="one of them was just destroyed")
        if not result.successful:
            grant.generation = generation  # so that the next call tries again
            self._node.get_logger().error(
                f"the publishers keep their plan for now: {result.reason}", throttle_duration_sec=_WARN_EVERY_S
            )
            return
        self._price = None
        self._show_price(*self._publishers.values())

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
                    changes.setdefault(topic, {})[field] = _checked(
                        parameter,
                        field,
                        most_depth=max(MOST_DEPTH, publisher.baseline.depth),
                        own_deadline_ns=publisher.baseline.deadline_ns,
                    )
        return {topic: replace(self._publishers[topic].plan, **fields) for topic, fields in changes.items()}


_CHECKS: dict[str, Callable[[Any], int | float]] = {
    "rate_hz": checked_rate_hz,
    "min_rate_hz": checked_floor_hz,
    "weight": checked_weight,
    "wire_bytes": checked_wire_bytes,
    "packets": checked_packets,
}


def _checked(parameter: Any, field: str, *, most_depth: int, own_deadline_ns: int = 0) -> int | float:
    """Return a valid setting; rclpy has already refused values of another type."""
    if field == "depth":
        return checked_depth(parameter, most_depth)
    if field == "deadline_ns":
        return checked_deadline_ns(parameter, own_ns=own_deadline_ns)
    return _CHECKS[field](parameter)
