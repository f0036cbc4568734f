"""The robot's sensors: ordinary rclpy nodes without arpd.

Usage: python -m scripts.robot.sensors TOPIC|base_driver OUT.json

Each is a process of its own, as a robot's drivers are: their send buffers fill the link's queue. On SIGUSR1 they start
to publish, on SIGUSR2 they stop, on SIGTERM they write the number of samples they published and end.
"""

from __future__ import annotations

import array
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import (
    BatteryState,
    CompressedImage,
    Imu,
    JointState,
    LaserScan,
    NavSatFix,
    PointCloud2,
    PointField,
    Range,
    Temperature,
)

from arpd.sim.demo import COMMAND_TOPIC, demo_topics
from scripts.robot.process import RCLPY_DEPTH, DemoNode, command_line, live, reading
from scripts.robot.stamped import StampedArrivals

if TYPE_CHECKING:
    from collections.abc import Callable


def laser_scan() -> LaserScan:
    scan = LaserScan(angle_min=-3.14, angle_max=3.14, angle_increment=6.28 / 720, range_max=30.0)
    scan.ranges = array.array("f", [1.5] * 720)
    scan.intensities = array.array("f", [100.0] * 720)
    return scan


def point_cloud() -> PointCloud2:
    names = ("x", "y", "z", "intensity")
    fields = [PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1) for i, name in enumerate(names)]
    return PointCloud2(
        height=1, width=1024, fields=fields, point_step=16, row_step=16384, data=array.array("B", bytes(16384))
    )


def image() -> CompressedImage:
    return CompressedImage(format="jpeg", data=array.array("B", bytes(30_000)))


def joint_state() -> JointState:
    return JointState(
        name=[f"joint_{i}" for i in range(12)], position=[0.1] * 12, velocity=[0.1] * 12, effort=[0.1] * 12
    )


_RATES_HZ = {topic.name: topic.rate_hz for topic in demo_topics()}
_MESSAGES: dict[str, Callable[[], Any]] = {
    "/scan/front": laser_scan,
    "/scan/rear": laser_scan,
    "/camera/image/compressed": image,
    "/points": point_cloud,
    "/imu": Imu,
    "/odom": Odometry,
    "/joint_states": joint_state,
    "/range/front": Range,
    "/gps/fix": NavSatFix,
    "/temperature": Temperature,
    "/battery": BatteryState,
}
# topic → (rate in Hz, message with its realistic size)
SENSORS = {topic: (_RATES_HZ[topic], make) for topic, make in _MESSAGES.items()}
COMMAND_RATE_HZ = _RATES_HZ[COMMAND_TOPIC]
BASE_DRIVER = "base_driver"


def node_name(topic: str) -> str:
    return topic.strip("/").replace("/", "_")


class Sensor(Node):
    """One sensor: a timer and a publisher."""

    def __init__(self, topic: str, rate_hz: float, message: Any) -> None:
        super().__init__(node_name(topic))
        self._message = message
        self._frame = node_name(topic)
        self.topic = topic
        self.offered = 0
        self.is_publishing = False
        self._publisher = self.create_publisher(type(message), topic, RCLPY_DEPTH)
        self.create_timer(1.0 / rate_hz, self._publish)

    def _publish(self) -> None:
        if not self.is_publishing:
            return
        self._message.header.stamp = self.get_clock().now().to_msg()
        self._message.header.frame_id = f"{self._frame}#{self.offered}"
        self.offered += 1
        self._publisher.publish(self._message)

    def result(self, _began_s: float, _ended_s: float) -> dict[str, Any]:
        return {"offered": {self.topic: self.offered}}


class BaseDriver(Node):
    """Receives the command topic, and notes the arrivals of the commands."""

    def __init__(self) -> None:
        super().__init__(BASE_DRIVER)
        self.commands = StampedArrivals()
        self.is_publishing = False  # the signals set it during the measured part of the run
        qos = reading(COMMAND_RATE_HZ)
        self.create_subscription(TwistStamped, COMMAND_TOPIC, self.commands.on_sample, qos, raw=True)

    def result(self, began_s: float, ended_s: float) -> dict[str, Any]:
        self.commands.sample_ages(began_s, ended_s)
        return {
            "offered": {},
            "received": {COMMAND_TOPIC: asdict(self.commands.reception())},
            "numbers": {COMMAND_TOPIC: self.commands.number},
        }


def main() -> None:
    order = command_line("name", "out")

    def make() -> DemoNode:
        if order.name == BASE_DRIVER:
            return BaseDriver()
        rate_hz, message = SENSORS[order.name]
        return Sensor(order.name, rate_hz, message())

    live(make, order.out)


if __name__ == "__main__":
    main()
