"""AdaptivePublisher: an rclpy publisher whose rate, depth and deadline can be changed while it publishes."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from copy import copy
from typing import TYPE_CHECKING, Any

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message

from arpd.model import Direction, PublisherState, TopicPlan
from arpd.pacing import Pacer
from arpd.ros.tuning import NodeTuning
from arpd.settings import Overflow
from arpd.swap import SwapResult, WriterQos, WriterSwap

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

_INFINITE_NS = 2**63 - 1
_POLL_S = 0.005  # how often a swap looks at its writers
_RATE_WINDOW_S = 5.0
_RATE_SETTLE_S = 0.5  # a shorter look at a source tells no rate
_SILENT_PERIODS = 3.0


def offered_deadline_ns(qos: Any) -> int:
    """Deadline of a QoS profile in ns, 0 for infinite (rclpy says 2^63-1 or 0 for it)."""
    nanoseconds = int(qos.deadline.nanoseconds)
    return 0 if nanoseconds >= _INFINITE_NS else nanoseconds


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
        self._clock = clock
        self._callback_group = callback_group
        # Default callbacks would add a waitable to the executor at every swap only to log a warning.
        self._event_callbacks = event_callbacks or PublisherEventCallbacks(use_default_callbacks=False)
        self._lock = threading.RLock()
        self._baseline = WriterQos(depth=self.qos_profile.depth, deadline_ns=offered_deadline_ns(self.qos_profile))
        self._swaps: Counter[str] = Counter()
        self._swap = WriterSwap(create=self._create_writer, on_result=self._on_swap_result, qos=self._baseline)
        self._pacer = Pacer(overflow=overflow, depth=self._baseline.depth, on_withheld=self._on_withheld)
        self._plan = TopicPlan(
            rate_hz=float("inf"),
            min_rate_hz=0.0,
            deadline_ns=self._baseline.deadline_ns,
            depth=self._baseline.depth,
        )
        self._gate = 1.0
        self._offered = self._published = self._withheld = 0
        self._blocked_s = 0.0
        self._payload_bytes = 0.0
        self._offered_at: deque[tuple[float, int]] = deque()  # marks of (time, samples offered by then)
        self._last_offered_s = float("-inf")
        self._refusal = ""
        self._type_name = _type_name(msg_type)
        self._resolved = str(self._writer.publisher.topic_name)
        self._tuning = NodeTuning.of(node)
        self._tuning.adopt(self)

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
        if isinstance(msg, self.msg_type):
            sample = serialize_message(msg)
        elif isinstance(msg, bytes):
            sample = msg
        else:
            raise TypeError(f"Expected {self.msg_type}, got {type(msg)}")
        with self._lock:
            now_s = self._clock()
            self._count_offered(now_s)
            weight = 0.1 if self._payload_bytes else 1.0
            self._payload_bytes += weight * (len(sample) - self._payload_bytes)
            self._pacer.offer(sample)
            self._release(now_s)
            waiting = len(self._pacer) > 0
        if waiting:
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
        with self._lock:
            self._pacer.clear()
            self._swap.close()

    # -- what makes it adaptive

    @property
    def plan(self) -> TopicPlan:
        """Settings last asked for."""
        return self._plan

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
        deadline_ns = plan.deadline_ns
        if requested_ns and (deadline_ns == 0 or deadline_ns > requested_ns):
            deadline_ns = requested_ns
        with self._lock:
            now_s = self._clock()
            self._plan = plan
            self._apply_rate(now_s)
            # Two periods of what flows, so that the acknowledgement a next sample provokes can come back.
            period_s = 1.0 / max(min(plan.rate_hz, self._source_rate_hz(now_s)), 1e-3)
            qos = WriterQos(depth=plan.depth, deadline_ns=deadline_ns)
            if self.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL and qos != self._swap.qos:
                self._refusal = (
                    f"{self._resolved} is TRANSIENT_LOCAL: a new writer would not hold what late joiners need"
                )
            else:
                self._swap.request(qos, hold_s=2.0 * period_s)
        self._tuning.wake()

    def set_gate(self, gate: float) -> None:
        """Scale the paced rate, not below its floor."""
        with self._lock:
            if gate != self._gate:
                self._gate = gate
                self._apply_rate(self._clock())

    def service(self, now_s: float) -> float:
        """Do what is due: a step of the swap, samples whose time has come.

        Returns
        -------
        When to be called again (s).
        """
        if not self._lock.acquire(blocking=False):
            return now_s + 0.001  # the application is inside publish(); never queue the others behind it
        try:
            if self._swap.is_busy:
                self._swap.step(now_s)
            self._release(now_s)
            due_s = self._pacer.due_s(now_s)
            return min(due_s, now_s + _POLL_S) if self._swap.is_busy else due_s
        finally:
            self._lock.release()

    def state(self, *, generation: int) -> PublisherState:
        """Picture of what is in force, for the announcement."""
        with self._lock:
            now_s = self._clock()
            qos = self._swap.qos
            rate_hz = self._source_rate_hz(now_s)
            if self._offered_at and self._offered > self._offered_at[-1][1]:
                self._offered_at.append((self._last_offered_s, self._offered))
            while len(self._offered_at) > 2 and now_s - self._offered_at[1][0] >= _RATE_WINDOW_S:
                self._offered_at.popleft()
            return PublisherState(
                node=self._node.get_fully_qualified_name(),
                topic=self._resolved,
                type_name=self._type_name,
                direction=Direction.LOCAL,
                payload_bytes=self._payload_bytes,
                source_rate_hz=rate_hz,
                offered=self._offered,
                published=self._published,
                withheld=self._withheld,
                queued=len(self._pacer),
                blocked_s=self._blocked_s,
                rate_hz=self._plan.rate_hz,
                depth=qos.depth,
                deadline_ns=qos.deadline_ns,
                baseline_depth=self._baseline.depth,
                baseline_deadline_ns=self._baseline.deadline_ns,
                generation=generation,
                swaps_by_result=dict(self._swaps),
                refusal=self._refusal,
            )

    @property
    def _writer(self) -> _RosWriter:
        writer = self._swap.current
        assert isinstance(writer, _RosWriter)
        return writer

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

    def _release(self, now_s: float) -> None:
        """Write every sample whose time has come, unless a swap holds them."""
        while not self._swap.is_holding and (sample := self._pacer.take(now_s)) is not None:
            before_s = self._clock()
            self._swap.current.publish(sample)
            self._blocked_s += self._clock() - before_s
            self._published += 1

    def _apply_rate(self, now_s: float) -> None:
        rate_hz, source_hz = self._plan.rate_hz, self._source_rate_hz(now_s)
        if self._gate < 1.0:
            # The gate scales what really flows: a rate planned with room to spare would swallow the first part of it.
            flowing_hz = min(rate_hz, source_hz) if source_hz > 0 else rate_hz
            rate_hz = max(flowing_hz * self._gate, min(self._plan.min_rate_hz, rate_hz))
        self._pacer.retune(rate_hz=rate_hz, depth=self._plan.depth, now_s=now_s)

    def _count_offered(self, now_s: float) -> None:
        self._offered += 1
        if now_s - self._last_offered_s > _RATE_WINDOW_S:
            # The silence before a source starts says nothing of its rate: measure from its first sample on.
            self._offered_at = deque([(now_s, self._offered)])
        self._last_offered_s = now_s

    def _source_rate_hz(self, now_s: float) -> float:
        """Rate between the first and the last sample of the window, 0 for a silent source or one not yet known (Hz)."""
        if not self._offered_at or self._offered == self._offered_at[0][1]:
            return 0.0
        since_s, count = self._offered_at[0]
        samples, span_s = self._offered - count, self._last_offered_s - since_s
        if now_s - self._last_offered_s > _SILENT_PERIODS * span_s / samples + _RATE_SETTLE_S:
            return 0.0  # it fell silent
        return samples / span_s if span_s > 0 and now_s - since_s >= _RATE_SETTLE_S else 0.0

    def _tightest_request_ns(self) -> int:
        requests = (
            offered_deadline_ns(reader.qos_profile)
            for reader in self._node.get_subscriptions_info_by_topic(self._resolved)
        )
        return min((request for request in requests if request), default=0)

    def _on_withheld(self, samples: int) -> None:
        self._withheld += samples

    def _on_swap_result(self, result: SwapResult) -> None:
        self._swaps[result.value] += 1
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
