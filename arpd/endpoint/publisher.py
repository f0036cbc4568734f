"""AdaptivePublisher: an rclpy publisher whose rate, depth and deadline can be changed while it publishes."""

from __future__ import annotations

import math
import threading
import time
from contextlib import suppress
from copy import copy
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from rclpy.duration import Duration
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSLivelinessPolicy, QoSProfile

from arpd.endpoint.flow import Flow
from arpd.endpoint.node_publishers import NodePublishers
from arpd.endpoint.writer import RosWriter, overridden, qos_of, serialized, swap_failure, with_qos, without_ours
from arpd.model.endpoints import (
    NO_REFUSAL,
    Direction,
    Overflow,
    PublisherState,
    Refusal,
    RefusalReason,
    SwapResult,
    SwapTiming,
    WriterQos,
)
from arpd.ros.graph import Requests, period_ns, type_name_of
from arpd.ros.rmw import current_rmw

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rclpy.event_handler import PublisherEventCallbacks
    from rclpy.node import Node
    from rclpy.qos_overriding_options import QoSOverridingOptions

    from arpd.model.plan import TopicPlan
    from arpd.model.price import Price

_FOREVER, _POLL_S = Duration(seconds=-1), 0.005
_OF_LEASE = 0.25  # after which a publisher asserts its liveliness
_LATCHED = "is TRANSIENT_LOCAL: a new writer would lack what late joiners need"


