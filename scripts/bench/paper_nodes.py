"""The processes of the paper's experiment: sensors and actuator on the robot, the planner on the CEDDP.

Usage: python -m scripts.bench.paper_nodes sensors|planner|actuator [NUMBER]

Plain rclpy publishers and subscriptions with the QoS under test on both ends, as in the paper. Every process writes
the times of its samples to files of its own and computes nothing while it runs. A turn is one order on stdin, the
start when all are matched, and `close`.
"""

from __future__ import annotations

import contextlib
import inspect
import sys
import time
from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.duration import Duration
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSLivelinessPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import String

from scripts.bench.child import answer, commands, number_of, sample_of
from scripts.bench.node import becomes_true, plain_node

if TYPE_CHECKING:
    import queue
    from collections.abc import Callable, Iterator, Sequence

    Orders = queue.SimpleQueue[dict[str, Any] | None]

_MATCH_TIMEOUT_S = 30.0
_POLL_S = 0.01
_SPIN_S = 0.05


def sensing(order: dict[str, Any], index: int) -> str:
    """Return the topic of a sensor; each turn has its own, so that a reader of the last turn receives nothing."""
    return f"/turn_{order['turn']}/sensor_{index}"


def actuation(order: dict[str, Any]) -> str:
    """Return the topic of the commands."""
    return f"/turn_{order['turn']}/actuation"


def profile(order: dict[str, Any]) -> QoSProfile:
    """Return the paper's QoS: RELIABLE, KEEP_LAST, VOLATILE, AUTOMATIC, and the two policies under test."""
    return QoSProfile(
        reliability=QoSReliabilityPolicy.RELIABLE,
        history=QoSHistoryPolicy.KEEP_LAST,
        durability=QoSDurabilityPolicy.VOLATILE,
        liveliness=QoSLivelinessPolicy.AUTOMATIC,
        depth=order["depth"],
        deadline=Duration(nanoseconds=round(1e9 / order["deadline_hz"])),
    )


def _schedule() -> tuple[int, int]:
    cpu_ns, wait_ns, _ = Path("/proc/thread-self/schedstat").read_text(encoding="ascii").split()
    return int(cpu_ns), int(wait_ns)


@dataclass(frozen=True, kw_only=True, slots=True)
class Effort:
    """Time of this thread on a core and waiting for one, since its start (ns).

    In the rest of the time the thread slept: on purpose, or blocked in a call.
    """

    at: tuple[int, int] = field(default_factory=_schedule)
    process_at_s: float = field(default_factory=time.process_time)

    def seconds(self) -> dict[str, float]:
        """Return CPU time and the wait for a core, and the CPU time of all threads of the process (s)."""
        cpu_ns, wait_ns = _schedule()
        return {
            "cpu_s": (cpu_ns - self.at[0]) / 1e9,
            "core_wait_s": (wait_ns - self.at[1]) / 1e9,
            "process_cpu_s": time.process_time() - self.process_at_s,
        }


class Sensor:
    """A publisher at its own rate; the phases of all sensors are spread over the period."""

    def __init__(self, publisher: Any, order: dict[str, Any], index: int) -> None:
        self.publisher = publisher
        self.index = index
        self.period_ns = round(1e9 / order["deadline_hz"])
        self.phase_ns = self.period_ns * index // order["sensors"]
        self.due_ns = 0
        self.left_ns = array("q")  # time of each call of publish()

    def publish(self, payload_bytes: int) -> None:
        """Publish the next sample."""
        handle = self.publisher.handle
        sample = sample_of(len(self.left_ns), payload_bytes)
        self.left_ns.append(time.time_ns())
        with handle:
            handle.publish_raw(sample)


def publish_all(sensors: Sequence[Sensor], order: dict[str, Any], start_ns: int) -> dict[str, float]:
    """Publish at every sensor's rate until the time is over; return how the time was spent (s).

    A late sample goes at once and the next keeps its own time, so a short delay is caught up. Samples that do not fit
    into the time are not published.
    """
    until_ns = start_ns + round(order["seconds"] * 1e9)
    for sensor in sensors:
        sensor.due_ns = start_ns + sensor.phase_ns
    time.sleep(max(0.0, (start_ns - time.time_ns()) / 1e9))
    effort, began_ns, publish_ns = Effort(), time.time_ns(), 0
    while True:
        sensor = min(sensors, key=lambda each: each.due_ns)
        if sensor.due_ns >= until_ns or (now_ns := time.time_ns()) >= until_ns:
            break
        if now_ns < sensor.due_ns:
            time.sleep((sensor.due_ns - now_ns) / 1e9)
        sensor.publish(order["payload_bytes"])
        publish_ns += time.time_ns() - sensor.left_ns[-1]
        sensor.due_ns += sensor.period_ns
    return {**effort.seconds(), "wall_s": (time.time_ns() - began_ns) / 1e9, "publish_s": publish_ns / 1e9}


def sense(orders: Orders, node: Any) -> None:
    """Serve turns: make publishers, wait for their reader, publish, report the samples."""
    while order := next_order(orders):
        sensors = [
            Sensor(node.create_publisher(String, sensing(order, index), profile(order)), order, index)
            for index in order["indices"]
        ]
        answer_matched(lambda: all(s.publisher.get_subscription_count() > 0 for s in sensors))  # noqa: B023
        spent = publish_all(sensors, order, next_order(orders)["start_ns"])
        answer(
            sensors=[{"index": s.index, "left": kept(s.left_ns, order, f"left-{s.index}")} for s in sensors],
            spent=spent,
        )
        next_order(orders)  # samples under way have arrived or are lost
        for sensor in sensors:
            node.destroy_publisher(sensor.publisher)
        answer(closed=True)


