"""The processes around arpd in `overhead.py`: one with all sources, and one that reads everything and sends commands.

Usage: python -m scripts.bench.overhead_nodes source|sink TOPICS

The parent speaks to each in lines of JSON (`scripts.bench.child`).
"""

from __future__ import annotations

import heapq
import queue
import sys
import time
from contextlib import ExitStack
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
from scripts.bench.node import plain_node, raw_readers
from scripts.bench.overhead_cases import Topic, case_of

if TYPE_CHECKING:
    from collections.abc import Sequence

_DEPTH = 10  # what every rclpy tutorial passes
_MOST_PRICES = 5000


class Sources:
    """Publishes every topic at its rate, with the samples spread over time."""

    def __init__(self, topics: Sequence[Topic], publishers: Sequence[Any]) -> None:
        self._topics = topics
        self._publishers = publishers
        self._samples = [sample_of(0, topic.text_bytes) for topic in topics]
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
            self._publishers[k].publish(self._samples[k])
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


def work(sources: Sources, node: Any) -> None:
    """Obey the parent until it is gone."""
    orders = commands()
    watch: PriceWatch | None = None
    answer(open=True)
    while True:
        try:
            order = orders.get(timeout=sources.publish_due())
        except queue.Empty:
            continue
        match order:
            case None:
                return
            case {"publish": True}:
                sources.begin()
                answer(**sources.account())
            case {"publish": False}:
                sources.end()
                answer(**sources.account())
            case {"watch": True}:
                watch = PriceWatch(node)
                answer(watching=True)
            case {"watch": False} if watch is not None:
                answer(prices=watch.end())
                watch = None
            case _:
                answer(**sources.account())


def main() -> None:
    role, case = sys.argv[1], case_of(int(sys.argv[2]))
    node = plain_node(role)  # nothing spins it: DDS acknowledges what arrives, and nothing takes it
    qos = QoSProfile(depth=_DEPTH)
    received = case.commands if role == "source" else case.sensing
    raw_readers(node, [topic.link_name for topic in received], _DEPTH)
    if role == "source":
        work(Sources(case.sensing, [node.create_publisher(String, topic.name, qos) for topic in case.sensing]), node)
        return
    with ExitStack() as stack:
        publishers = []
        if case.commands:
            planner = rclpy.create_node("planner")
            publishers = [AdaptivePublisher(planner, String, topic.link_name, qos) for topic in case.commands]
            executor = SingleThreadedExecutor()
            executor.add_node(planner)
            stack.enter_context(spinning(executor))
        work(Sources(case.commands, publishers), node)


if __name__ == "__main__":
    main()
