"""AdaptiveSubscription: an rclpy subscription whose depth and deadline can be changed while it receives."""

from __future__ import annotations

import inspect
import threading
import time
from collections import Counter
from contextlib import suppress
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile

from arpd.adapters.ros.bounds import MOST_DEPTH, checked_deadline_ns, checked_depth
from arpd.adapters.ros.graph import deadline_ns_of, node_name_of
from arpd.adapters.ros.names import reader_parameter_name
from arpd.adapters.ros.node_subscriptions import NodeSubscriptions
from arpd.adapters.ros.own_parameters import OwnParameters
from arpd.adapters.ros.reader import ReaderQos, RosReader, Sample, arguments_of, key_of
from arpd.adapters.ros.rmw import current_rmw, lasting_refusal
from arpd.apply.endpoint.meters import DeadlineCount
from arpd.apply.endpoint.reader_swap import ReaderSwap
from arpd.model.endpoints import NO_REFUSAL, ReaderState, ReaderSwapResult, Refusal, RefusalReason
from arpd.model.plan import is_kept

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.node import Node

    from arpd.adapters.ros.rmw import Rmw

_POLL_S = 0.02  # between two steps of a reader swap
_WITH_INFO = inspect.signature(lambda _message, _info: None)
_SETTINGS = {
    "depth": ("depth", "KEEP_LAST depth, 1..5000 samples"),
    "deadline": ("deadline_ns", "requested deadline period in ns, 0 = infinite"),
}


