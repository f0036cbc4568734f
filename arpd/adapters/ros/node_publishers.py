"""The shared half of one node's AdaptivePublishers: pacing thread, parameters, gate and announcement."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64

from arpd.adapters.ros.announcement import to_status
from arpd.adapters.ros.bounds import MOST_DEPTH, checked_deadline_ns, checked_depth, checked_floor_hz, checked_rate_hz
from arpd.adapters.ros.events import no_publisher_events, no_subscription_events
from arpd.adapters.ros.grant import Grant
from arpd.adapters.ros.names import (
    DEADLINE,
    DEPTH,
    GATE_TOPIC,
    GENERATION_PARAMETER,
    LEASE_PARAMETER,
    MIN_RATE,
    PUBLISHERS_TOPIC,
    RATE,
    parameter_name,
)
from arpd.model.plan import TopicPlan

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.node import Node

    from arpd.model.endpoints import PublisherState, WriterQos

InvalidHandle = rclpy_implementation.InvalidHandle  # raised by a destroyed node or writer
_ATTRIBUTE = "_arpd_publishers"
_ANNOUNCE_S = 1.0
_GATE_LEASE_S = 5.0  # a gate that is not repeated for this long opens: its daemon is gone
_RETRY_S = 0.1
QUICK_S = 0.005  # longest write that nothing blocks; 20 MB took 5 to 9 ms on loopback
_BLOCKED_S = 0.05  # a scheduler takes less; the history of a reader at 200 Hz does not bridge two such waits
_SHUN = 20.0  # times the duration of the write, so that writes block a caller for a twentieth of its time at most
_WARN_EVERY_S = 5.0
_SETTINGS = {
    DEPTH: ("depth", "KEEP_LAST depth, 1..5000 samples"),
    DEADLINE: ("deadline_ns", "offered deadline period in ns, 0 = infinite"),
    RATE: ("rate_hz", "paced publish rate in Hz, .inf = unpaced, 0 = paused"),
    MIN_RATE: ("min_rate_hz", "floor in Hz; the gate does not lower the rate below it"),
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

    def retune(self, plan: TopicPlan) -> None:
        """Take new settings."""

    def service(self, now_s: float) -> float:
        """Write the samples that are due; return when to call again (s)."""

    def set_gate(self, gate: float | None) -> None:
        """Scale the paced rate; None = no daemon sends a gate."""

    def state(self, *, generation: int, lease_s: float) -> PublisherState:
        """Return the state to announce."""


class NodePublishers:
    """Paces, tunes and announces all AdaptivePublishers of one node; the first of them makes it.

    One thread paces and drives swaps, so that neither depends on the node's executor nor blocks it. Parameters and the
    gate arrive through the executor. The lease ends there too, so no parameter call can interfere.
    """

    def __init__(self, node: Node, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._clock = clock
        self._publishers: dict[str, Paced] = {}
        self._parameters: dict[str, tuple[str, str]] = {}  # parameter name → (topic, field of TopicPlan)
        self._wakeups: Wakeups[Paced] = Wakeups()
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
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._apply)
        newest = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(Float64, GATE_TOPIC, self._on_gate, newest, event_callbacks=no_subscription_events())
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
        shared = getattr(node, _ATTRIBUTE, None)
        if not isinstance(shared, NodePublishers):
            shared = cls(node)
            setattr(node, _ATTRIBUTE, shared)
        return shared

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
            value = getattr(publisher.plan, field)
            self._node.declare_parameter(name, value, ParameterDescriptor(description=description))
        self._publishers = {**self._publishers, topic: publisher}
        # Overrides given at the start (--ros-args -p qos_overrides…) are in force from the beginning.
        plan = self._plans([self._node.get_parameter(parameter_name(topic, name)) for name in _SETTINGS])[topic]
        if plan != publisher.plan:
            publisher.retune(plan)
        self.wake(publisher)

    def release(self, publisher: Paced) -> None:
        """Forget a publisher and its parameters."""
        topic = publisher.topic_name
        self._publishers = {name: kept for name, kept in self._publishers.items() if name != topic}
        for setting in _SETTINGS:
            name = parameter_name(topic, setting)
            if self._parameters.pop(name, None) and self._node.context.ok():
                self._node.undeclare_parameter(name)

    def wake(self, publisher: Paced) -> None:
        """Let the pacing thread serve a publisher at once."""
        self._wakeups.wake(publisher)

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
        announce_s = self._clock()
        while not self._stopping and self._node.context.ok():
            try:
                self._service(self._clock())
                now_s = self.finished_s = self._clock()
                if now_s >= announce_s:
                    announce_s = now_s + _ANNOUNCE_S
                    self._expire_gate(now_s)
                    self._announce()
            except InvalidHandle:
                return  # the application destroyed the node
            self._wakeups.wait(min(announce_s, self._wakeups.next_s()) - self._clock())

    def _service(self, now_s: float) -> None:
        """Serve every publisher that is due; one that raises does not stop the others."""
        for publisher in self._wakeups.take_due(now_s):
            if self._publishers.get(publisher.topic_name) is not publisher:
                continue  # destroyed meanwhile
            try:
                due_s = publisher.service(now_s)
            except InvalidHandle:
                raise
            except Exception as error:  # noqa: BLE001 - one topic's failure must not stop the others' pacing
                self._node.get_logger().error(
                    f"{publisher.topic_name}: pacing or a swap failed: {error}; arpd tries again",
                    throttle_duration_sec=_WARN_EVERY_S,
                    skip_first=False,
                )
                due_s = now_s + _RETRY_S
            self._wakeups.set(publisher, due_s)

    def _announce(self) -> None:
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        generation, lease_s = self._grant.generation, self._grant.lease.granted_s
        publishers = self._publishers.values()
        message.status = [to_status(one.state(generation=generation, lease_s=lease_s)) for one in publishers]
        self._announcer.publish(message)

    def _on_gate(self, message: Any) -> None:
        if 0.0 < message.data <= 1.0:
            self._grant.lease.renew(self._clock())
            for publisher in self._publishers.values():
                publisher.set_gate(message.data)

    def _expire_gate(self, now_s: float) -> None:
        if self._grant.lease.is_silent(now_s, for_s=_GATE_LEASE_S):
            for publisher in self._publishers.values():
                publisher.set_gate(None)

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


def _checked(parameter: Any, field: str, *, most_depth: int, own_deadline_ns: int = 0) -> int | float:
    """Return a valid setting; rclpy has already refused values of another type."""
    if field == "depth":
        return checked_depth(parameter, most_depth)
    if field == "deadline_ns":
        return checked_deadline_ns(parameter, own_ns=own_deadline_ns)
    return checked_rate_hz(parameter) if field == "rate_hz" else checked_floor_hz(parameter)


T = TypeVar("T")


class Wakeups(Generic[T]):
    """Due times of the publishers, and a queue of those that are due at once.

    Only `wake` and `end` may be called from other threads. A publisher that is woken is due until it is taken; one that
    is woken while it is served is due again.
    """

    def __init__(self) -> None:
        self._due_s: dict[T, float] = {}
        self._woken: SimpleQueue[T | None] = SimpleQueue()

    def wake(self, one: T) -> None:
        """Make one due at once."""
        self._woken.put(one)

    def end(self) -> None:
        """Let `wait` return without waking any."""
        self._woken.put(None)

    def wait(self, for_s: float) -> None:
        """Wait until one is woken, or the time is over."""
        try:
            woken = self._woken.get(timeout=max(0.0, for_s))
            while True:
                if woken is not None:
                    self._due_s[woken] = -math.inf
                woken = self._woken.get_nowait()
        except Empty:
            return

    def take_due(self, now_s: float) -> list[T]:
        """Return those that are due, and forget them until they are woken or given a time again."""
        due = [one for one, due_s in self._due_s.items() if due_s <= now_s]
        for one in due:
            del self._due_s[one]
        return due

    def set(self, one: T, due_s: float) -> None:
        """Set when one that was just taken is due again, ``inf`` = not before it is woken (s)."""
        if due_s < math.inf:
            self._due_s[one] = due_s

    def next_s(self) -> float:
        """Return when the next one is due, ``inf`` = none is (s)."""
        return min(self._due_s.values(), default=math.inf)
