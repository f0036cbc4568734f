"""The planner on the base computer: it reads every sensor topic and sends commands back.

Usage: python -m scripts.robot.planner PREFIX plain|adaptive OUT.json

It prints one JSON line a second with the arrivals, for the live table. It obeys the same signals as the sensors.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import TwistStamped
from rclpy.node import Node

from arpd import AdaptivePublisher
from arpd.sim.demo import COMMAND_TOPIC
from scripts.robot.process import RCLPY_DEPTH, command_line, live, reading
from scripts.robot.sensors import COMMAND_RATE_HZ, SENSORS
from scripts.robot.stamped import StampedArrivals

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.qos import QoSProfile


class Planner(Node):
    """Subscribes to all sensors and publishes commands at a fixed rate."""

    def __init__(self, prefix: str, *, is_adaptive: bool) -> None:
        super().__init__("planner")
        self.arrivals = {topic: StampedArrivals() for topic in SENSORS}
        self.offered = 0
        self.is_publishing = False
        for topic, (rate_hz, make) in SENSORS.items():
            self._read(type(make()), prefix + topic, self.arrivals[topic].on_sample, reading(rate_hz))
        self.commands: Any
        if is_adaptive:
            self.commands = AdaptivePublisher(self, TwistStamped, COMMAND_TOPIC, RCLPY_DEPTH)
        else:
            self.commands = self.create_publisher(TwistStamped, COMMAND_TOPIC, RCLPY_DEPTH)
        self.create_timer(1.0 / COMMAND_RATE_HZ, self._command)
        self.create_timer(1.0, self._report)

    def _read(self, kind: Any, topic: str, arrived: Callable[..., None], qos: QoSProfile) -> None:
        """Subscribe, and take all samples that wait at once.

        A turn of the executor takes one sample of each topic: a planner that is short of CPU would fall behind on /imu.
        """

        def on_sample(sample: bytes, info: dict[str, int]) -> None:
            taken: tuple[bytes, dict[str, int]] | None = (sample, info)
            while taken is not None:
                arrived(*taken)
                with subscription.handle:
                    taken = subscription.handle.take_message(kind, True)  # noqa: FBT003 - rclpy's "raw"

        subscription = self.create_subscription(kind, topic, on_sample, qos, raw=True)

    def _command(self) -> None:
        if not self.is_publishing:
            return
        command = TwistStamped()
        command.header.stamp = self.get_clock().now().to_msg()
        command.header.frame_id = f"base#{self.offered}"
        self.offered += 1
        self.commands.publish(command)

    def _report(self) -> None:
        recent = {topic: arrivals.take_recent() for topic, arrivals in self.arrivals.items()}
        print(json.dumps({topic: {"rate_hz": n, "worst_s": worst} for topic, (n, worst) in recent.items()}), flush=True)

    def result(self, began_s: float, ended_s: float) -> dict[str, Any]:
        for arrivals in self.arrivals.values():
            arrivals.sample_ages(began_s, ended_s)
        received = {topic: asdict(arrivals.reception()) for topic, arrivals in self.arrivals.items()}
        numbers = {topic: arrivals.number for topic, arrivals in self.arrivals.items()}
        offered = {COMMAND_TOPIC: self.offered}
        return {"offered": offered, "received": received, "numbers": numbers}


def main() -> None:
    order = command_line("prefix", "kind", "out")
    prefix = order.prefix if order.prefix != "-" else ""
    live(lambda: Planner(prefix, is_adaptive=order.kind == "adaptive"), order.out)


if __name__ == "__main__":
    main()
