"""Robots, and the sides that carry their samples across the link."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    from scripts.bench.samples import Topic

PREFIX = "/link"  # of a relay with one end
BARE = "/bare"  # prefix behind the relay of ten lines


@dataclass(frozen=True, kw_only=True, slots=True)
class Service:
    """A service on the robot that the base calls, one call after the other.

    Parameters
    ----------
    node : process that serves it
    answer_bytes : length of its answer
    every_s : time between two calls
    fails_s : a call without an answer for so long has failed
    """

    name: str
    node: str
    answer_bytes: int
    every_s: float
    fails_s: float = math.inf


@dataclass(frozen=True, kw_only=True, slots=True)
class Way:
    """How the nodes publish.

    Parameters
    ----------
    is_adaptive : with AdaptivePublishers
    swap : "retune" or "recreate" every publisher again and again, or neither
    swap_every_s : time between two swaps of a publisher
    prefix : of the names under which the base reads what comes from the robot
    """

    is_adaptive: bool = False
    swap: str = ""
    swap_every_s: float = 4.0
    prefix: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Robot:
    """Topics, and what arpd's configuration says of them.

    Parameters
    ----------
    groups : topics whose samples of one number are of use only together
    settings : further sections of arpd's configuration
    """

    topics: tuple[Topic, ...]
    service: Service | None = None
    groups: tuple[str, ...] = ()
    settings: Mapping[str, Any] | None = None

    def changed(self, **changes: Any) -> Robot:
        """Return the robot with changes to each of its topics."""
        return replace(self, topics=tuple(replace(topic, **changes) for topic in self.topics))


@dataclass(frozen=True, kw_only=True, slots=True)
class Side:
    """How samples cross the link.

    Parameters
    ----------
    ends : of arpd's relay, of one in ten lines of rclpy ("bare"), or "zenoh"; with "two" and "zenoh" nodes stay at home
    is_governed : `arpd run` and `arpd peer` run, too
    has_profile : the nodes have arpd's Fast DDS profile
    transports : environment of every process; that of two ends keeps nodes on their hosts, as on a real robot
    is_told : the daemon is told the link's course (the bound)
    congestion : TCP's congestion control on the link
    warm_up_s : time in which the nodes publish and nothing counts (s)
    """

    name: str
    way: Way = Way()
    ends: str = ""
    is_governed: bool = False
    has_profile: bool = False
    transports: Mapping[str, str] = field(default_factory=dict, hash=False)
    is_told: bool = False
    congestion: str = "cubic"
    warm_up_s: float = 4.0


_TCP = {"FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA"}
SHARED = {"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}
_ADAPTIVE: dict[str, Any] = {"way": Way(is_adaptive=True), "is_governed": True, "has_profile": True, "warm_up_s": 8.0}
_CONFINED = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **SHARED}
_TWO_ENDS: dict[str, Any] = {"ends": "two", "transports": _CONFINED, "is_governed": True, "warm_up_s": 8.0}
SIDES = {
    side.name: side
    for side in (
        Side(name="plain"),
        Side(name="large_data", transports=_TCP),
        Side(name="large_data_bbr", transports=_TCP, congestion="bbr"),
        Side(name="profile", has_profile=True),
        Side(name="adaptive", **_ADAPTIVE),
        Side(name="adaptive_tcp", transports=_TCP, **_ADAPTIVE),
        Side(name="two_ends", **_TWO_ENDS),
        Side(name="bound", is_told=True, **_TWO_ENDS),
        Side(name="one_end", way=Way(prefix=PREFIX), ends="one"),
        *(Side(name=name, ends="zenoh", transports=_CONFINED) for name in ("zenoh", "zenoh_drop", "zenoh_first")),
        Side(name="zenoh_bbr", ends="zenoh", transports=_CONFINED, congestion="bbr"),
        Side(name="bare", way=Way(prefix=BARE), ends="bare"),
    )
}
