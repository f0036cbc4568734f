"""First preferences for the topics of a robot that has none: by the role that each seems to have, with the reason."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from arpd.model.names import is_hidden, is_internal
from arpd.model.quantities import format_number, format_payload, format_rate
from arpd.model.settings import TopicGroup, TopicSettings
from arpd.model.wire import wire_size

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from arpd.model.link_topics import LinkTopic

WEAK_LINK_BYTES_PER_SECOND = 2e6 / 8  # what a robot still gets at the edge of its Wi-Fi
_FELT_BYTES_PER_SECOND = 1e6 / 8  # a part of weak Wi-Fi that other topics feel
_FLOOD_BYTES_PER_SECOND = 20e6 / 8
_LEAST_FLOOR_HZ = 0.01
_LARGE_BYTES = 100e3
_LARGE_DEPTH = 5
_SAME_RATE = 0.2  # by which the rates of a picture and of its camera_info may differ
_INFO, _INFO_TYPE = "/camera_info", "sensor_msgs/msg/CameraInfo"
_PICTURE_TYPES = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")  # the one that suits Wi-Fi best first


class Role(NamedTuple):
    """Use of a topic, and what suits it.

    Parameters
    ----------
    weight, latency_budget_s : as in the configuration
    share : floor as a part of the measured rate, within the next two
    least_hz, most_hz : bounds of the floor; it never exceeds the measured rate (Hz)
    most_kbit : further bound of the floor, on the wire: large samples are few (kbit/s)
    reason : why, for a comment
    """

    weight: float
    share: float
    least_hz: float
    most_hz: float
    most_kbit: float
    reason: str
    latency_budget_s: float = 1.0


_ANY = math.inf
# fmt: off
COMMAND = Role(
    10, 1, 20, 20, _ANY, "a command: a late one is dangerous, so it comes first and only the newest ones count", 0.2
)
TRANSFORM = Role(
    6, 1, 10, 100, _ANY, "transforms, or time: each message may hold other frames, and others wait for it"
)
STATE = Role(5, 0.25, 5, 30, 200, "the robot's motion, or a reading: small, and control needs it fresh")
# It keeps that although it is silent.
LATCHED = Role(4, 1, 1, 10, 50, "latched: readers keep the newest one, so each should arrive")
PERCEPTION = Role(3, 0.25, 1, 5, 250, "what the robot sees, in few bytes: useful at a lower rate, too")
OTHER = Role(2, 1, 1, 1, 50, "a type that arpd does not know: please judge")
VIDEO = Role(
    1, 1, 0, _ANY, _ANY,
    "WARNING: a stream whose frames need those before them, so a lower rate breaks it until the next key frame: "
    "its minimum rate is all it sends. If that is too much, let the encoder send less, or send pictures",
)
PICTURE = Role(1, 0.1, 0.5, 2, 400, "large: it takes what the others leave")
DIAGNOSTIC = Role(0.5, 0.2, 0.2, 0.5, 50, "diagnostics: nobody waits for them")
# fmt: on
_BY_TYPE: tuple[tuple[Role, str], ...] = (
    (TRANSFORM, r"tf2?_msgs/msg/TFMessage|rosgraph_msgs/msg/Clock"),
    (COMMAND, r"geometry_msgs/msg/Twist(Stamped)?|(ackermann|trajectory|control)_msgs/.*|sensor_msgs/msg/Joy"),
    (VIDEO, r"(ffmpeg|theora)_image_transport(_msgs)?/.*|.*/\w*Video\w*|\w*audio\w*/.*"),
    (PICTURE, r".*(Image|Picture|PointCloud|Packet)\w*|stereo_msgs/.*|\w*image_transport\w*/.*"),
    (STATE, r"nav_msgs/msg/Odometry"),
    (STATE, r"geometry_msgs/msg/(Pose|Transform|TwistWith|Accel|Wrench|Vector3|Point|Quaternion)\w*"),
    (PERCEPTION, r"sensor_msgs/msg/(LaserScan|MultiEchoLaserScan|Range|CameraInfo|RegionOfInterest)"),
    (PERCEPTION, r"(nav|map|visualization|vision|octomap|geometry|shape|object_recognition)_msgs/.*"),
    (DIAGNOSTIC, r"(diagnostic_msgs|rcl_interfaces|statistics_msgs|lifecycle_msgs|bond)/.*"),
    (STATE, r"sensor_msgs/.*"),
)
_COMMAND_NAME = re.compile(r"(?:^|[/_])(?:cmd|command|commands|estop|e_stop|emergency|stop)(?:$|[/_])")


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicGuess:
    """First preferences of one topic, or of a group that has its name.

    Parameters
    ----------
    settings : its item of `topics`
    role : what it seems to be
    remarks : words about what was measured, and what to judge
    """

    settings: TopicSettings
    role: Role
    remarks: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class FirstGuess:
    """First preferences of all topics.

    Parameters
    ----------
    topics : the most important ones first
    groups : pictures that cross together with their camera_info
    """

    topics: tuple[TopicGuess, ...]
    groups: tuple[TopicGroup, ...]


def first_guess(topics: Iterable[LinkTopic]) -> FirstGuess:
    """Return preferences for topics: pure; topics of ROS, of arpd and hidden ones get none."""
    named = {each.name: each for each in topics if not is_internal(each.name) and not is_hidden(each.name)}
    groups = tuple(_groups([*named.values()]))
    others = {group.name: named[group.topics[1]] for group in groups}
    grouped = {other.name for other in others.values()}
    guesses = [_of_topic(topic, others.get(name)) for name, topic in named.items() if name not in grouped]
    return FirstGuess(
        topics=tuple(sorted(guesses, key=lambda guess: (-guess.settings.weight, guess.settings.name))),
        groups=groups,
    )


def wire_bytes_per_second(payload_bytes: float | None, rate_hz: float | None) -> float:
    """Return what such samples take of the link; 0 where size or rate is unknown (bytes/s)."""
    return wire_size(payload_bytes, rate_hz=rate_hz)[0] * rate_hz if payload_bytes is not None and rate_hz else 0.0


def _of_topic(topic: LinkTopic, info: LinkTopic | None) -> TopicGuess:
    """Return the preferences of one topic, or of a picture and its camera_info, which cross in one sample."""
    role, traffic = _role_of(topic), topic.traffic
    rate_hz = float(f"{_rate(topic):.3g}")
    payload = traffic.mean_bytes if traffic else None
    floor_hz = min(max(role.share * rate_hz, role.least_hz), role.most_hz, rate_hz or math.inf)
    if role is LATCHED:  # which may be silent for long, and then send several at once
        floor_hz = role.least_hz if payload is None else role.most_hz
    elif _is_flood(topic):
        floor_hz = 0.0
    if payload is not None:
        floor_hz = min(floor_hz, role.most_kbit * 125 / wire_size(payload, rate_hz=1.0)[0])
    settings = TopicSettings(
        name=topic.name,
        weight=role.weight,
        min_rate_hz=_down(floor_hz),
        latency_budget_s=role.latency_budget_s,
        payload_bytes=None if payload is None else _whole(payload),
        source_rate_hz=rate_hz if rate_hz >= 0.001 else None,
    )
    if payload is not None and payload > _LARGE_BYTES and role is not LATCHED:
        settings = replace(settings, max_depth=_LARGE_DEPTH)
    remarks = tuple(_remarks(topic))
    if info is not None:
        sizes = (each.traffic.mean_bytes for each in (topic, info) if each.traffic)
        settings = replace(settings, payload_bytes=_whole(sum(filter(None, sizes))))
        remarks = (*remarks, f"crosses together with {info.name}")
    return TopicGuess(settings=settings, role=role, remarks=remarks)


def _role_of(topic: LinkTopic) -> Role:
    """Return the likely role of a topic, by its durability, its type, its direction and what it sends."""
    role = next((role for role, types in _BY_TYPE if re.fullmatch(types, topic.type_name)), OTHER)
    # A map that comes once a second is latched, too; a stream of pictures is one, whatever its durability.
    if topic.is_latched and not (role in {VIDEO, PICTURE} and _rate(topic) > 0):
        return LATCHED
    if role is OTHER and topic.traffic is not None and topic.traffic.bytes_per_second > _FELT_BYTES_PER_SECOND:
        return PICTURE
    # Nodes here read it and none publishes it, or its name says that it is a command.
    is_command = (not topic.is_from_robot and bool(topic.readers)) or _COMMAND_NAME.search(topic.name)
    return COMMAND if role in {STATE, OTHER} and is_command else role


def _groups(topics: Sequence[LinkTopic]) -> Iterator[TopicGroup]:
    """Pair each camera_info with a picture of its namespace, from the same nodes and at the same rate."""
    taken: set[str] = set()
    for info in topics:
        namespace = info.name.removesuffix(_INFO)
        if info.type_name != _INFO_TYPE or namespace == info.name or not _rate(info):
            continue
        pictures = [
            (_PICTURE_TYPES.index(topic.type_name), topic.name.count("/"), topic.name)
            for topic in topics
            if topic.name.startswith(f"{namespace}/")
            and topic.name not in taken
            and topic.type_name in _PICTURE_TYPES
            and topic.writers == info.writers
            and abs(_rate(topic) - _rate(info)) <= _SAME_RATE * _rate(info)
        ]
        if pictures:
            *_, best = min(pictures)
            taken.add(best)
            yield TopicGroup(name=best, topics=(best, info.name))


def _remarks(topic: LinkTopic) -> Iterator[str]:
    traffic = topic.traffic
    if traffic is None:
        yield f"not measured: {topic.unmeasured}"
    elif traffic.rate_hz:
        measured = f"{format_number(traffic.rate_hz)} Hz of {format_payload(traffic.mean_bytes)}"
        yield f"measured {measured}: {format_rate(traffic.bytes_per_second)}"
        if _is_flood(topic):
            less = "set max_rate_hz, or a lower quality" if "Compressed" in topic.type_name else "read it compressed"
            yield f"more than Wi-Fi may carry: {less}, or keep it off the link by relay.deny"
    elif traffic.mean_bytes:
        yield f"its last message has {format_payload(traffic.mean_bytes)}"
    else:
        yield "no message arrived meanwhile"
    if topic.is_crossing:
        yield "crosses the link now, which may slow it"


def _is_flood(topic: LinkTopic) -> bool:
    return topic.traffic is not None and topic.traffic.bytes_per_second > _FLOOD_BYTES_PER_SECOND


def _rate(topic: LinkTopic) -> float:
    return topic.traffic.rate_hz if topic.traffic else 0.0


def _down(rate_hz: float) -> float:
    """Return the rate in two digits, not above it; 0 for less than one sample in a hundred seconds."""
    if rate_hz < _LEAST_FLOOR_HZ:
        return 0.0
    digits = 1 - math.floor(math.log10(rate_hz))
    scaled = round(rate_hz * 10.0**digits, 6)  # 0.29 * 100 is a little below 29
    return float(f"{math.floor(scaled) / 10.0**digits:.2g}")


def _whole(size_bytes: float) -> float:
    """Return the size in three digits, not below it, so that it reads well."""
    step = 10.0 ** max(0, math.floor(math.log10(max(size_bytes, 1.0))) - 2)
    return math.ceil(size_bytes / step) * step
