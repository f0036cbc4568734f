"""The processes of the paper's experiment: sensors and actuator on the robot, the planner on the CEDDP.

Usage: python -m scripts.bench.paper_nodes sensors|planner|actuator [NUMBER]

Plain rclpy publishers and subscriptions with the QoS under test on both ends, as the paper sets it. Every process
keeps when each of its samples left or arrived in a file of its own; nothing is computed while it runs. A turn is one
order on stdin, `go` when all are matched, and `close`.
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

from scripts.bench.child import commands, number_of, sample_of, say

if TYPE_CHECKING:
    import queue
    from collections.abc import Callable, Iterator, Sequence

    Told = queue.SimpleQueue[dict[str, Any] | None]

_MATCH_TIMEOUT_S = 30.0
_POLL_S = 0.01
_SPIN_S = 0.05


def sensing(order: dict[str, Any], index: int) -> str:
    """Name the topic of a sensor; each turn has its own, so that a reader of the last one gets nothing more."""
    return f"/turn_{order['turn']}/sensor_{index}"


def actuation(order: dict[str, Any]) -> str:
    """Name the topic of the commands."""
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
    """What the scheduler gave this thread since it began: on a core, and waiting for one (ns).

    Whatever else passes, the thread slept: by its own will, or blocked in a call.
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
    """A publisher at its own rate; the phases of all sensors are spread over the period.

    Parameters
    ----------
    node : of which the publisher is
    order : the turn
    index : which of the sensors it is
    """

    def __init__(self, node: Any, order: dict[str, Any], index: int) -> None:
        self.publisher = node.create_publisher(String, sensing(order, index), profile(order))
        self.index = index
        self.period_ns = round(1e9 / order["deadline_hz"])
        self.phase_ns = self.period_ns * index // order["sensors"]
        self.due_ns = 0
        self.left_ns = array("q")  # when each sample was given to publish()

    def publish(self, payload_bytes: int) -> None:
        """Publish the next sample."""
        handle = self.publisher.handle
        sample = sample_of(len(self.left_ns), payload_bytes)
        self.left_ns.append(time.time_ns())
        with handle:
            handle.publish_raw(sample)


