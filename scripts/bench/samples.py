"""Topics, and samples that say who sent them, when, and whether they are whole."""

from __future__ import annotations

import importlib
import math
import struct
import time
from array import array
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

PACKET_BYTES = 1472  # payload of UDP in one frame
SMALL_BYTES = 10 * PACKET_BYTES
BASE = "base"  # the node of a topic that goes to the robot

_TAG = "%04x%06x%014x"  # source, number, time of publishing on the monotonic clock (ns)
_TAG_BYTES = 24
_MARK = "T" * _TAG_BYTES
_FILL = b"\x55"
_CHECKED_BYTES, _STRIDE = 4096, 512  # bytes from which every so many are checked
_ALIGNMENT = 4  # of what follows a sample in a datagram
_MODULUS = 101  # of what they say; fits in a signed byte
_NANOSECONDS = 10**9
#: Field of each type that is filled up.
_FILLED = {
    **dict.fromkeys(("Image", "CompressedImage", "PointCloud2", "OccupancyGrid", "UInt8MultiArray"), "data"),
    "LaserScan": "ranges",
    "Joy": "axes",
    "JointState": "position",
    "BatteryState": "cell_voltage",
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Topic:
    """One topic of a robot.

    Parameters
    ----------
    type_name : package and name of its type
    size : of a serialized sample, met as nearly as its type allows (bytes)
    node : process that publishes it; BASE = on the other host
    publishers : so many of them
    burst : samples that come at once; ``rate_hz`` is the mean
    depth, deadline_hz : QoS of its writers (samples; Hz, 0 = none)
    is_kept : nobody may thin it: its queues are deep, and its least rate is above its own
    answers : number of sources whose samples its process sends back, the sample n of the source n modulo their number
    share : of its samples that a throttle lets pass
    """

    name: str
    type_name: str = "std_msgs/String"
    rate_hz: float
    size: int
    node: str
    publishers: int = 1
    burst: int = 1
    is_latched: bool = False
    depth: int = 10  # what every rclpy tutorial passes
    deadline_hz: float = 0.0
    is_kept: bool = False
    answers: int = 0
    share: float = 1.0

    def passes(self, number: int) -> bool:
        """Return whether the throttle lets the sample of this number pass."""
        return math.floor(number * self.share) > math.floor((number - 1) * self.share)

    @property
    def period_s(self) -> float:
        """Time from one burst, usually of one sample, to the next (s)."""
        return self.burst / self.rate_hz

    @property
    def group(self) -> str:
        """Class of figures to which it belongs; a small one that is of no use without its image is ``paired``."""
        if self.node == BASE:
            return "commands"
        is_paired = self.type_name == "sensor_msgs/CameraInfo"
        return "large" if self.size > SMALL_BYTES else "paired" if is_paired else "small"


def sources_of(topics: Sequence[Topic]) -> list[Topic]:
    """Return the topic of every publisher; its place in the list is the number of the source."""
    return [topic for topic in topics for _ in range(topic.publishers)]


def class_of(type_name: str) -> Any:
    """Return the class of a message."""
    package, _, name = type_name.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def message_of(made: Any, filler: int) -> Any:
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
    elif name == "Twist":
        message.linear.x, message.linear.y, message.linear.z = struct.unpack("<3d", _MARK.encode())
    elif name == "String":
        message.data = _MARK + _FILL.decode() * filler
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
        self._sample = bytearray(_serialized(made, topic.size))
        self._has_header = hasattr(made, "header")
        self._offset = self._sample.index(_MARK.encode())
        self.size = len(self._sample)
        start = self._sample.find(_FILL * _CHECKED_BYTES)
        self._checked = slice(start, self.size - _STRIDE, _STRIDE) if start >= 0 else slice(0)

    def sample(self, number: int) -> bytes:
        """Return the sample of this number, sent now."""
        if self._has_header:
            # Samples of one number have one stamp, so that those of a group belong together.
            stamp_ns = round(number * _NANOSECONDS / self._rate_hz)
            struct.pack_into("<iI", self._sample, 4, *divmod(stamp_ns, _NANOSECONDS))
        np.frombuffer(self._sample, np.uint8)[self._checked] = number % _MODULUS
        return self.tagged(self._source, number, time.monotonic_ns())

    def tagged(self, source: int, number: int, sent_ns: int) -> bytes:
        """Return a sample with this tag, which may be that of another one."""
        self._sample[self._offset : self._offset + _TAG_BYTES] = (_TAG % (source, number, sent_ns)).encode()
        return bytes(self._sample)

    def read(self, sample: bytes) -> tuple[int, int, int]:
        """Return source, number and time of publishing (ns) of a sample of any source of the topic; -1 = no tag."""
        tag = sample[self._offset : self._offset + _TAG_BYTES]
        with suppress(ValueError):
            return int(tag[:4], 16), int(tag[4:10], 16), int(tag[10:], 16)
        return -1, -1, 0

    def is_whole(self, sample: bytes, number: int) -> bool:
        """Return whether a sample has its size, or that of the wire, and parts of this number only."""
        checked = np.frombuffer(sample, np.uint8)[self._checked]
        return 0 <= len(sample) - self.size < _ALIGNMENT and bool((checked == number % _MODULUS).all())


def _serialized(made: Any, size: int) -> bytes:
    """Return a serialized message of about this size."""
    serialize: Callable[[Any], bytes] = importlib.import_module("rclpy.serialization").serialize_message
    few, many = (len(serialize(message_of(made, filler))) for filler in (64, 128))
    filler = max(0, 64 + (size - few) * 64 // (many - few)) if many > few else 0
    return serialize(message_of(made, filler))