class Arrivals:
    """The arrivals on one topic: numbers, and the times at which the DDS thread received them."""

    def __init__(self) -> None:
        self.numbers, self.received_ns = array("q"), array("q")

    def on_sample(self, sample: bytes, info: dict[str, int]) -> None:
        """Note a sample."""
        self.numbers.append(number_of(sample))
        self.received_ns.append(info["received_timestamp"])

    def kept(self, order: dict[str, Any], name: str) -> dict[str, str]:
        """Write both into files and return the paths."""
        return {
            "numbers": kept(self.numbers, order, f"{name}-numbers"),
            "received": kept(self.received_ns, order, f"{name}-received"),
        }


def plan(orders: Orders) -> None:
    """Serve turns: read every sensor, and answer at the rate of one, each sensor in its turn.

    A command answers sample n of the sensor n mod 11 with its number, so commands cover all sensors at the rate of one.
    """
    while order := next_order(orders):
        with spinning("planner") as (node, executor):
            _plan_once(orders, order, node, executor)
        answer(closed=True)


def _plan_once(orders: Orders, order: dict[str, Any], node: Any, executor: Any) -> None:
    qos, sensors, payload_bytes = profile(order), order["sensors"], order["payload_bytes"]
    arrivals = [Arrivals() for _ in range(sensors)]
    commanded = node.create_publisher(String, actuation(order), qos)
    commands_sent = array("q")

    def reader(index: int) -> Callable[[bytes, dict[str, int]], None]:
        note, numbers = arrivals[index].on_sample, arrivals[index].numbers

        def on_sample(sample: bytes, info: dict[str, int]) -> None:
            note(sample, info)
            if numbers[-1] % sensors == index:
                with commanded.handle:
                    commanded.handle.publish_raw(sample_of(numbers[-1], payload_bytes))
                commands_sent.append(numbers[-1])

        return on_sample

    subscriptions = [
        node.create_subscription(String, sensing(order, index), taking(reader(index)), qos, raw=True)
        for index in range(sensors)
    ]
    answer_matched(
        lambda: all(s.get_publisher_count() > 0 for s in subscriptions) and commanded.get_subscription_count() > 0
    )
    spent = spin(orders, executor, lambda: (sum(len(each.numbers) for each in arrivals), len(commands_sent)))
    answer(
        arrived=[each.kept(order, f"arrived-{index}") for index, each in enumerate(arrivals)],
        commands=kept(commands_sent, order, "commands"),
        spent=spent,
    )
    next_order(orders)


def act(orders: Orders) -> None:
    """Serve turns: note the arrivals of the commands."""
    while order := next_order(orders):
        with spinning("actuator") as (node, executor):
            _act_once(orders, order, node, executor)
        answer(closed=True)


def _act_once(orders: Orders, order: dict[str, Any], node: Any, executor: Any) -> None:
    arrivals = Arrivals()
    subscription = node.create_subscription(
        String, actuation(order), taking(arrivals.on_sample), profile(order), raw=True
    )
    answer_matched(lambda: subscription.get_publisher_count() > 0)
    spin(orders, executor, lambda: (len(arrivals.numbers), 0))
    answer(**arrivals.kept(order, "actuated"))
    next_order(orders)


def spin(orders: Orders, executor: Any, counts: Callable[[], tuple[int, int]]) -> dict[str, float]:
    """Spin until the parent says stop, answer its questions, and return how the time of the load was spent (s).

    The parent asks for the first time when the load is over.
    """
    effort, began_s, spent = Effort(), time.monotonic(), dict[str, float]()
    while True:
        while orders.empty():
            executor.spin_once(timeout_sec=_SPIN_S)
        spent = spent or {**effort.seconds(), "wall_s": time.monotonic() - began_s}
        if "stop" in next_order(orders):
            return spent
        arrived, answered = counts()
        answer(arrived=arrived, answered=answered)


@contextlib.contextmanager
def spinning(name: str) -> Iterator[tuple[Any, Any]]:
    """Yield a node and its executor for one turn: rclpy 7.1's EventsExecutor fails when subscriptions are removed."""
    context = rclpy.Context()
    rclpy.init(context=context, signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node(name, context=context)
    executor = EventsExecutor(context=context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.shutdown()
        node.destroy_node()
        context.shutdown()


def taking(callback: Callable[[bytes, dict[str, int]], None]) -> Callable[..., None]:
    """Return a callback for sample and info; the EventsExecutor of rclpy 7.1 passes both as one tuple."""

    def on_message(both: tuple[bytes, dict[str, int]]) -> None:
        callback(*both)

    on_message.__signature__ = inspect.signature(lambda _sample, _info: None)  # type: ignore[attr-defined]
    return on_message


def next_order(orders: Orders) -> dict[str, Any]:
    """Return the parent's next command; end when the parent is gone."""
    if (command := orders.get()) is None:
        raise SystemExit
    return command


def answer_matched(is_matched: Callable[[], bool]) -> None:
    answer(matched=becomes_true(is_matched, _MATCH_TIMEOUT_S, poll_s=_POLL_S))


def kept(values: array[int], order: dict[str, Any], name: str) -> str:
    path = Path(order["folder"]) / f"{name}.i64"
    path.write_bytes(values.tobytes())
    return str(path)


def main() -> None:
    if sys.argv[1] == "sensors":
        sense(commands(), plain_node(f"sensors_{sys.argv[2]}"))
    else:
        {"planner": plan, "actuator": act}[sys.argv[1]](commands())


if __name__ == "__main__":
    main()
