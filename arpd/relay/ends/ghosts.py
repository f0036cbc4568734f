"""Ghosts of the other side's nodes and writers, which make its topics look here as they look there."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.parameter import Parameter
from rclpy.qos import QoSLivelinessPolicy, QoSProfile

from arpd.endpoint.writer import RosWriter, swap_failure
from arpd.endpoint.writer_swap import WriterSwap
from arpd.model.endpoints import SwapResult, SwapTiming, WriterQos
from arpd.ros.graph import Requests, policies_of
from arpd.ros.raw_reader import bounded_depth

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from arpd.relay.ends.offers import WriterOffer
    from arpd.relay.envelope import Record

log = logging.getLogger(__name__)
_MATCH_S = 0.5  # a reader on this host finds a new writer sooner
_MOST_EARLY = 1000
# A writer whose reader stands still is never acknowledged. It stays until it is: a plan here is in no hurry. Where the
# original is silent only the steps write what was held, ten times a second.
_TIMING = SwapTiming(patience_s=math.inf, burst=5)
_ASK_AGAIN_S = 60.0  # a refused swap, or a reader that has left, changes what can be in force
NO_PLAN = WriterQos(depth=0, deadline_ns=0)
_NO_TYPE_DESCRIPTION = Parameter("start_type_description_service", value=False)
T = TypeVar("T")


class GhostNodes:
    """Nodes of this process with the names of the other side's nodes, each for as long as it has an endpoint.

    Parameters
    ----------
    node : the end's own node; a ghost with its name, or a name that ROS refuses, is this node itself
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._ghosts: dict[str, Node] = {}
        self._lock = threading.Lock()

    def give(self, name: str, make: Callable[[Node], T]) -> T:
        """Make an endpoint in the ghost of the node with this fully qualified name; for any thread."""
        with self._lock:
            if name not in {"", self._node.get_fully_qualified_name(), *self._ghosts}:
                namespace, _, base = name.rpartition("/")
                # Another middleware may have names that rcl refuses.
                with suppress(NameValidationException, RuntimeError):
                    self._ghosts[name] = rclpy.create_node(
                        base,
                        namespace=namespace or "/",
                        context=self._node.context,
                        use_global_arguments=False,
                        enable_rosout=False,
                        start_parameter_services=False,
                        parameter_overrides=[_NO_TYPE_DESCRIPTION],
                    )
            return make(self._ghosts.get(name, self._node))

    def tidy(self) -> None:
        """Destroy the ghosts that have no endpoint any more."""
        with self._lock:
            for name, node in [*self._ghosts.items()]:
                if len([*node.publishers, *node.services]) == 1:  # that of /parameter_events
                    self._ghosts.pop(name).destroy_node()


