"""The processes around arpd in `overhead.py` and `pi.py`: one has all sources, one reads everything and sends commands.

Usage: python -m scripts.bench.overhead_nodes source|sink|taker TOPICS

A taker is a sink that takes what arrives, and knows its age. A sink leaves it, so that only DDS works.

The parent speaks to each in lines of JSON (`scripts.bench.child`).
"""

from __future__ import annotations

import heapq
import queue
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64MultiArray, String

from arpd import AdaptivePublisher
from arpd.adapters.ros.names import PRICE_TOPIC
from arpd.adapters.ros.price_message import decode_price
from arpd.adapters.ros.runtime import spinning
from scripts.bench.child import answer, commands, sample_of
from scripts.bench.node import plain_node, raw_readers, taken
from scripts.bench.overhead_cases import Topic, case_of

if TYPE_CHECKING:
    from collections.abc import Sequence

_DEPTH = 10  # what every rclpy tutorial passes
_TAKER_DEPTH = 1000
_TAKE_S = 0.02
_MOST_PRICES = 5000
_HEAD, _DIGITS = 8, 20  # of a serialized sample: what stands before its text, and its time of publication in the text


class Sources:
    """Publishes every topic at its rate, with the samples spread over time."""

    def __init__(self, topics: Sequence[Topic], publishers: Sequence[Any]) -> None:
        self._topics = topics
        self._publishers = publishers
        samples = [sample_of(0, topic.text_bytes) for topic in topics]
        self._around = [(sample[:_HEAD], sample[_HEAD + _DIGITS :]) for sample in samples]
        self._due: list[tuple[float, int]] = []
        self._began_s = 0.0
        self.sent = 0

    def begin(self) -> None:
        """Begin to publish."""
        self._began_s = time.monotonic()
        count = len(self._topics)
        self._due = [(self._began_s + k / count / topic.rate_hz, k) for k, topic in enumerate(self._topics)]
        heapq.heapify(self._due)

    def end(self) -> None:
        """Stop publishing."""
        self._due = []

    def account(self) -> dict[str, float]:
        """Return the number of samples published so far, and the number due by the topics' rates."""
        spent_s = time.monotonic() - self._began_s if self._due else 0.0
        return {"sent": self.sent, "expected": sum(topic.rate_hz for topic in self._topics) * spent_s}

    def publish_due(self) -> float | None:
        """Publish the samples that are due; return the time until the next (s), None while stopped."""
        if not self._due:
            return None
        while (now_s := time.monotonic()) >= self._due[0][0]:
            due_s, k = self._due[0]
            heapq.heapreplace(self._due, (due_s + 1.0 / self._topics[k].rate_hz, k))
            head, tail = self._around[k]
            self._publishers[k].publish(head + b"%020d" % time.time_ns() + tail)
            self.sent += 1
        return self._due[0][0] - now_s


class PriceWatch:
    """Subscribes to the price until `end`; DDS notes the time of each message, so they may be taken late."""

    def __init__(self, node: Any) -> None:
        self._node = node
        qos = QoSProfile(depth=_MOST_PRICES, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self._subscription = node.create_subscription(Float64MultiArray, PRICE_TOPIC, lambda _price: None, qos)

    def end(self) -> list[tuple[float, float]]:
        """Return the time (Unix time, s) of each price, and the bytes per second that weight 1 may send under it."""
        prices = []
        handle = self._subscription.handle
        with handle:
            while (taken := handle.take_message(Float64MultiArray, False)) is not None:  # noqa: FBT003 - rclpy's signature
                price = decode_price(taken[0].data)
                admitted = price.share_per_weight * price.capacity_bytes_per_second
                prices.append((taken[1]["received_timestamp"] * 1e-9, admitted))
        self._node.destroy_subscription(self._subscription)
        return prices


class Taker:
    """Takes samples, and keeps their ages at reception by DDS, which notes the time."""

    def __init__(self, readers: Sequence[Any]) -> None:
        self._readers = readers
        self._ages_s: list[float] = []
        self.received = 0

    def take(self) -> None:
        """Take all that has arrived."""
        for reader in self._readers:
            for sample, about in taken(reader):
                sent_ns = int(sample[_HEAD : _HEAD + _DIGITS])
                self._ages_s.append((about["received_timestamp"] - sent_ns) * 1e-9)
                self.received += 1

    def report(self) -> dict[str, Any]:
        """Return the ages since the last report (s), and the number of samples so far."""
        self.take()
        ages_s, self._ages_s = sorted(self._ages_s), []
        return {"received": self.received, "ages_s": ages_s}


@dataclass(slots=True)
class Node:
    """What the parent asks of a process.

    Parameters
    ----------
    readers : subscriptions to the topics from the other host
    taker : takes from them; None = nothing does
    """

    node: Any
    sources: Sources
    readers: Sequence[Any]
    taker: Taker | None = None
    watch: PriceWatch | None = None

    def work(self) -> None:
        """Obey the parent until it is gone."""
        orders = commands()
        answer(open=True)
        while True:
            wait_s = self.sources.publish_due()
            if self.taker:
                self.taker.take()
                wait_s = _TAKE_S if wait_s is None else min(wait_s, _TAKE_S)
            try:
                order = orders.get(timeout=wait_s)
            except queue.Empty:
                continue
            if order is None:
                return
            answer(**self._obey(order))

    def _obey(self, order: dict[str, Any]) -> dict[str, Any]:
        match order:
            case {"publish": True}:
                self.sources.begin()
            case {"publish": False}:
                self.sources.end()
            case {"matched": True}:
                return {"matched": sum(reader.get_publisher_count() > 0 for reader in self.readers)}
            case {"ages": True} if self.taker:
                return self.taker.report()
            case {"watch": True}:
                self.watch = PriceWatch(self.node)
                return {"watching": True}
            case {"watch": False} if self.watch:
                prices, self.watch = self.watch.end(), None
                return {"prices": prices}
        return self.sources.account()


def main() -> None:
    role, case = sys.argv[1], case_of(int(sys.argv[2]))
    node = plain_node(role)  # nothing spins it: DDS acknowledges what arrives, and nothing takes it
    qos = QoSProfile(depth=_DEPTH)
    received = case.commands if role == "source" else case.sensing
    depth = _TAKER_DEPTH if role == "taker" else _DEPTH
    readers = raw_readers(node, [topic.link_name for topic in received], depth)
    if role == "source":
        publishers = [node.create_publisher(String, topic.name, qos) for topic in case.sensing]
        Node(node, Sources(case.sensing, publishers), readers).work()
        return
    with ExitStack() as stack:
        publishers = []
        if case.commands:
            planner = rclpy.create_node("planner")
            publishers = [AdaptivePublisher(planner, String, topic.link_name, qos) for topic in case.commands]
            executor = SingleThreadedExecutor()
            executor.add_node(planner)
            stack.enter_context(spinning(executor))
        Node(node, Sources(case.commands, publishers), readers, Taker(readers) if role == "taker" else None).work()


if __name__ == "__main__":
    main()
