"""Roles of topics, guessed by type, and the weight and floor that suit each."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from arpd.model.link_topics import LinkTopic

_LARGE_BYTES_PER_SECOND = 1e6 / 8  # a part of weak Wi-Fi that other topics feel


@dataclass(frozen=True, kw_only=True, slots=True)
class Care:
    """What suits the topics of one role.

    Parameters
    ----------
    weight : as in the configuration
    share : floor as a part of the measured rate, within the next two
    least_hz, most_hz : bounds of the floor; it never exceeds the measured rate (Hz)
    most_kbit : further bound of the floor, on the wire: large samples are few (kbit/s)
    latency_budget_s : as in the configuration; None = its default (s)
    is_periodic : whether the measured rate says what rate is useful
    """

    weight: float
    share: float
    least_hz: float
    most_hz: float
    most_kbit: float = math.inf
    latency_budget_s: float | None = None
    is_periodic: bool = False

    @property
    def most_bytes_per_second(self) -> float:
        """The same in bytes/s."""
        return self.most_kbit * 125


class Role(Enum):
    """Use of a topic, from the most to the least important one."""

    COMMAND = Care(weight=10, share=1.0, least_hz=20, most_hz=20, latency_budget_s=0.2)
    TRANSFORM = Care(weight=6, share=1.0, least_hz=10, most_hz=100)
    STATE = Care(weight=5, share=0.25, least_hz=5, most_hz=30, most_kbit=200, is_periodic=True)
    LATCHED = Care(weight=4, share=1.0, least_hz=1, most_hz=10, most_kbit=50)  # which it keeps although it is silent
    PERCEPTION = Care(weight=3, share=0.25, least_hz=1, most_hz=5, most_kbit=250, is_periodic=True)
    OTHER = Care(weight=2, share=1.0, least_hz=1, most_hz=1, most_kbit=50)
    VIDEO = Care(weight=1, share=1.0, least_hz=0, most_hz=math.inf)
    PICTURE = Care(weight=1, share=0.1, least_hz=0.5, most_hz=2, most_kbit=400, is_periodic=True)
    DIAGNOSTIC = Care(weight=0.5, share=0.2, least_hz=0.2, most_hz=0.5, most_kbit=50)

    @property
    def care(self) -> Care:
        """What suits its topics."""
        return self.value

    @property
    def reason(self) -> str:
        """Why, for a comment."""
        return _REASONS[self]


_REASONS = {
    Role.COMMAND: "a command: a late one is dangerous, so it comes first and only the newest ones count",
    Role.TRANSFORM: "transforms, or time: each message may hold other frames, and others wait for it",
    Role.STATE: "the robot's motion, or a reading: small, and control needs it fresh",
    Role.LATCHED: "latched: readers keep the newest one, so each should arrive",
    Role.PERCEPTION: "what the robot sees, in few bytes: useful at a lower rate, too",
    Role.OTHER: "a type that arpd does not know: please judge",
    Role.VIDEO: (
        "WARNING: a stream whose frames need those before them, so a lower rate breaks it until the next key "
        "frame: its minimum rate is all it sends. If that is too much, let the encoder send less, or send pictures"
    ),
    Role.PICTURE: "large: it takes what the others leave",
    Role.DIAGNOSTIC: "diagnostics: nobody waits for them",
}

_TWIST = r"geometry_msgs/msg/Twist(Stamped)?"
_BY_TYPE: tuple[tuple[Role, str], ...] = (
    (Role.TRANSFORM, r"tf2?_msgs/msg/TFMessage|rosgraph_msgs/msg/Clock"),
    (Role.COMMAND, rf"{_TWIST}|ackermann_msgs/.*|trajectory_msgs/.*|control_msgs/.*|sensor_msgs/msg/Joy"),
    (Role.VIDEO, r"(ffmpeg|theora)_image_transport(_msgs)?/.*|.*/\w*Video\w*|\w*audio\w*/.*"),
    (Role.PICTURE, r".*(Image|Picture|PointCloud|Packet)\w*|stereo_msgs/.*|\w*image_transport\w*/.*"),
    (
        Role.STATE,
        r"nav_msgs/msg/Odometry|geometry_msgs/msg/(Pose|Transform|TwistWith|Accel|Wrench|Vector3|Point|Quaternion)\w*",
    ),
    (Role.PERCEPTION, r"sensor_msgs/msg/(LaserScan|MultiEchoLaserScan|Range|CameraInfo|RegionOfInterest)"),
    (Role.PERCEPTION, r"(nav|map|visualization|vision|octomap|geometry|shape|object_recognition)_msgs/.*"),
    (Role.DIAGNOSTIC, r"(diagnostic_msgs|rcl_interfaces|statistics_msgs|lifecycle_msgs|bond)/.*"),
    (Role.STATE, r"sensor_msgs/.*"),
)
_COMMAND_NAME = re.compile(r"(?:^|[/_])(?:cmd|command|commands|estop|e_stop|emergency|stop)(?:$|[/_])")


def role_of(topic: LinkTopic) -> Role:
    """Return the likely role of a topic, by its durability, its type, its direction and what it sends."""
    role = _by_type(topic.type_name)
    # A map that comes once a second is latched, too; a stream of pictures is one, whatever its durability.
    is_stream = role in {Role.VIDEO, Role.PICTURE} and topic.traffic is not None and topic.traffic.rate_hz > 0
    if topic.is_latched and not is_stream:
        return Role.LATCHED
    if role in {Role.TRANSFORM, Role.VIDEO, Role.PICTURE, Role.DIAGNOSTIC, Role.COMMAND}:
        return role
    if role is Role.OTHER and topic.traffic is not None and topic.traffic.bytes_per_second > _LARGE_BYTES_PER_SECOND:
        return Role.PICTURE
    if role is not Role.PERCEPTION and _is_command(topic):
        return Role.COMMAND
    return role


def _by_type(type_name: str) -> Role:
    return next((role for role, types in _BY_TYPE if re.fullmatch(types, type_name)), Role.OTHER)


def _is_command(topic: LinkTopic) -> bool:
    """Return whether nodes here read it and none publishes it, or its name says that it is a command."""
    return (not topic.is_from_robot and bool(topic.readers)) or _COMMAND_NAME.search(topic.name) is not None
