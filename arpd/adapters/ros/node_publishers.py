"""The shared half of one node's AdaptivePublishers: plan, price and announcement."""

from __future__ import annotations

import math
import threading
import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

from arpd.adapters.ros.announcer import Announcer
from arpd.adapters.ros.attached import attached
from arpd.adapters.ros.bounds import checked_row
from arpd.adapters.ros.daemon_messages import DaemonMessages
from arpd.adapters.ros.events import InvalidHandle
from arpd.adapters.ros.grant import Grant
from arpd.adapters.ros.profile import missing_here, warn_once
from arpd.adapters.ros.rmw import current_rmw
from arpd.adapters.ros.writing_thread import WritingThread
from arpd.apply.endpoint.queue import PacedQueue, Whole
from arpd.model.plan import TopicPlan

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

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

    The participant's own threads read plans and the price, and announce: nothing depends on the node's executor, and no
    callback of the application delays a rate.

    Attributes
    ----------
    thread : writes the samples of all nodes of the participant, and serves their publishers
    """

    def __init__(self, node: Node, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._clock = clock
        self.thread = attached(node.context, WritingThread, lambda: _started(node.context, clock))
        self._publishers: dict[str, Paced] = {}
        self._warned: set[str] = set()  # topics that make others wait
        self._rows: Mapping[str, Mapping[str, Any]] = {}  # of the plan in force, also of topics that are not there yet
        self._price: Price | None = None  # the last one; it stays when the daemon falls silent, as the plan does
        self._check_s = clock()
        self._grant = Grant(clock=clock)
        # Only Fast DDS has profiles, and only its writers can be swapped.
        self._lacks_profile = current_rmw().can_swap and bool(missing := missing_here())
        if self._lacks_profile:
            warn_once(node.get_logger(), missing)
        self._lock = threading.RLock()  # guards plan, price and who has them
        self._announcer: Announcer[Paced] = Announcer(node, self._state_of)
        self._messages = DaemonMessages(
            node, self, warn=lambda words: node.get_logger().warning(words, throttle_duration_sec=_WARN_EVERY_S)
        )
        self.thread.wake(self)

    @classmethod
    def of(cls, node: Node) -> NodePublishers:
        """Return the node's own, made on first use and stored on the node."""
        return attached(node, cls, lambda: cls(node))

    def adopt(self, publisher: Paced) -> None:
        """Give a publisher its price and its row of the plan, now and from now on.

        Raises
        ------
        ValueError
            If the node has one on this topic already: a plan has one row for both.
        """
        topic = publisher.topic_name
        if topic in self._publishers:
            raise ValueError(
                f"{self._node.get_fully_qualified_name()} already has an AdaptivePublisher on {topic}; "
                "a plan has one row for both"
            )
        with self._lock:
            self._publishers = {**self._publishers, topic: publisher}
            self._show_price(publisher)
            self._give_row(publisher)

    def release(self, publisher: Paced) -> None:
        """Forget a publisher."""
        topic = publisher.topic_name
        with self._lock:
            self._publishers = {name: kept for name, kept in self._publishers.items() if name != topic}

    def note_swap(self, publisher: Paced) -> None:
        """Announce a publisher soon, because a swap of it has ended; for any thread."""
        self._announcer.hurry(publisher)
        self.thread.wake(self)

    def service(self, now_s: float) -> float:
        """Announce what is due; return when to call again (s)."""
        try:
            if now_s >= self._check_s:
                self._check_s = now_s + _CHECK_S
                with self._lock:
                    self._note_silence(now_s)
                    self._expire_plan()
                self._warn_of_large()
            if now_s >= self._announcer.due_s:
                answer, lease_s = self._grant.answer, self._grant.lease.granted_s
                self._announcer.turn(now_s, self._publishers.values(), answer=answer, lease_s=lease_s)
        except InvalidHandle:
            if not self._has_node:
                self._messages.destroy()
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

    def take_price(self, price: Price) -> None:
        """Take the price of the link."""
        with self._lock:
            self._price = price
            self._grant.lease.renew(self._clock())
            self._show_price(*self._publishers.values())

    def _note_silence(self, now_s: float) -> None:
        if self._grant.lease.is_silent(now_s, for_s=_SILENT_S):
            self._show_price(*self._publishers.values())

    def _warn_of_large(self) -> None:
        """Say once of each topic that it makes the others of its participant wait."""
        if self.thread.topics < 2:
            return
        for topic, publisher in self._publishers.items():
            if publisher.payload_bytes >= _LARGE_BYTES and topic not in self._warned:
                self._warned.add(topic)
                self._node.get_logger().warning(
                    f"{topic} has samples of {publisher.payload_bytes / 1e6:.1f} MB: while one is written to a slow "
                    "link, the other topics of this participant wait inside Fast DDS; publish it from a process of its "
                    "own, or carry it by an arpd relay of its own"
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
        for publisher in self._publishers.values():
            own = publisher.baseline
            plan = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=own.deadline_ns, depth=own.depth)
            publisher.retune(plan)
        self._price = None
        self._show_price(*self._publishers.values())

    def take_plan(self, plan: NodePlan, crc: int) -> None:
        """Take all rows of a plan for this node's publishers, or none of them; the next announcement has the answer."""
        if not plan.publishers:
            return
        with self._lock:
            try:
                self._grant.check(plan)
                rows = [
                    (publisher, checked_row(topic, row, publisher.baseline))
                    for topic, publisher in self._publishers.items()
                    if (row := plan.publishers.get(topic)) is not None
                ]
            except ValueError as refusal:
                self.refuse_plan(crc, str(refusal))
                return
            is_repeated = self._grant.take(plan, crc)
            self._rows = plan.publishers
            for publisher, wanted in rows:
                if is_repeated or wanted != publisher.plan:  # the daemon repeats a plan when a swap failed, for example
                    self._retune(publisher, wanted)
        self._tell_answer()

    def refuse_plan(self, crc: int, words: str) -> None:
        """Answer that a plan is refused, and why."""
        self._grant.refuse(crc, words)
        self._tell_answer()

    def _tell_answer(self) -> None:
        self._announcer.hurry_answer()
        self.thread.wake(self)

    def _give_row(self, publisher: Paced) -> None:
        """Give a new publisher its row of the plan in force, which its node has answered for it too."""
        topic = publisher.topic_name
        if self._grant.generation and (row := self._rows.get(topic, {})).get("weight"):
            with suppress(ValueError):  # the row of a predecessor with other QoS
                self._retune(publisher, checked_row(topic, row, publisher.baseline))

    def _retune(self, publisher: Paced, plan: TopicPlan) -> None:
        publisher.retune(plan)
        self._show_price(publisher)


def _started(context: Context, clock: Callable[[], float]) -> WritingThread:
    """Return the thread of a participant, which ends with it."""
    thread = WritingThread(PacedQueue(Whole()), name="arpd-writing", is_alive=context.ok, clock=clock)
    thread.start()
    context.on_shutdown(thread.stop)
    return thread