class GhostWriter:
    """The ghost of one writer: the same QoS, and every sample of that writer once and in its order.

    Its readers find it some time after it is made. Until then it holds its samples, so that none is lost.

    A swap gives it the plan's depth and deadline, but no longer deadline than the original offers, and the one in force
    where a longer one would lose a reader that hears it. And no smaller depth than without a plan: the plan's is what
    may wait for the link, perhaps one sample, while this one keeps what has arrived for a reader on this host that
    pauses. A latched ghost is never swapped: late readers would miss its samples, or those already there get them
    twice.

    Parameters
    ----------
    depth : KEEP_LAST depth without a plan; discovery does not tell the original's (samples)
    planned : depth and deadline of the plan
    most_held_bytes : what may wait for a reader that stands still; where the samples are too large for that, the depth
        is swapped for a smaller one
    """

    def __init__(
        self,
        node: Node,
        msg_type: Any,
        topic: str,
        offer: WriterOffer,
        *,
        depth: int,
        planned: WriterQos = NO_PLAN,
        most_held_bytes: int | None = None,
    ) -> None:
        self.offer, self._node, self._depth = offer, node, depth
        self._most_held_bytes = None if offer.is_latched else most_held_bytes
        self._new_publisher = partial(node.create_publisher, msg_type, topic)
        self._planned = NO_PLAN if offer.is_latched else planned
        self._requests = Requests(node, topic)
        # The lock of `Incoming` lets one thread write.
        self._swap = WriterSwap(
            create=self._create, on_result=self._on_result, qos=self._wanted(), clock=time.monotonic, timing=_TIMING
        )
        self._swap.loss_ratio = 0.0  # its readers are on this host
        self.due_s = math.inf if self._planned == NO_PLAN else time.monotonic()  # when to `swap`
        self._refusal = ""
        self._made_s = time.monotonic()
        self._is_found = False
        self._early: deque[bytes] = deque(maxlen=_MOST_EARLY)
        self._last = 0  # number of the newest sample
        self.gone_s = math.inf  # when the original was missed first

    def matched(self) -> int:
        """Count its readers."""
        return self._swap.current.matched()

    def write(self, record: Record) -> bool:
        """Write a sample, unless it was written before; return whether it was new."""
        if record.sequence <= self._last:
            return False
        self._last = record.sequence
        if (depth := bounded_depth(self._depth, record.sample, self._most_held_bytes)) != self._depth:
            self._depth, self.due_s = depth, time.monotonic()
        if self._is_found:
            self._swap.write(record.sample)
        else:
            self._early.append(record.sample)
            self._look()
        return True

    def follow(self, offer: WriterOffer, planned: WriterQos) -> None:
        """Take what is told of the original, and the plan's depth and deadline; `swap` follows at ``due_s``."""
        # It may be alive now. The ghost stays in its node, whatever an end that has just started calls that.
        self.offer, self.gone_s = replace(offer, node=self.offer.node), math.inf
        if planned != self._planned and not self.offer.is_latched:
            self._planned, self.due_s = planned, time.monotonic()

    def swap(self) -> None:
        """Ask for the plan's QoS, which steps put in force."""
        self.due_s = time.monotonic() + _ASK_AGAIN_S
        wanted = self._wanted()
        if self._requests.lost(self._swap.qos.deadline_ns, wanted.deadline_ns):
            wanted = replace(wanted, deadline_ns=self._swap.qos.deadline_ns)
        self._swap.request(wanted)

    def step(self, *, is_reachable: bool = True) -> None:
        """Move a swap on, and write the samples that wait for it or for readers; live as the original does.

        Parameters
        ----------
        is_reachable : whether the original's end is: what it said of the original does not hold any longer otherwise
        """
        if self.offer.is_alive and is_reachable:
            for writer in self._swap.writers:
                writer.publisher.assert_liveliness()
        if not self._is_found:
            self._look()
        if self._swap.is_busy:
            self._swap.step(time.monotonic())

    def destroy(self) -> None:
        """Destroy the writer."""
        self._swap.close()

    def _look(self) -> None:
        """Write the first samples, all at once, when its readers have found it."""
        self._is_found = self.matched() > 0 or time.monotonic() - self._made_s > _MATCH_S
        while self._is_found and self._early:
            self._swap.write(self._early.popleft())

    def _wanted(self) -> WriterQos:
        deadlines = [ns for ns in (self._planned.deadline_ns, self.offer.deadline_ns) if ns]
        return WriterQos(depth=max(self._planned.depth, self._depth), deadline_ns=min(deadlines, default=0))

    def _create(self, qos: WriterQos) -> RosWriter:
        offer = self.offer
        profile = QoSProfile(
            depth=qos.depth,
            **policies_of(is_reliable=offer.is_reliable, is_latched=offer.is_latched),
            deadline=Duration(nanoseconds=qos.deadline_ns),
            lifespan=Duration(nanoseconds=offer.lifespan_ns),
            liveliness=QoSLivelinessPolicy.MANUAL_BY_TOPIC if offer.is_manual else QoSLivelinessPolicy.AUTOMATIC,
            liveliness_lease_duration=Duration(nanoseconds=offer.lease_ns),
        )
        return RosWriter(
            node=self._node,
            create=partial(self._new_publisher, profile),
            event_callbacks=None,
            requests=self._requests,
            in_force=lambda: self._swap.current,
        )

    def _on_result(self, result: SwapResult, qos: WriterQos) -> None:
        if result not in {SwapResult.UNMATCHED, SwapResult.INCOMPATIBLE, SwapResult.FAILED}:
            return
        offered_ns = self._swap.qos.deadline_ns
        words = swap_failure(result, qos, requests=self._requests, offered_ns=offered_ns)
        if words != self._refusal:
            self._refusal = words
            log.warning(words)
