"""The shared half of one node's AdaptivePublishers: plan, price, and the snapshot for the daemon."""

from __future__ import annotations

import math
import threading
import time
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

from arpd.endpoint.queue import PacedQueue
from arpd.endpoint.writing_thread import WritingThread
from arpd.model.endpoints import MOST_PUBLISHERS, PublisherState, WriterQos
from arpd.model.plan import NO_PLAN, PlanAnswer, TopicPlan
from arpd.ros.cdr import wrap
from arpd.ros.graph import this_host
from arpd.ros.inbox import PRICES, Inbox, Letters
from arpd.ros.names import PLAN_TOPIC, PUBLISHERS_TOPIC
from arpd.ros.node_snapshot import encode_snapshot
from arpd.ros.plan_message import MOST_BYTES, PLAN_QOS, PlanMessage, checked_row, decode_plan
from arpd.ros.profile import missing_here, warn_once
from arpd.ros.rcl import NO_EVENTS, InvalidHandle, NotedPublisher, attached, is_live
from arpd.ros.rmw import current_rmw

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from rclpy.node import Node

    from arpd.model.price import Price
    from arpd.model.relay import RelaySummary

_TELL_S = 1.0
# Least time between two snapshots: 0.2 s, and what keeps a thousand publishers whose swaps end at any moment cheap.
_EARLY_S, _EARLY_S_PER_PUBLISHER = 0.2, 2e-3
_NEWEST = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
_PLANS = Letters(topic=PLAN_TOPIC, decode=decode_plan, most_bytes=MOST_BYTES, most_hz=10.0)  # a daemon sends 5 at most
_SILENT_S = 5.0  # a daemon sends its price every second; one that is silent for so long will plan nothing soon
_LARGE_BYTES = 250_000  # at 20 Mbit/s others wait for 0.1 s


class Paced(Protocol):
    """An AdaptivePublisher as `NodePublishers` sees it, with its topic and the QoS of the application."""

    topic_name: str
    baseline: WriterQos

    @property
    def plan(self) -> TopicPlan:
        """Settings requested last."""

    def retune(self, plan: TopicPlan) -> None:
        """Take new settings."""

    def set_price(self, price: Price | None) -> None:
        """Take the price of the link; None = no daemon is there."""

    def finish(self) -> None:
        """Write what waits."""

    def state(self) -> PublisherState:
        """Return the state to tell the daemon, without the plan's generation and lease."""


