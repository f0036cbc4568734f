"""The processes of the paper's robot under arpd: the same sensors, planner and actuator, but arpd sets rate and QoS.

Usage: python -m scripts.bench.paper_live_nodes sensors|planner|actuator [NUMBER]

All publishers are AdaptivePublishers. Readers keep more than any writer and request no deadline, so arpd alone decides.
The sensors warm up until the parent says `measure`. The measured time then begins without a waiting sample, so that all
samples of that time are either withheld by pacing, or sent and counted.
"""

from __future__ import annotations

import sys
import time
from array import array
from typing import TYPE_CHECKING, Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.adapters.ros.runtime import spinning as in_background
from scripts.bench.child import answer, commands, sample_of
from scripts.bench.node import becomes_true, plain_node
from scripts.bench.paper_cells import SENSORS, command_number
from scripts.bench.paper_nodes import (
    Arrivals,
    Sensor,
    actuation,
    answer_matched,
    kept,
    next_order,
    publish_all,
    sensing,
    spin,
    spinning,
    taking,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from scripts.bench.paper_nodes import Orders

_OWN_DEPTH = 10  # of the application, until arpd sets another
_COMMAND_DEPTH = 500  # the same; lost commands count from the start, where the link is still overfull
_READER_DEPTH = 5000
_SLICE_S = 0.25
_EMPTY_S, _CALM_S = 5.0, 0.05


class PacedSensor(Sensor):
    """A sensor whose publisher arpd paces."""

    def __init__(self, node: Any, order: dict[str, Any], index: int) -> None:
        super().__init__(AdaptivePublisher(node, String, sensing(order, index), _OWN_DEPTH), order, index)
        self.first = self.sent_before = 0

    def publish(self, payload_bytes: int) -> None:
        """Offer the next sample."""
        sample = sample_of(len(self.left_ns), payload_bytes)
        self.left_ns.append(time.time_ns())
        self.publisher.publish(sample)

    def sent(self) -> int:
        """Wait until no sample waits, and return the number of those that have left."""

        def is_empty() -> bool:
            if self._state().queued:
                return False
            time.sleep(_CALM_S)  # the last one may be on its way into the writer
            return not self._state().queued

        becomes_true(is_empty, _EMPTY_S, poll_s=0.005)
        return int(self._state().published)

    def begin(self) -> None:
        """Begin the measured time."""
        self.sent_before, self.first = self.sent(), len(self.left_ns)

    def result(self, order: dict[str, Any]) -> dict[str, Any]:
        """Return the files of the sensor, its first measured sample, and the number of those sent since."""
        sent = self.sent() - self.sent_before
        left = kept(self.left_ns, order, f"left-{self.index}")
        return {"index": self.index, "left": left, "first": self.first, "sent": sent}

    def _state(self) -> Any:
        return self.publisher.state()


def sense(orders: Orders, name: str) -> None:
    """Serve one turn: make publishers, wait for their readers, publish until the measured time is over, and report."""
    order, node, executor = next_order(orders), plain_node(name), SingleThreadedExecutor()
    executor.add_node(node)
    # Not EventsExecutor: rclpy 7.1 hangs when a thread makes a publisher while another one spins it.
    with in_background(executor):
        sensors = [PacedSensor(node, order, index) for index in order["indices"]]
        answer_matched(lambda: all(sensor.publisher.get_subscription_count() > 0 for sensor in sensors))
        start_ns = next_order(orders)["start_ns"]
        while orders.empty():
            publish_all(sensors, {**order, "seconds": _SLICE_S}, start_ns)
            start_ns = time.time_ns()
        next_order(orders)
        for sensor in sensors:
            sensor.begin()
        answer(began=True)
        spent = publish_all(sensors, order, time.time_ns())
        answer(sensors=[sensor.result(order) for sensor in sensors], spent=spent)
        next_order(orders)


def plan(orders: Orders) -> None:
    """Serve one turn: read every sensor, and answer at the rate of one, each sensor in its turn.

    Pacing leaves out samples, so a command answers every eleventh sample that arrives from each sensor.
    """
    order = next_order(orders)
    with spinning("planner") as (node, executor):
        arrivals = [Arrivals() for _ in range(SENSORS)]
        commanded = AdaptivePublisher(node, String, actuation(order), _COMMAND_DEPTH)
        answered = array("q")

        def reader(index: int) -> Callable[[bytes, dict[str, int]], None]:
            note, numbers = arrivals[index].on_sample, arrivals[index].numbers

            def on_sample(sample: bytes, info: dict[str, int]) -> None:
                note(sample, info)
                if len(numbers) % SENSORS == index:
                    answered.append(command_number(index, numbers[-1]))
                    commanded.publish(sample_of(answered[-1], order["payload_bytes"]))

            return on_sample

        subscriptions = [_reader(node, sensing(order, index), reader(index)) for index in range(SENSORS)]
        answer_matched(
            lambda: all(s.get_publisher_count() > 0 for s in subscriptions) and commanded.get_subscription_count() > 0
        )
        spent = spin(orders, executor, lambda: (sum(len(each.numbers) for each in arrivals), len(answered)))
        answer(
            arrived=[each.kept(order, f"arrived-{index}") for index, each in enumerate(arrivals)],
            sent=commanded.state().published,
            spent=spent,
        )
        next_order(orders)


def act(orders: Orders) -> None:
    """Serve one turn: note the arrivals of the commands."""
    order = next_order(orders)
    with spinning("actuator") as (node, executor):
        arrivals = Arrivals()
        subscription = _reader(node, actuation(order), arrivals.on_sample)
        answer_matched(lambda: subscription.get_publisher_count() > 0)
        spin(orders, executor, lambda: (len(arrivals.numbers), 0))
        answer(**arrivals.kept(order, "actuated"))
        next_order(orders)


def _reader(node: Any, topic: str, on_sample: Callable[[bytes, dict[str, int]], None]) -> Any:
    return node.create_subscription(String, topic, taking(on_sample), QoSProfile(depth=_READER_DEPTH), raw=True)


def main() -> None:
    if sys.argv[1] == "sensors":
        sense(commands(), f"sensors_{sys.argv[2]}")
    else:
        {"planner": plan, "actuator": act}[sys.argv[1]](commands())


if __name__ == "__main__":
    main()
