"""The robots of `robots.py`: their topics, and samples that say who sent them, when, and whether they are whole."""

from __future__ import annotations

import importlib
import struct
import time
from array import array
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

PACKET_BYTES = 1472  # payload of UDP in one frame
SMALL_BYTES = 10 * PACKET_BYTES
MAP_SERVER, MAP_SERVICE, MAP_BYTES = "map_server", "/map_server/map", 4_000_000
BASE = "base"  # the node of a topic that goes to the robot

_TAG = "%02x%06x%016x"  # source, number, time of publishing on the monotonic clock (ns)
_TAG_BYTES = 24
_MARK = "T" * _TAG_BYTES
_FILL = b"\x55"
_CHECKED_BYTES, _STRIDE = 4096, 512  # bytes from which every so many are checked
_ALIGNMENT = 4  # of what follows a sample in a datagram
_MODULUS = 101  # of what they say; fits in a signed byte
_NANOSECONDS = 10**9
#: Field of each type that is filled up.
_FILLED = {
    **dict.fromkeys(("Image", "PointCloud2", "OccupancyGrid", "UInt8MultiArray"), "data"),
    "LaserScan": "ranges",
    "Joy": "axes",
    "BatteryState": "cell_voltage",
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Topic:
    """One topic of a robot.

    Parameters
    ----------
    type_name : package and name of its type; one that cannot be imported becomes std_msgs/UInt8MultiArray
    size : of a serialized sample, met as nearly as its type allows (bytes)
    node : process that publishes it; BASE = on the other host
    publishers : so many of them
    kinds : first words of the samples, in turns
    """

    name: str
    type_name: str
    rate_hz: float
    size: int
    node: str
    publishers: int = 1
    is_latched: bool = False
    kinds: tuple[str, ...] = ("",)

    @property
    def group(self) -> str:
        """Class of figures to which it belongs; a small one that is of no use without its image is ``paired``."""
        if self.node == BASE:
            return "commands"
        is_paired = self.type_name == "sensor_msgs/CameraInfo"
        return "large" if self.size > SMALL_BYTES else "paired" if is_paired else "small"


def _topic(name: str, type_name: str, rate_hz: float, size: int, node: str, **more: Any) -> Topic:
    return Topic(name=name, type_name=type_name, rate_hz=rate_hz, size=size, node=node, **more)


def _image(size: int, rate_hz: float, name: str = "/image") -> Topic:
    return _topic(name, "sensor_msgs/Image", rate_hz, size, "camera")


def _imu(rate_hz: float, node: str = "imu") -> Topic:
    return _topic("/imu", "sensor_msgs/Imu", rate_hz, 324, node)


def _scan(node: str) -> Topic:
    return _topic("/scan", "sensor_msgs/LaserScan", 7.6, 8700, node)


def _telemetry(k: int) -> Topic:
    rate_hz = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)[k % 6]
    return _topic(f"/telemetry/t{k:02}", "std_msgs/String", rate_hz, 100 + 700 * k // 99, f"half{k % 2}")


_cmd = partial(_topic, "/cmd_vel", "geometry_msgs/Twist", size=52, node=BASE)
_GPS_SENTENCES = ("$GPGGA", "$GPRMC")

ROBOTS: dict[str, tuple[Topic, ...]] = {
    "camera": (_image(921_600, 10.0), _imu(200.0), _cmd(rate_hz=20.0)),
    "camera270": (_image(270_000, 30.0), _imu(100.0), _cmd(rate_hz=20.0)),
    "tb4": (
        _image(270_000, 30.0),
        _scan("lidar"),
        _imu(100.0, "create"),
        _topic("/odom", "nav_msgs/Odometry", 20.0, 720, "create"),
        # One publisher in each of two nodes; the second one's samples carry the next source.
        _topic("/tf", "tf2_msgs/TFMessage", 50.0, 120, "create"),
        _topic("/tf", "tf2_msgs/TFMessage", 50.0, 400, "lidar"),
        _topic("/battery", "sensor_msgs/BatteryState", 1.0, 120, "create"),
        _cmd(rate_hz=20.0),
    ),
    "rgbd": (
        _image(814_000, 15.0, "/depth/image"),
        _topic("/depth/camera_info", "sensor_msgs/CameraInfo", 15.0, 380, "camera"),
        _image(922_000, 15.0, "/color/image"),
        _topic("/color/camera_info", "sensor_msgs/CameraInfo", 15.0, 380, "camera"),
        _imu(200.0),
        _cmd(rate_hz=20.0),
    ),
    "outdoor": (
        _topic("/points", "sensor_msgs/PointCloud2", 10.0, 900_000, "lidar"),
        _imu(100.0),
        _topic("/fix", "sensor_msgs/NavSatFix", 5.0, 130, "gps"),
        _topic("/nmea", "std_msgs/String", 10.0, 90, "gps", kinds=_GPS_SENTENCES),
        _topic("/joy", "sensor_msgs/Joy", 30.0, 90, BASE),
        _cmd(rate_hz=30.0),
    ),
    "nav2": (
        _topic("/map", "nav_msgs/OccupancyGrid", 1.0, MAP_BYTES, MAP_SERVER, is_latched=True),
        _topic("/local_costmap", "nav_msgs/OccupancyGrid", 5.0, 14_000, "planner"),
        _topic("/plan", "nav_msgs/Path", 1.0, 60_000, "planner"),
        _scan("lidar"),
        _topic("/tf", "tf2_msgs/TFMessage", 50.0, 400, "lidar"),
        _topic("/bond", "std_msgs/String", 4.0, 110, "bond", publishers=12),
        _cmd(rate_hz=20.0),
    ),
    "telemetry": (*(_telemetry(k) for k in range(100)), _cmd(rate_hz=20.0)),
}
CALLED = {"nav2"}  # robots with a GetMap service
GROUPED = {"rgbd": ["/depth/image", "/depth/camera_info", "/color/image", "/color/camera_info"]}


def topics_of(robot: str) -> tuple[Topic, ...]:
    """Return a robot's topics; with "-small" after its name, only the small ones and the commands."""
    topics = ROBOTS[robot.removesuffix("-small")]
    return tuple(topic for topic in topics if topic.group in {"small", "commands"} or not robot.endswith("-small"))


def sources_of(robot: str) -> list[Topic]:
    """Return the topic of every publisher; its place in the list is the number of the source."""
    return [topic for topic in topics_of(robot) for _ in range(topic.publishers)]


def class_of(type_name: str) -> Any:
    """Return the class of a message, or of bytes where its package is not installed."""
    package, _, name = type_name.partition("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except ImportError:
        return class_of("std_msgs/UInt8MultiArray")


def message_of(made: Any, kind: str, filler: int) -> Any:
    """Return a message with the mark in one of its fields, and so many elements of filling."""
    message, name = made(), made.__name__
    if hasattr(message, "header"):
        message.header.frame_id = _MARK
    if name in _FILLED:
        empty = getattr(message, _FILLED[name])
        mark = _MARK.encode() if name == "UInt8MultiArray" else b""
        setattr(message, _FILLED[name], array(empty.typecode, mark + _FILL * filler * empty.itemsize))
    elif name == "Path":
        message.poses = [class_of("geometry_msgs/PoseStamped")()] * filler
    elif name == "TFMessage":
        transform = class_of("geometry_msgs/TransformStamped")(child_frame_id="base_link")
        transform.header.frame_id = _MARK
        message.transforms = [transform] * max(1, filler)
    elif name == "Twist":
        message.linear.x, message.linear.y, message.linear.z = struct.unpack("<3d", _MARK.encode())
    elif name == "String":
        message.data = kind + _MARK + _FILL.decode() * filler
    return message


class Template:
    """Serialized samples of one source, made by patching the first one.

    Parameters
    ----------
    source : its number
    """

    def __init__(self, topic: Topic, source: int = 0) -> None:
        self._source, self._rate_hz = source, topic.rate_hz
        made = class_of(topic.type_name)
        self._samples = [bytearray(_serialized(made, kind, topic.size)) for kind in topic.kinds]
        self._has_header = hasattr(made, "header")
        self._offset = self._samples[0].index(_MARK.encode())  # the kinds' first words are of one length
        self.size = len(self._samples[0])
        start = self._samples[0].find(_FILL * _CHECKED_BYTES)
        self._checked = slice(start, self.size - _STRIDE, _STRIDE) if start >= 0 else slice(0)

    def sample(self, number: int) -> bytes:
        """Return the sample of this number, sent now."""
        sample = self._samples[number % len(self._samples)]
        if self._has_header:
            # Samples of one number have one stamp, so that those of a group belong together.
            stamp_ns = round(number * _NANOSECONDS / self._rate_hz)
            struct.pack_into("<iI", sample, 4, *divmod(stamp_ns, _NANOSECONDS))
        np.frombuffer(sample, np.uint8)[self._checked] = number % _MODULUS
        tag = _TAG % (self._source, number, time.monotonic_ns())
        sample[self._offset : self._offset + _TAG_BYTES] = tag.encode()
        return bytes(sample)

    def read(self, sample: bytes) -> tuple[int, int, int]:
        """Return source, number and time of publishing (ns) of a sample of any source of the topic; -1 = no tag."""
        tag = sample[self._offset : self._offset + _TAG_BYTES]
        with suppress(ValueError):
            return int(tag[:2], 16), int(tag[2:8], 16), int(tag[8:], 16)
        return -1, -1, 0

    def is_whole(self, sample: bytes, number: int) -> bool:
        """Return whether a sample has its size, or that of the wire, and parts of this number only."""
        checked = np.frombuffer(sample, np.uint8)[self._checked]
        return 0 <= len(sample) - self.size < _ALIGNMENT and bool((checked == number % _MODULUS).all())


def _serialized(made: Any, kind: str, size: int) -> bytes:
    """Return a serialized message of about this size."""
    serialize: Callable[[Any], bytes] = importlib.import_module("rclpy.serialization").serialize_message
    few, many = (len(serialize(message_of(made, kind, filler))) for filler in (64, 128))
    filler = max(0, 64 + (size - few) * 64 // (many - few)) if many > few else 0
    return serialize(message_of(made, kind, filler))
