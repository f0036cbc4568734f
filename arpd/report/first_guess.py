"""First preferences for the topics of a robot that has none: weight, floor and ceiling, each with its reason."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from arpd.model.names import LONGEST_NAME, is_hidden, is_internal
from arpd.model.quantities import format_number, format_payload, format_rate
from arpd.model.settings import TopicGroup
from arpd.model.wire import wire_size
from arpd.report.topic_roles import Role, role_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from arpd.model.link_topics import LinkTopic

WEAK_LINK_BYTES_PER_SECOND = 2e6 / 8  # what a robot still gets at the edge of its Wi-Fi
_FLOOD_BYTES_PER_SECOND = 20e6 / 8
_LEAST_FLOOR_HZ = 0.01
_LARGE_BYTES = 100e3
_LARGE_DEPTH = 5
_MARGIN = 1.1  # of the highest useful rate above the measured one, for jitter
_SAME_RATE = 0.2  # by which the rates of a picture and of its camera_info may differ
_INFO, _INFO_TYPE = "/camera_info", "sensor_msgs/msg/CameraInfo"
_PICTURE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicGuess:
    """First preferences of one topic, or of a group that has its name.

    Parameters
    ----------
    name : its name under `topics`
    role : what it seems to be
    weight, min_rate_hz, max_rate_hz, max_depth, latency_budget_s : as in the configuration; None = the default there
    payload_bytes, source_rate_hz : what was measured; None = nothing
    remarks : words about what was measured, and what to judge
    """

    name: str
    role: Role
    weight: float
    min_rate_hz: float
    max_rate_hz: float | None = None
    max_depth: int | None = None
    latency_budget_s: float | None = None
    payload_bytes: float | None = None
    source_rate_hz: float | None = None
    remarks: tuple[str, ...] = ()

    @property
    def floor_bytes_per_second(self) -> float:
        """Wire bytes of its floor; 0 where the size is unknown (bytes/s)."""
        return _wire(self.payload_bytes, self.min_rate_hz)

    @property
    def full_bytes_per_second(self) -> float:
        """Wire bytes at the rate that was measured; 0 where nothing was (bytes/s)."""
        return _wire(self.payload_bytes, self.source_rate_hz or 0.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class FirstGuess:
    """First preferences of all topics.

    Parameters
    ----------
    topics : the most important ones first
    groups : pictures that cross together with their camera_info
    left_out : topics that no configuration can name
    """

    topics: tuple[TopicGuess, ...]
    groups: tuple[TopicGroup, ...] = ()
    left_out: tuple[str, ...] = ()

    @property
    def floors_bytes_per_second(self) -> float:
        """Wire bytes that all floors together need; topics of unknown size do not count (bytes/s)."""
        return sum(topic.floor_bytes_per_second for topic in self.topics)

    @property
    def full_bytes_per_second(self) -> float:
        """Wire bytes of all topics at their measured rates, each read once (bytes/s)."""
        return sum(topic.full_bytes_per_second for topic in self.topics)


def first_guess(topics: Iterable[LinkTopic]) -> FirstGuess:
    """Return preferences for topics: pure; topics of ROS, of arpd and hidden ones get none."""
    found = [topic for topic in topics if not is_internal(topic.name) and not is_hidden(topic.name)]
    named = [topic for topic in found if len(topic.name) <= LONGEST_NAME]
    groups = _groups(named)
    group_of = {member: group for group in groups for member in group.topics}
    by_name = {topic.name: topic for topic in named}
    guesses = [
        _of_group([by_name[member] for member in group_of[topic.name].topics])
        if topic.name in group_of
        else _of_topic(topic)
        for topic in named
        if topic.name not in group_of or group_of[topic.name].name == topic.name
    ]
    return FirstGuess(
        topics=tuple(sorted(guesses, key=lambda guess: (-guess.weight, guess.name))),
        groups=groups,
        left_out=tuple(topic.name for topic in found if len(topic.name) > LONGEST_NAME),
    )


def _of_topic(topic: LinkTopic) -> TopicGuess:
    """Return the preferences of one topic."""
    role = role_of(topic)
    care, traffic = role.care, topic.traffic
    rate_hz = float(f"{traffic.rate_hz:.3g}") if traffic else 0.0
    payload = traffic.mean_bytes if traffic else None
    floor_hz = min(max(care.share * rate_hz, care.least_hz), care.most_hz, rate_hz or math.inf)
    if role is Role.LATCHED:  # which may be silent for long, and then send several at once
        floor_hz = care.least_hz if payload is None else care.most_hz
    elif _is_flood(topic):
        floor_hz = 0.0
    if payload is not None:
        floor_hz = min(floor_hz, care.most_bytes_per_second / wire_size(payload, rate_hz=1.0)[0])
    return TopicGuess(
        name=topic.name,
        role=role,
        weight=care.weight,
        min_rate_hz=_down(floor_hz),
        max_rate_hz=float(f"{_MARGIN * rate_hz:.2g}") if care.is_periodic and rate_hz > 0 else None,
        max_depth=_LARGE_DEPTH if payload is not None and payload > _LARGE_BYTES and role is not Role.LATCHED else None,
        latency_budget_s=care.latency_budget_s,
        payload_bytes=None if payload is None else _whole(payload),
        source_rate_hz=rate_hz if rate_hz >= 0.001 else None,
        remarks=tuple(_remarks(topic)),
    )


def _of_group(members: Sequence[LinkTopic]) -> TopicGuess:
    """Return the preferences of a picture and its camera_info, which cross in one sample."""
    guess = _of_topic(members[0])
    sizes = [member.traffic.mean_bytes for member in members if member.traffic and member.traffic.mean_bytes]
    others = ", ".join(member.name for member in members[1:])
    return replace(guess, payload_bytes=_whole(sum(sizes)), remarks=(*guess.remarks, f"crosses together with {others}"))


def _groups(topics: Sequence[LinkTopic]) -> tuple[TopicGroup, ...]:
    """Pair each camera_info with a picture of its namespace, from the same nodes and at the same rate.

    Of several pictures it is the one that suits Wi-Fi best: compressed rather than raw.
    """
    groups: list[TopicGroup] = []
    taken: set[str] = set()
    for info in topics:
        namespace = info.name.removesuffix(_INFO)
        if info.type_name != _INFO_TYPE or namespace == info.name or not _rate(info):
            continue
        pictures = [
            topic
            for topic in topics
            if topic.name.startswith(f"{namespace}/")
            and topic.name not in taken
            and topic.type_name in _PICTURE_TYPES
            and topic.writers == info.writers
            and abs(_rate(topic) - _rate(info)) <= _SAME_RATE * _rate(info)
        ]
        if pictures:
            best = min(pictures, key=_unfitness)
            taken.add(best.name)
            groups.append(TopicGroup(name=best.name, topics=(best.name, info.name)))
    return tuple(groups)


def _unfitness(picture: LinkTopic) -> tuple[int, int, str]:
    return -_PICTURE_TYPES.index(picture.type_name), picture.name.count("/"), picture.name


def _remarks(topic: LinkTopic) -> Iterable[str]:
    traffic = topic.traffic
    if traffic is None:
        yield f"not measured: {topic.unmeasured}"
    elif traffic.rate_hz:
        measured = f"{format_number(traffic.rate_hz)} Hz of {format_payload(traffic.mean_bytes)}"
        yield f"measured {measured}: {format_rate(traffic.bytes_per_second)}"
        if _is_flood(topic):
            yield "more than Wi-Fi may carry: read it compressed over the link, or keep it off by relay.deny"
    elif traffic.mean_bytes:
        yield f"its last message has {format_payload(traffic.mean_bytes)}"
    else:
        yield "no message arrived meanwhile"
    if topic.is_crossing:
        yield "crosses the link now"


def _is_flood(topic: LinkTopic) -> bool:
    return topic.traffic is not None and topic.traffic.bytes_per_second > _FLOOD_BYTES_PER_SECOND


def _rate(topic: LinkTopic) -> float:
    return topic.traffic.rate_hz if topic.traffic else 0.0


def _wire(payload_bytes: float | None, rate_hz: float) -> float:
    if payload_bytes is None or rate_hz <= 0:
        return 0.0
    return wire_size(payload_bytes, rate_hz=rate_hz)[0] * rate_hz


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