class AdaptiveSubscription:
    """A subscription that can be re-tuned live; same attributes as `rclpy.subscription.Subscription`.

    Its settings are the writable parameters ``qos_overrides.<topic>.subscription.depth`` and ``….deadline`` (ns). Its
    node announces it on ``/arpd/subscriptions``. Where `arpd run` has a plan for the topic, it sets them: the depth of
    the writer, and, if the application requests a deadline at all, one that the writer keeps.

    Parameters
    ----------
    node : node it lives in; its executor must spin
    msg_type, topic, callback, qos_profile, callback_group, event_callbacks, raw : as in `Node.create_subscription`. A
        callback that takes MessageInfo works on EventsExecutor too, where rclpy 7.1 by itself raises SystemError

    Raises
    ------
    ValueError
        If the node already has an AdaptiveSubscription on the topic, or a parameter override is out of bounds.
    """

    def __init__(
        self,
        node: Node,
        msg_type: Any,
        topic: str,
        callback: Callable[..., Any],
        qos_profile: QoSProfile | int,
        *,
        callback_group: Any = None,
        event_callbacks: SubscriptionEventCallbacks | None = None,
        raw: bool = False,
        clock: Callable[[], float] = time.monotonic,
        rmw: Rmw | None = None,
    ) -> None:
        self.msg_type = msg_type
        self.topic = topic
        self.raw = raw
        self.callback_group = callback_group or node.default_callback_group
        self.qos_profile = QoSProfile(depth=qos_profile) if isinstance(qos_profile, int) else qos_profile
        self._node = node
        self._rmw = rmw or current_rmw()
        # Default callbacks would add a waitable to the executor at every swap, only to log a warning.
        self._event_callbacks = event_callbacks or SubscriptionEventCallbacks(use_default_callbacks=False)
        self._clock = clock
        self._lock = threading.Lock()
        self._swap: ReaderSwap[ReaderQos, Sample] | None = None
        self._timer: Any = None
        self._results: Counter[str] = Counter()
        self._refusal = NO_REFUSAL
        self._resolved = str(node.resolve_topic_name(topic))
        self.parameters = {
            reader_parameter_name(self._resolved, setting): field for setting, (field, _) in _SETTINGS.items()
        }
        self.callback = callback
        self.baseline = ReaderQos(
            depth=max(1, self.qos_profile.depth),
            deadline_ns=deadline_ns_of(self.qos_profile),
            reliability=self.qos_profile.reliability,
            durability=self.qos_profile.durability,
        )
        qos = self._declare()
        try:
            self._swap = ReaderSwap(create=self._create_reader, on_result=self._on_result, qos=qos)
        except Exception:
            self._undeclare()
            raise
        self._deadlines = DeadlineCount(self._reader)
        self._shared = NodeSubscriptions.of(node)
        self._shared.adopt(self)

    # -- the interface of rclpy.subscription.Subscription

    @property
    def callback(self) -> Callable[..., Any]:
        """Function called with each message, with or without MessageInfo."""
        return self._callback

    @callback.setter
    def callback(self, value: Callable[..., Any]) -> None:
        self._arguments = arguments_of(value)
        self._callback = value

    @property
    def topic_name(self) -> str:
        """Fully qualified topic name."""
        return self._resolved

    @property
    def handle(self) -> Any:
        """Handle of the reader in force; a swap replaces it, so do not store it."""
        return self._reader.subscription.handle

    @property
    def event_handlers(self) -> Any:
        """Event handlers of the reader in force."""
        return self._reader.subscription.event_handlers

    @property
    def logger_name(self) -> str:
        """Name of the logger of the subscription's node."""
        return str(self._reader.subscription.logger_name)

    def get_publisher_count(self) -> int:
        """Count the matched writers."""
        with self._lock:
            return self._reader.matched()

    def destroy(self) -> None:
        """Destroy the subscription and all its readers."""
        self._shared.release(self)
        self._undeclare()
        with self._lock:
            self._stop_timer()
            assert self._swap is not None
            self._swap.close()

    # -- re-tuning

    @property
    def qos(self) -> ReaderQos:
        """QoS of the reader in force."""
        assert self._swap is not None
        return self._swap.qos

    def renew(self, qos: ReaderQos) -> None:
        """Replace the reader by one with this QoS, without losing or doubling a sample; returns at once."""
        with self._lock:
            assert self._swap is not None
            self._swap.request(qos)
            if self._swap.is_busy and self._timer is None:
                # Steady time, so that a paused simulation does not stop a swap. The callbacks' own group, so that the
                # samples of the switch never overtake those that a callback is delivering.
                self._timer = self._node.create_timer(
                    _POLL_S, self._deliverer(self._step), self.callback_group, Clock(clock_type=ClockType.STEADY_TIME)
                )

    def state(self, *, generation: int = 0, lease_s: float = 0.0) -> ReaderState:
        """Return the settings in force, for the announcement."""
        with self._lock:
            qos, refusal = self.qos, self._lasting_refusal(self.qos) or self._refusal
            return ReaderState(
                node=self._node.get_fully_qualified_name(),
                topic=self._resolved,
                depth=qos.depth,
                deadline_ns=qos.deadline_ns,
                baseline_depth=self.baseline.depth,
                baseline_deadline_ns=self.baseline.deadline_ns,
                generation=generation,
                lease_s=lease_s,
                keeps_all=self._keeps_all,
                refusal=refusal.words,
                refusal_reason=refusal.reason,
                swaps_by_result=dict(self._results),
                deadlines_missed=self._deadlines.missed,
            )

    @property
    def _reader(self) -> RosReader:
        assert self._swap is not None
        current = self._swap.current
        assert isinstance(current, RosReader)
        return current

    # -- samples

    def _create_reader(self, qos: ReaderQos) -> RosReader:
        profile = copy(self.qos_profile)
        profile.depth = qos.depth
        profile.deadline = Duration(nanoseconds=qos.deadline_ns)
        profile.reliability = qos.reliability
        profile.durability = qos.durability
        reader = RosReader(self._node)
        reader.subscription = self._node.create_subscription(
            self.msg_type,
            self.topic,
            self._tap(reader),
            profile,
            callback_group=self.callback_group,
            event_callbacks=reader.counting(self._event_callbacks),
            raw=self.raw,
        )
        return reader

    def _tap(self, reader: RosReader) -> Callable[..., Any]:
        """Return the rclpy callback of one reader."""
        sifted = self._deliverer(lambda *taken: self._sift(reader, taken))

        def direct(*taken: Any) -> None:
            if self._swap is None or self._swap.is_tracking:
                sifted(*taken)
            else:  # the usual case, kept short
                self._callback(*(taken if len(taken) == 2 else taken[0])[: self._arguments])

        tap: Any = sifted if inspect.iscoroutinefunction(sifted) else direct
        tap.__signature__ = _WITH_INFO  # rclpy asks it whether to pass MessageInfo
        return tap  # type: ignore[no-any-return]

    def _deliverer(self, samples: Callable[..., Sequence[Sample]]) -> Callable[..., Any]:
        """Return a function that delivers the samples another one returns; a coroutine if the callback is one."""

        def deliver(*taken: Any) -> None:
            for sample in samples(*taken):
                self._callback(*sample[: self._arguments])

        async def deliver_async(*taken: Any) -> None:
            for sample in samples(*taken):
                await self._callback(*sample[: self._arguments])

        return deliver_async if inspect.iscoroutinefunction(self._callback) else deliver

    def _sift(self, reader: RosReader, taken: tuple[Any, ...]) -> Sequence[Sample]:
        # EventsExecutor of rclpy 7.1 passes message and info as one tuple, the other executors as two arguments.
        sample: Sample = taken if len(taken) == 2 else taken[0]
        swap = self._swap
        if swap is None or not swap.is_tracking:
            return (sample,)
        with self._lock:
            return swap.accept(reader, key_of(sample), sample, now_s=self._clock())

    def _step(self) -> Sequence[Sample]:
        with self._lock:
            assert self._swap is not None
            began_s = self._clock()
            if (creates := self._swap.will_create) and began_s < self._shared.create_from_s:
                return ()
            samples = self._swap.step(began_s)
            if creates:
                self._shared.note_creation(began_s)
            self._deadlines.follow(self._reader)
            if not self._swap.is_busy:
                self._stop_timer()
        return samples

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None

    # -- parameters

    def _declare(self) -> ReaderQos:
        """Declare the parameters; return the QoS with the overrides given at the start."""
        if any(self._node.has_parameter(name) for name in self.parameters):
            raise ValueError(
                f"{self._node.get_fully_qualified_name()} already has an AdaptiveSubscription on {self._resolved}; "
                "their parameters would share one name"
            )
        for name, (field, description) in zip(self.parameters, _SETTINGS.values(), strict=True):
            OwnParameters(self._node).declare(name, getattr(self.baseline, field), description)
        try:
            return self._wanted(self.baseline, [self._node.get_parameter(name) for name in self.parameters])
        except ValueError:
            self._undeclare()
            raise

    def _undeclare(self) -> None:
        for name in self.parameters:
            OwnParameters(self._node).undeclare(name)

    def check(self, parameters: Sequence[Any]) -> None:
        """Refuse values of its parameters that are out of bounds, or that would lose samples or writers.

        Raises
        ------
        ValueError
            The message names the reason.
        """
        wanted = self._wanted(self.qos, parameters)
        if wanted != self.qos:
            self._check(wanted)

    def follow_parameters(self) -> None:
        """Request the QoS that its parameters have; all of them, because an earlier request may be under way."""
        with suppress(ParameterNotDeclaredException):  # another thread has just destroyed it
            self.renew(self._wanted(self.qos, [self._node.get_parameter(name) for name in self.parameters]))

    def _wanted(self, qos: ReaderQos, parameters: Sequence[Any]) -> ReaderQos:
        changes: dict[str, int] = {}
        for parameter in parameters:
            if (field := self.parameters.get(parameter.name)) is not None:
                changes[field] = (
                    checked_depth(parameter, max(MOST_DEPTH, self.baseline.depth))
                    if field == "depth"
                    else checked_deadline_ns(parameter, own_ns=self.baseline.deadline_ns)
                )
        return replace(qos, **changes)

    @property
    def _keeps_all(self) -> bool:
        return bool(self.qos_profile.history == QoSHistoryPolicy.KEEP_ALL)

    def _lasting_refusal(self, qos: ReaderQos) -> Refusal | None:
        """Return why such a reader is never replaced, None if it may be."""
        is_latched = qos.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL
        words = f"{self._resolved} is TRANSIENT_LOCAL: a new reader would receive the writers' history again"
        return lasting_refusal(self._rmw, latched=words if is_latched else "")

    def _check(self, wanted: ReaderQos) -> None:
        """Refuse QoS that would lose samples or writers."""
        if refusal := self._lasting_refusal(wanted):
            raise ValueError(refusal.words)
        if wanted.depth != self.qos.depth and self._keeps_all:
            raise ValueError(f"{self._resolved} is KEEP_ALL: it has no depth to set")
        lost = sorted(
            f"{node_name_of(writer)} offers {f'{offered} ns' if offered else 'none'}"
            for writer in self._node.get_publishers_info_by_topic(self._resolved)
            if is_kept(offered := deadline_ns_of(writer.qos_profile), self.qos.deadline_ns)
            and not is_kept(offered, wanted.deadline_ns)
        )
        if lost:
            raise ValueError(
                f"a deadline of {wanted.deadline_ns} ns would lose publishers of {self._resolved} "
                f"({', '.join(lost)}); shorten their deadlines first"
            )

    def _on_result(self, result: ReaderSwapResult) -> None:
        self._results[result] += 1
        self._shared.note_news()
        self._refusal = NO_REFUSAL
        failed = f"reader swap of {self._resolved} failed"
        if result is ReaderSwapResult.UNMATCHED:
            words = "not all publishers matched the new reader in time"
            self._refusal = Refusal(RefusalReason.UNMATCHED, f"{failed}: {words}; the old reader stays")
        elif result is ReaderSwapResult.FAILED:
            words = "the middleware refused the new reader, or it ran too far ahead of the old one"
            self._refusal = Refusal(RefusalReason.FAILED, f"{failed}: {words}; the old reader stays")
        if self._refusal.words:
            self._node.get_logger().warning(self._refusal.words)