class NodePublishers:
    """Tunes all AdaptivePublishers of one node, and tells the daemon of them; the first of them makes it.

    The participant's own threads read plan and price, and send a snapshot: once a second, which is also the node's
    sign of life, and soon after news. Nothing depends on the node's executor, and no callback of the application delays
    a rate.

    Attributes
    ----------
    thread : writes the samples of all nodes of the participant, and serves their publishers
    relay : returns the summary to send along; None = this node is no end of a relay, or not the one that tells
    """

    topic_name = PUBLISHERS_TOPIC

    def __init__(self, node: Node, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._name = node.get_fully_qualified_name()
        self._clock = clock
        self.thread = attached(node.context, WritingThread, lambda: _started(node, clock))
        self.relay: Callable[[], RelaySummary] | None = None
        self._publishers: dict[str, Paced] = {}
        self._warned: set[str] = set()  # topics that make others wait
        self._rows: Mapping[str, Any] = {}  # of the plan in force, also of topics that are not there yet
        self._answer = NO_PLAN
        self._heard_s = -math.inf  # last sign of the daemon
        self._price: Price | None = None  # the last one; it stays when the daemon falls silent, as the plan does
        self._told_s = -math.inf
        self._has_news = False
        # Only Fast DDS has profiles, and only its writers can be swapped.
        self._lacks_profile = current_rmw().is_fast_dds and bool(missing := missing_here())
        if self._lacks_profile:
            warn_once(node.get_logger(), missing)
        self._lock = threading.RLock()  # guards plan, price and who has them
        self._snapshots = node.create_publisher(
            UInt8MultiArray,
            PUBLISHERS_TOPIC,
            _NEWEST,
            event_callbacks=NO_EVENTS,
            publisher_class=partial(NotedPublisher, self._end),
        )
        # Read in a thread of arpd's own: no callback of the application delays them.
        warn = node.get_logger().warning
        self._inboxes = (
            Inbox(node, PRICES, _NEWEST, lambda _sample, price: self.take_price(price), clock=clock, warn=warn),
            Inbox(node, _PLANS, PLAN_QOS, lambda _sample, plan: self.take_plan(plan), clock=clock, warn=warn),
        )
        self.thread.wake(self)

    @classmethod
    def of(cls, node: Node) -> NodePublishers:
        """Return the node's own, made on first use and stored on the node."""
        return attached(node, cls, lambda: cls(node))

    def adopt(self, publisher: Paced) -> None:
        """Give a publisher its price and its row of the plan, now and from now on.

        Raises ValueError if the node has one on this topic already: a plan has one row for both.
        """
        topic = publisher.topic_name
        with self._lock:
            if self._publishers.setdefault(topic, publisher) is not publisher:
                raise ValueError(f"{self._name} already has an AdaptivePublisher on {topic}; a plan has one row for it")
            self._show_price(publisher)
            self._give_row(publisher)
        self.hurry()

    def release(self, publisher: Paced) -> None:
        """Forget a publisher; the function of a signal may call it, so no lock is waited for."""
        if self._publishers.get(publisher.topic_name) is publisher:
            self._publishers.pop(publisher.topic_name, None)

    @property
    def _all(self) -> list[Paced]:
        # Other threads add and remove some; to make a tuple would collect garbage first, and let them.
        return [*self._publishers.values()]

    def hurry(self) -> None:
        """Send a snapshot soon, because a swap has ended, for example; for any thread."""
        self._has_news = True
        self.thread.wake(self)

    def service(self, now_s: float) -> float:
        """Do what is due; return when to call again (s)."""
        if now_s < self._tell_s:
            return self._tell_s
        self._told_s, self._has_news = now_s, False
        with self._lock:
            if now_s - self._heard_s > _SILENT_S:
                self._show_price(*self._all)
            self._expire_plan()
        self._tell()
        return self._tell_s

    def finish(self) -> None:
        """Write what waits."""
        for publisher in self._all:
            with suppress(RuntimeError):  # RCLError is one
                publisher.finish()

    def _end(self) -> None:
        """Tell that no publisher is left, and read no more: a reader would keep the node, and the participant."""
        with suppress(RuntimeError):  # of rclpy: its context has ended first
            self._tell()
        for inbox in self._inboxes:
            inbox.destroy()

    @property
    def _tell_s(self) -> float:
        """When the next snapshot is due (s)."""
        early_s = _EARLY_S + _EARLY_S_PER_PUBLISHER * len(self._publishers)
        return self._told_s + (min(_TELL_S, early_s) if self._has_news else _TELL_S)

    def _tell(self) -> None:
        states = []
        for publisher in self._all:
            with suppress(InvalidHandle):  # another thread has just destroyed it
                states.append(publisher.state())
        told = states[:MOST_PUBLISHERS]  # the daemon names the node of the others
        self._warn_of_large(states)
        message = encode_snapshot(
            self._name,
            told,
            left_out=len(states) - len(told),
            answer=self._answer,
            lacks_profile=self._lacks_profile,
            relay=self.relay and self.relay(),
            host=this_host(),
        )
        self._snapshots.publish(wrap(message))

    def take_price(self, price: Price) -> None:
        """Take the price of the link."""
        with self._lock:
            self._price = price
            self._heard_s = self._clock()
            self._show_price(*self._all)

    def _warn_of_large(self, states: Iterable[PublisherState]) -> None:
        """Say once of each topic that it makes the others of its participant wait."""
        for state in states:
            if state.payload_bytes >= _LARGE_BYTES and self.thread.topics > 1 and state.topic not in self._warned:
                self._warned.add(state.topic)
                self._node.get_logger().warning(
                    f"{state.topic} has samples of {state.payload_bytes / 1e6:.1f} MB: while one is written to a slow "
                    "link, the other topics of this participant wait inside Fast DDS; publish it from a process of its "
                    "own, or carry it by an arpd relay of its own"
                )

    def _show_price(self, *publishers: Paced) -> None:
        """Give publishers the last price.

        To one without a plan a price only says that a daemon is there, which will plan it. Silence ends that.
        """
        price = self._price
        if is_silent := self._clock() - self._heard_s > _SILENT_S:
            price = None if price is None else replace(price, is_stale=True)
        for publisher in publishers:
            publisher.set_price(None if is_silent and not publisher.plan.weight else price)

    def _expire_plan(self) -> None:
        """Return every publisher to its application's QoS when the lease has run out."""
        lease_s = self._answer.lease_s
        if not (self._answer.generation and lease_s) or self._clock() - self._heard_s <= lease_s:
            return
        self._node.get_logger().warning(f"no sign of arpd for {lease_s:g} s: the publishers return to their own QoS")
        self._answer = NO_PLAN  # the next daemon may begin with any generation
        self._rows = {}
        for publisher in self._all:
            own = publisher.baseline
            plan = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=own.deadline_ns, depth=own.depth)
            publisher.retune(plan)
        self._price = None
        self._show_price(*self._all)

    def take_plan(self, plan: PlanMessage) -> None:
        """Take all rows of a plan for this node's publishers, or none of them; the next snapshot has the answer."""
        with self._lock:
            try:
                rows = self._checked_rows(plan)
            except ValueError as refusal:
                self._answer = replace(self._answer, refused=plan.generation, refusal=str(refusal))
                self.hurry()
                return
            self._answer = PlanAnswer(plan.generation, plan.lease_s)
            self._heard_s = self._clock()  # a plan is a sign of the daemon
            self._rows = plan.rows
            for publisher, wanted in rows:
                self._retune(publisher, wanted)
        self.hurry()

    def _checked_rows(self, plan: PlanMessage) -> list[tuple[Paced, TopicPlan]]:
        """Return the rows of this node's publishers; raises ValueError if the plan is refused."""
        if plan.generation < (in_force := self._answer.generation):
            raise ValueError(f"generation {plan.generation} is older than {in_force}, the plan in force")
        return [
            (publisher, checked_row(topic, plan.rows[topic], publisher.baseline))
            for publisher in self._all
            if (topic := publisher.topic_name) in plan.rows
        ]

    def _give_row(self, publisher: Paced) -> None:
        """Give a new publisher its row of the plan in force, which its node has answered for it too."""
        topic = publisher.topic_name
        if topic in self._rows:
            with suppress(ValueError):  # the row of a predecessor with other QoS
                if (row := checked_row(topic, self._rows[topic], publisher.baseline)).weight:
                    self._retune(publisher, row)

    def _retune(self, publisher: Paced, plan: TopicPlan) -> None:
        publisher.retune(plan)
        self._show_price(publisher)


def _started(node: Node, clock: Callable[[], float]) -> WritingThread:
    """Return the thread of a participant, which ends with it, and speaks for its first node."""
    context, warn = node.context, node.get_logger().error
    is_alive = partial(is_live, context)
    thread = WritingThread(PacedQueue(), name="arpd-writing", warn=warn, is_alive=is_alive, clock=clock)
    thread.start()
    context.on_shutdown(thread.stop)
    return thread