class AdaptivePublisher:
    """A publisher that can be re-tuned live; same methods as `rclpy.publisher.Publisher`.

    Until a daemon plans it, it behaves as a plain publisher: unpaced, with the application's QoS. But in its first
    seconds a large sample waits until the readers have the one before (docs/design.md, The endpoint). It works from any
    thread and under any executor. It uses a monotonic clock, with ``use_sim_time`` too.

    Parameters
    ----------
    node : node it lives in; nothing of arpd's needs its executor
    msg_type, topic, qos_profile, callback_group : as in `Node.create_publisher`, in the same order
    event_callbacks : as in `Node.create_publisher`. They are called for the writer in force only, never for one that a
        swap prepares or retires; the counts in the events start again with every swap
    qos_overriding_options : as in `Node.create_publisher`; depth and deadline need not be named
    overflow : of samples that come faster than the paced rate ``"latest"`` keeps the newest, ``"queue"`` the last
        ``depth`` in their order
    swap_timing : timeouts of a swap; the defaults suit a link that loses one packet in ten

    Attributes
    ----------
    topic_name : fully qualified
    baseline : QoS of the application at creation
    event_handlers : none, for a node that destroys it; its writers have their own

    Notes
    -----
    ``publisher_class`` of `Node.create_publisher` is not supported: a swap would lose the state of such an object, for
    example whether a lifecycle publisher is active. So in a lifecycle node it publishes in every state.

    `retune`, `set_price`, `service`, `state` and `finish` are for arpd's own threads: the next plan undoes what others
    do there.

    Raises
    ------
    ValueError, TypeError
        As of `Node.create_publisher`; if the node already has an AdaptivePublisher on the topic; if ``overflow`` is
        another word, or an override is out of bounds.
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
        qos_overriding_options: QoSOverridingOptions | None = None,
        overflow: Overflow | Literal["latest", "queue"] = Overflow.LATEST,
        swap_timing: SwapTiming | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.msg_type = msg_type
        self.topic = topic
        self.event_handlers: tuple[()] = ()
        # A copy, so that later changes of the application's profile do not reach the next writer.
        own = copy(node._validate_qos_or_depth_parameter(qos_profile))  # noqa: SLF001 - the faults of create_publisher
        try:
            self.topic_name: str = node.resolve_topic_name(topic)
        except RuntimeError:
            node._validate_topic_or_service_name(topic)  # noqa: SLF001 - as above
            raise
        self.qos_profile = overridden(node, self.topic_name, own, qos_overriding_options)
        self._requests = Requests(node, self.topic_name)
        self._clock = clock
        self._node = node
        self._callback_group = callback_group
        self._event_callbacks = event_callbacks
        self._overrides = without_ours(qos_overriding_options)
        self.baseline = qos_of(self.qos_profile)
        self._shared = NodePublishers.of(node)
        self._flow = Flow(
            create=self._create_writer,
            qos=self.baseline,
            overflow=Overflow(overflow),
            clock=clock,
            on_swap=self._on_swap,
            on_held=lambda: self._thread.wake(self),
            timing=swap_timing,
            lock=threading.RLock(),
        )
        self.qos_profile = copy(self._flow.swap.current.publisher.qos_profile)  # with the other overrides
        self._overrides = None
        is_manual = self.qos_profile.liveliness == QoSLivelinessPolicy.MANUAL_BY_TOPIC
        lease_ns = period_ns(self.qos_profile.liveliness_lease_duration)
        self._assert_every_s = lease_ns * _OF_LEASE / 1e9 if is_manual and lease_ns else math.inf
        self._asserted_s = -math.inf
        if lifespan_ns := period_ns(self.qos_profile.lifespan):
            self._flow.lane.lifespan_s = lifespan_ns / 1e9
        self._keeps_all = self.qos_profile.history == QoSHistoryPolicy.KEEP_ALL
        self._flow.start.is_off |= self._keeps_all  # without a daemon every sample leaves, whatever its depth says
        self._lasting_refusal = NO_REFUSAL  # why the writer is never replaced
        if words := current_rmw().refusal:
            self._lasting_refusal = Refusal(RefusalReason.MIDDLEWARE, words)
        elif self.qos_profile.durability != QoSDurabilityPolicy.VOLATILE:  # Fast DDS' default is TRANSIENT_LOCAL
            self._lasting_refusal = Refusal(RefusalReason.TRANSIENT_LOCAL, f"{self.topic_name} {_LATCHED}")
        self._refusal = NO_REFUSAL
        self._refusals = 0  # readers that refused and that a warning named
        self._thread = self._shared.thread
        self._thread.add(self._flow.lane)
        # Its node destroys it as it does any publisher, before the writer in force, so that no swap is under way then.
        node._publishers.insert(0, self)  # noqa: SLF001 - no public list can be added to
        try:
            self._shared.adopt(self)
        except Exception:
            self.destroy()  # a refused publisher must not leave a live writer behind
            raise

    # -- the interface of rclpy.publisher.Publisher

    def __getattr__(self, name: str) -> Any:
        """Return what else a publisher has, of the writer in force; a swap replaces it, so do not store its handle."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._flow.swap.current.publisher, name)

    def publish(self, msg: Any) -> None:
        """Publish a message, now or when pacing allows it.

        The message is serialized at once, so later changes to it have no effect.

        Parameters
        ----------
        msg : message of the publisher's type, or its serialized bytes

        Raises
        ------
        TypeError
            If it is neither.
        """
        self._thread.publish(self._flow.lane, serialized(msg, self.msg_type))
        if self._assert_every_s < math.inf and (now_s := self._clock()) - self._asserted_s >= self._assert_every_s:
            self._asserted_s = now_s  # a sample that waits, or is withheld, asserts nothing
            self.assert_liveliness()

    def pass_on(self, msg: Any, source: Hashable = None) -> None:
        """Publish without waiting for another write: for a caller that serves many topics, such as the relay.

        A writer blocks while the link's queue is full. Samples that come meanwhile are conflated here, before they grow
        old or are lost upstream.

        Parameters
        ----------
        msg : as in `publish`
        source : its writer; a sample is withheld for a newer one of its own writer only
        """
        self._thread.pass_on(self._flow.lane, serialized(msg, self.msg_type), source)

    def wait_for_all_acked(self, timeout: Duration = _FOREVER) -> bool:
        """Wait until all that was published has left and was acknowledged; return whether it was in time.

        Parameters
        ----------
        timeout : longest wait; below 0 = as long as it takes
        """
        until_s = math.inf if timeout.nanoseconds < 0 else time.monotonic() + timeout.nanoseconds / 1e9
        while not (is_done := self._flow.is_acknowledged()) and time.monotonic() < until_s:
            time.sleep(_POLL_S)
        return is_done

    def assert_liveliness(self) -> None:
        """Assert that it is alive, by all its writers: a reader takes one that a swap retires for dead otherwise."""
        with self._flow.swap.lock:
            for writer in self._flow.swap.writers:
                writer.publisher.assert_liveliness()

    def finish(self) -> None:
        """Write what waits, for example a robot's command to stop, and wait shortly until the readers have it."""
        rest, writer = self._thread.rest_of(self._flow.lane), self._flow.swap.current
        try:
            for sample in [*self._flow.rest(), *rest]:
                writer.publish_late(sample)
        finally:
            self._thread.release(self._flow.lane)
        while not writer.is_acknowledged() and time.monotonic() < self._thread.heard_by_s():
            time.sleep(_POLL_S)  # nobody repeats what a writer that is gone has written

    def destroy(self) -> None:
        """Write what waits, and destroy all writers; `Node.destroy_publisher` and `Node.destroy_node` do so, too."""
        with suppress(ValueError):  # its node has done that
            self._node._publishers.remove(self)  # noqa: SLF001 - as above
        self._shared.release(self)
        self._flow.lane.is_closing = True  # a thread that publishes again and again would take it each time before us
        with suppress(RuntimeError):  # RCLError is one: another thread has destroyed the writer
            self.finish()
        self._thread.remove(self._flow.lane)
        self._flow.close()

    # -- re-tuning

    @property
    def plan(self) -> TopicPlan:
        """Settings requested last."""
        return self._flow.lane.plan

    def retune(self, plan: TopicPlan) -> None:
        """Take new settings: pacing changes now, depth and deadline by a swap."""
        if plan == self._flow.lane.plan and not self._refusal.words:
            return  # repeated for another node
        depth = self.baseline.depth if self._keeps_all else plan.depth  # KEEP_ALL ignores it: a swap would be in vain
        qos = WriterQos(depth=depth, deadline_ns=plan.deadline_ns)
        if qos == self._flow.swap.qos:
            self._refusal = NO_REFUSAL
        elif self._lasting_refusal.words:
            self._refusal, qos = self._lasting_refusal, self._flow.swap.qos
        self._flow.swap.request(qos)
        self._thread.retune(self._flow.lane, plan, self._flow.lane.price)
        self._thread.wake(self)

    def set_price(self, price: Price | None) -> None:
        """Take the price of the link, from which the rate follows; None = no daemon is there."""
        if price != self._flow.lane.price:
            self._thread.retune(self._flow.lane, self._flow.lane.plan, price)

    def service(self, now_s: float) -> float:
        """Take a step of the swap, and write what it held; return when to call again (s)."""
        if not self._thread.claim(self._flow.lane, self):
            return math.inf
        try:
            return self._flow.service(now_s)
        finally:
            self._thread.release(self._flow.lane)

    def state(self) -> PublisherState:
        """Return the settings in force for the daemon, about once a second, and warn of readers that refuse them."""
        self._warn_of_refusals()
        return PublisherState(
            node=self._node.get_fully_qualified_name(),
            topic=self.topic_name,
            type_name=type_name_of(self.msg_type),
            direction=Direction.LOCAL,
            baseline_depth=self.baseline.depth,
            baseline_deadline_ns=self.baseline.deadline_ns,
            refusal=self._refusal.words,
            refusal_reason=self._refusal.reason,
            keeps_all=self._keeps_all,
            **self._flow.state().counted(),
        )

    def _warn_of_refusals(self) -> None:
        # As rclpy's default callback does. To read the count would take the event from a callback of the application.
        theirs = self._event_callbacks
        is_silent = theirs is not None and not (theirs.use_default_callbacks and theirs.incompatible_qos is None)
        if not is_silent and (refusals := self._flow.swap.current.refusals()) > self._refusals:
            self._refusals = refusals
            self._node.get_logger().warning(
                f"{self.topic_name}: a subscription requests incompatible QoS and receives nothing; "
                f"last incompatible policy: {self._flow.swap.current.refused_policy}"
            )

    def _create_writer(self, qos: WriterQos) -> RosWriter:
        profile = with_qos(self.qos_profile, qos)
        create = partial(
            self._node.create_publisher,
            self.msg_type,
            self.topic,
            profile,
            callback_group=self._callback_group,
            qos_overriding_options=self._overrides,
        )
        return RosWriter(self._node, create, self._event_callbacks, requests=self._requests, in_force=self._in_force)

    def _in_force(self) -> RosWriter | None:
        return self._flow.swap.current if hasattr(self, "_flow") else None  # None while the first one is made

    def _on_swap(self, result: SwapResult, qos: WriterQos) -> None:
        self._shared.hurry()
        if result in {SwapResult.OK, SwapResult.REORDER_POSSIBLE}:
            self._refusal = NO_REFUSAL
        elif result in {SwapResult.UNMATCHED, SwapResult.INCOMPATIBLE, SwapResult.FAILED}:
            offered_ns = self._flow.swap.qos.deadline_ns
            words = swap_failure(result, qos, requests=self._requests, offered_ns=offered_ns)
            self._refusal = Refusal(RefusalReason(result.value), words)
            self._node.get_logger().warning(words)
