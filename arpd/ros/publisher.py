"""AdaptivePublisher: an rclpy publisher whose rate, depth and deadline can be changed while it publishes."""

from __future__ import annotations

import threading
import time
from copy import copy
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message

from arpd.flow import Flow
from arpd.model import Direction, PublisherState
from arpd.planner import keeps_its_readers
from arpd.ros.graph import deadline_ns_of
from arpd.ros.tuning import NodeTuning
from arpd.settings import Overflow
from arpd.swap import SwapResult, WriterQos

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from arpd.model import TopicPlan


class _RosWriter:
    """One rclpy publisher behind the swap's `arpd.swap.Writer` protocol."""

    def __init__(self, node: Node, publisher: Any) -> None:
        self._node = node
        self.publisher = publisher

    def publish(self, sample: bytes) -> None:
        self.publisher.publish(sample)

    def matched(self) -> int:
        return int(self.publisher.get_subscription_count())

    def is_acknowledged(self) -> bool:
        # A zero timeout only looks; anything longer would block the pacing thread (shared/SWAP.md).
        return bool(self.publisher.wait_for_all_acked(Duration(seconds=0)))

    def destroy(self) -> None:
        self._node.destroy_publisher(self.publisher)


class AdaptivePublisher:
    """A publisher that can be re-tuned live; same methods as `rclpy.publisher.Publisher`.

    Until somebody sets its parameters it behaves as the plain publisher would: unpaced, with the QoS asked for.

    Parameters
    ----------
    node : node it lives in; its executor must spin for parameters and the gate to work
    msg_type, topic, qos_profile, callback_group, event_callbacks : as in `Node.create_publisher`
    overflow : what gives way when samples come faster than the paced rate

    Raises
    ------
    ValueError
        If the node already has an AdaptivePublisher on the topic: their parameters would share one name.
    """

    def __init__(
        self,
        node: Node,
        msg_type: Any,
        topic: str,
        qos_profile: QoSProfile | int,
        *,
        callback_group: Any = None,
        event_callbacks: PublisherEventCallbacks | None = None,
        overflow: Overflow = Overflow.LATEST,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.msg_type = msg_type
        self.topic = topic
        self.qos_profile = QoSProfile(depth=qos_profile) if isinstance(qos_profile, int) else qos_profile
        self._node = node
        self._callback_group = callback_group
        # Default callbacks would add a waitable to the executor at every swap only to log a warning.
        self._event_callbacks = event_callbacks or PublisherEventCallbacks(use_default_callbacks=False)
        # The lock guards the flow's state for moments only; who writes, or swaps writers, holds ``_writing`` around it.
        self._lock = threading.RLock()
        self._writing = threading.RLock()
        self._baseline = WriterQos(depth=max(1, self.qos_profile.depth), deadline_ns=deadline_ns_of(self.qos_profile))
        self._flow = Flow(
            create=self._create_writer, qos=self._baseline, overflow=overflow, clock=clock, on_swap=self._on_swap
        )
        self._refusal = ""
        self._clamp = ""
        self._type_name = _type_name(msg_type)
        self._resolved = str(self._writer.publisher.topic_name)
        self._tuning = NodeTuning.of(node)
        try:
            self._tuning.adopt(self)
        except Exception:
            self._flow.close()  # a refused publisher must not leave a live writer behind
            raise

    # -- what rclpy.publisher.Publisher offers

    @property
    def topic_name(self) -> str:
        """Fully qualified topic name."""
        return self._resolved

    @property
    def handle(self) -> Any:
        """Handle of the writer in force; a swap replaces it, so do not keep it."""
        return self._writer.publisher.handle

    @property
    def event_handlers(self) -> Any:
        """Event handlers of the writer in force."""
        return self._writer.publisher.event_handlers

    @property
    def logger_name(self) -> str:
        """Name of the logger of the publisher's node."""
        return str(self._writer.publisher.logger_name)

    def publish(self, msg: Any) -> None:
        """Publish a message, now or when pacing lets it.

        The message is serialized at once: changing it afterwards changes nothing that was published.

        Parameters
        ----------
        msg : message of the publisher's type, or its serialized bytes

        Raises
        ------
        TypeError
            If it is neither.
        """
        sample = self._serialized(msg)
        with self._lock:
            self._flow.offer(sample)
        with self._writing:
            self._drain()
        with self._lock:
            is_waiting = self._flow.is_waiting
        if is_waiting:
            self._tuning.wake()

    def offer(self, msg: Any) -> None:
        """Publish without ever blocking: the pacing thread writes.

        For a caller that serves many topics, as the relay does: while the link's queue is full, a writer blocks, and
        what comes meanwhile is conflated here instead of growing old, or getting lost, further up.

        Parameters
        ----------
        msg : as in `publish`
        """
        sample = self._serialized(msg)
        with self._lock:
            self._flow.offer(sample)
        self._tuning.wake()

    def get_subscription_count(self) -> int:
        """Count the matched readers."""
        with self._lock:
            return self._writer.matched()

    def assert_liveliness(self) -> None:
        """Assert that this publisher is alive (MANUAL_BY_TOPIC)."""
        with self._lock:
            self._writer.publisher.assert_liveliness()

    def wait_for_all_acked(self, timeout: Any = None) -> bool:
        """Wait until the writer in force is fully acknowledged, as rclpy does; paced samples are not yet written."""
        publisher = self._writer.publisher
        return bool(publisher.wait_for_all_acked(timeout) if timeout is not None else publisher.wait_for_all_acked())

    def destroy(self) -> None:
        """Destroy the publisher and everything a swap may have in flight."""
        self._tuning.release(self)
        with self._writing, self._lock:
            self._flow.close()

    # -- what makes it adaptive

    @property
    def plan(self) -> TopicPlan:
        """Settings last asked for."""
        return self._flow.plan

    @property
    def baseline(self) -> WriterQos:
        """QoS the application asked for at creation."""
        return self._baseline

    def retune(self, plan: TopicPlan) -> None:
        """Take new settings: pacing changes now, depth and deadline by a swap behind the scenes.

        Parameters
        ----------
        plan : settings to run with; an offered deadline longer than a reader requests is clamped to that request,
            because the reader would silently disconnect (DESIGN §2)
        """
        requested_ns = self._tightest_request_ns()
        is_clamped = not keeps_its_readers(plan, requested_ns)
        qos = WriterQos(depth=plan.depth, deadline_ns=requested_ns if is_clamped else plan.deadline_ns)
        with self._lock:
            self._clamp = f"deadline clamped to the {requested_ns} ns a reader requests" if is_clamped else ""
            if self.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL and qos != self._flow.qos:
                self._refusal = (
                    f"{self._resolved} is TRANSIENT_LOCAL: a new writer would not hold what late joiners need"
                )
                qos = self._flow.qos
            self._flow.retune(plan, qos=qos)
        self._tuning.wake()

    def set_gate(self, gate: float) -> None:
        """Scale the paced rate, not below its floor."""
        with self._lock:
            self._flow.set_gate(gate)

    def service(self, now_s: float) -> float:
        """Do what is due: a step of the swap, samples whose time has come.

        Returns
        -------
        When to be called again (s).
        """
        if not self._writing.acquire(blocking=False):
            return now_s + 0.001  # the application is inside publish(); never queue the others behind it
        try:
            with self._lock:
                self._flow.step(now_s)
            self._drain()
            with self._lock:
                return self._flow.due_s(now_s)
        finally:
            self._writing.release()

    def state(self, *, generation: int) -> PublisherState:
        """Picture of what is in force, for the announcement."""
        with self._lock:
            flow, refusal = self._flow.state(), self._refusal or self._clamp
        return PublisherState(
            node=self._node.get_fully_qualified_name(),
            topic=self._resolved,
            type_name=self._type_name,
            direction=Direction.LOCAL,
            baseline_depth=self._baseline.depth,
            baseline_deadline_ns=self._baseline.deadline_ns,
            generation=generation,
            refusal=refusal,
            **{field.name: getattr(flow, field.name) for field in fields(flow)},
        )

    def _serialized(self, msg: Any) -> bytes:
        if isinstance(msg, self.msg_type):
            return bytes(serialize_message(msg))
        if isinstance(msg, bytes):
            return msg
        raise TypeError(f"Expected {self.msg_type}, got {type(msg)}")

    def _drain(self) -> None:
        """Write all that may leave; the caller holds ``_writing``, so that samples keep their order."""
        while True:
            with self._lock:
                sample = self._flow.take()
            if sample is None:
                return
            self._flow.write(sample)

    @property
    def _writer(self) -> _RosWriter:
        return self._flow.writer

    def _create_writer(self, qos: WriterQos) -> _RosWriter:
        profile = copy(self.qos_profile)
        profile.depth = qos.depth
        profile.deadline = Duration(nanoseconds=qos.deadline_ns)
        publisher = self._node.create_publisher(
            self.msg_type,
            self.topic,
            profile,
            callback_group=self._callback_group,
            event_callbacks=self._event_callbacks,
        )
        return _RosWriter(self._node, publisher)

    def _tightest_request_ns(self) -> int:
        requests = (
            deadline_ns_of(reader.qos_profile) for reader in self._node.get_subscriptions_info_by_topic(self._resolved)
        )
        return min((request for request in requests if request), default=0)

    def _on_swap(self, result: SwapResult) -> None:
        self._refusal = ""
        if result is SwapResult.UNMATCHED:
            readers = sorted(
                f"{reader.node_namespace.rstrip('/')}/{reader.node_name}"
                for reader in self._node.get_subscriptions_info_by_topic(self._resolved)
            )
            self._refusal = f"swap of {self._resolved}: not all readers matched in time ({', '.join(readers)})"
        elif result is SwapResult.FAILED:
            self._refusal = f"swap of {self._resolved}: the middleware refused a writer with these settings"
        if self._refusal:
            self._node.get_logger().warning(self._refusal)


def _type_name(msg_type: Any) -> str:
    package = msg_type.__module__.split(".")[0]
    return f"{package}/msg/{msg_type.__name__}"