def publish_all(sensors: Sequence[Sensor], order: dict[str, Any], start_ns: int) -> dict[str, float]:
    """Publish at every sensor's rate until the time is over, and return what time went into (s).

    A sample that is late goes at once and the next keeps its own time, so a short delay is caught up; what does not fit
    into the time is not published.
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


def sense(told: Told, node: Any) -> None:
    """Serve turns: make publishers, wait for their reader, publish, say what left."""
    while order := _heard(told):
        sensors = [Sensor(node, order, index) for index in order["indices"]]
        say(matched=_await(lambda: all(s.publisher.get_subscription_count() > 0 for s in sensors)))  # noqa: B023
        spent = publish_all(sensors, order, _heard(told)["start_ns"])
        say(
            sensors=[{"index": s.index, "left": _kept(s.left_ns, order, f"left-{s.index}")} for s in sensors],
            spent=spent,
        )
        _heard(told)  # what is under way has arrived, or never will
        for sensor in sensors:
            node.destroy_publisher(sensor.publisher)
        say(closed=True)


class Arrivals:
    """What arrives on one topic: numbers, and when the DDS thread received each."""

    def __init__(self) -> None:
        self.numbers, self.received_ns = array("q"), array("q")

    def on_sample(self, sample: bytes, info: dict[str, int]) -> None:
        """Note a sample."""
        self.numbers.append(number_of(sample))
        self.received_ns.append(info["received_timestamp"])

    def kept(self, order: dict[str, Any], name: str) -> dict[str, str]:
        """Put all into files and return their paths."""
        return {
            "numbers": _kept(self.numbers, order, f"{name}-numbers"),
            "received": _kept(self.received_ns, order, f"{name}-received"),
        }


def plan(told: Told) -> None:
    """Serve turns: read every sensor, and answer at the rate of one, each sensor in its turn.

    Sample n of the sensor n mod 11 is answered, with its number, so commands tell of all sensors and have their rate.
    """
    while order := _heard(told):
        with spinning("planner") as (node, executor):
            _plan_once(told, order, node, executor)
        say(closed=True)


def _plan_once(told: Told, order: dict[str, Any], node: Any, executor: Any) -> None:
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
        node.create_subscription(String, sensing(order, index), _taking(reader(index)), qos, raw=True)
        for index in range(sensors)
    ]
    say(
        matched=_await(
            lambda: all(s.get_publisher_count() > 0 for s in subscriptions) and commanded.get_subscription_count() > 0
        )
    )
    spent = _spin(told, executor, lambda: (sum(len(each.numbers) for each in arrivals), len(commands_sent)))
    say(
        arrived=[each.kept(order, f"arrived-{index}") for index, each in enumerate(arrivals)],
        commands=_kept(commands_sent, order, "commands"),
        spent=spent,
    )
    _heard(told)


def act(told: Told) -> None:
    """Serve turns: note how the commands arrive."""
    while order := _heard(told):
        with spinning("actuator") as (node, executor):
            _act_once(told, order, node, executor)
        say(closed=True)


def _act_once(told: Told, order: dict[str, Any], node: Any, executor: Any) -> None:
    arrivals = Arrivals()
    subscription = node.create_subscription(
        String, actuation(order), _taking(arrivals.on_sample), profile(order), raw=True
    )
    say(matched=_await(lambda: subscription.get_publisher_count() > 0))
    _spin(told, executor, lambda: (len(arrivals.numbers), 0))
    say(**arrivals.kept(order, "actuated"))
    _heard(told)


def _spin(told: Told, executor: Any, counts: Callable[[], tuple[int, int]]) -> dict[str, float]:
    """Work until told to stop, answer what has arrived when asked, and return what the load's time went into (s).

    The parent asks for the first time when the load is over.
    """
    effort, began_s, spent = Effort(), time.monotonic(), dict[str, float]()
    while True:
        while told.empty():
            executor.spin_once(timeout_sec=_SPIN_S)
        spent = spent or {**effort.seconds(), "wall_s": time.monotonic() - began_s}
        if "stop" in _heard(told):
            return spent
        arrived, answered = counts()
        say(arrived=arrived, answered=answered)


@contextlib.contextmanager
def spinning(name: str) -> Iterator[tuple[Any, Any]]:
    """Lend a node and its executor for one turn: EventsExecutor of rclpy 7.1 does not survive subscriptions that go."""
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


def _taking(callback: Callable[[bytes, dict[str, int]], None]) -> Callable[..., None]:
    """Return a callback for sample and info; the EventsExecutor of rclpy 7.1 hands both over as one tuple."""

    def on_message(both: tuple[bytes, dict[str, int]]) -> None:
        callback(*both)

    on_message.__signature__ = inspect.signature(lambda _sample, _info: None)  # type: ignore[attr-defined]
    return on_message


def _heard(told: Told) -> dict[str, Any]:
    """Return what the parent says next, and end with it."""
    if (said := told.get()) is None:
        raise SystemExit
    return said


def _await(is_so: Callable[[], bool]) -> bool:
    until_s = time.monotonic() + _MATCH_TIMEOUT_S
    while not is_so():
        if time.monotonic() > until_s:
            return False
        time.sleep(_POLL_S)
    return True


def _kept(values: array[int], order: dict[str, Any], name: str) -> str:
    path = Path(order["folder"]) / f"{name}.i64"
    path.write_bytes(values.tobytes())
    return str(path)


def main() -> None:
    if sys.argv[1] == "sensors":
        rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
        sense(commands(), rclpy.create_node(f"sensors_{sys.argv[2]}"))
    else:
        {"planner": plan, "actuator": act}[sys.argv[1]](commands())


if __name__ == "__main__":
    main()
