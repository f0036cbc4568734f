"""The processes around arpd in `overhead.py`: one that has all sources, one that reads everything and sends commands.

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
from std_msgs.msg import Float64, String

from arpd import AdaptivePublisher
from arpd.adapters.ros.names import GATE_TOPIC
from arpd.adapters.ros.runtime import spinning
from scripts.bench.child import commands, sample_of, say
from scripts.bench.overhead_cases import Topic, case_of

if TYPE_CHECKING:
    from collections.abc import Sequence

_DEPTH = 10  # what every rclpy tutorial passes
_MOST_GATES = 5000


class Sources:
    """Publishes every topic at its rate, their samples spread over time.

    Parameters
    ----------
    topics, publishers : what is published, and by what
    """

    def __init__(self, topics: Sequence[Topic], publishers: Sequence[Any]) -> None:
        self._topics = topics
        self._publishers = publishers
        self._samples = [sample_of(0, topic.text_bytes) for topic in topics]
        self._due: list[tuple[float, int]] = []
        self._began_s = 0.0
        self.sent = 0

    def begin(self) -> None:
        """Publish from now on."""
        self._began_s = time.monotonic()
        count = len(self._topics)
        self._due = [(self._began_s + k / count / topic.rate_hz, k) for k, topic in enumerate(self._topics)]
        heapq.heapify(self._due)

    def end(self) -> None:
        """Publish no more."""
        self._due = []

    def account(self) -> dict[str, float]:
        """Return how many samples were published so far, and how many should have been (by their rates)."""
        spent_s = time.monotonic() - self._began_s if self._due else 0.0
        return {"sent": self.sent, "expected": sum(topic.rate_hz for topic in self._topics) * spent_s}

    def publish_due(self) -> float | None:
        """Publish what is due; return how long until the next is (s), None when there is nothing to publish."""
        if not self._due:
            return None
        while (now_s := time.monotonic()) >= self._due[0][0]:
            due_s, k = self._due[0]
            heapq.heapreplace(self._due, (due_s + 1.0 / self._topics[k].rate_hz, k))
            self._publishers[k].publish(self._samples[k])
            self.sent += 1
        return self._due[0][0] - now_s


class GateWatch:
    """Hears the gate from its making until it is asked: DDS notes when each message came, however late it is taken."""

    def __init__(self, node: Any) -> None:
        self._node = node
        qos = QoSProfile(depth=_MOST_GATES, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self._subscription = node.create_subscription(Float64, GATE_TOPIC, lambda _gate: None, qos)

    def end(self) -> list[tuple[float, float]]:
        """Return when each gate came (Unix time, s) and its value."""
        gates = []
        handle = self._subscription.handle
        with handle:
            while (taken := handle.take_message(Float64, False)) is not None:  # noqa: FBT003 - rclpy's own signature
                gates.append((taken[1]["received_timestamp"] * 1e-9, taken[0].data))
        self._node.destroy_subscription(self._subscription)
        return gates


def work(sources: Sources, node: Any) -> None:
    """Do as the parent says until it is gone."""
    told = commands()
    watch: GateWatch | None = None
    say(open=True)
    while True:
        try:
            order = told.get(timeout=sources.publish_due())
        except queue.Empty:
            continue
        match order:
            case None:
                return
            case {"publish": True}:
                sources.begin()
                say(**sources.account())
            case {"publish": False}:
                sources.end()
                say(**sources.account())
            case {"watch": True}:
                watch = GateWatch(node)
                say(watching=True)
            case {"watch": False} if watch is not None:
                say(gates=watch.end())
                watch = None
            case _:
                say(**sources.account())


def main() -> None:
    role, case = sys.argv[1], case_of(int(sys.argv[2]))
    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node(role)  # nobody spins it: what is received is acknowledged, and never taken
    qos = QoSProfile(depth=_DEPTH)
    if role == "source":
        for topic in case.commands:
            node.create_subscription(String, topic.link_name, lambda _sample: None, qos, raw=True)
        work(Sources(case.sensing, [node.create_publisher(String, topic.name, qos) for topic in case.sensing]), node)
        return
    for topic in case.sensing:
        node.create_subscription(String, topic.link_name, lambda _sample: None, qos, raw=True)
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
