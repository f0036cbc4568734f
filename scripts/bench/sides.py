"""Robots, and the sides that carry their samples across the link."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from scripts.bench.nodes import BARE, Service, Way
from scripts.bench.report import REPO

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from scripts.bench.samples import Topic

_LARGE_DATA = {"FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA"}
_MEMORY = {"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}
_CONFINED = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}
PREFIX = "/link"  # of a relay with one end


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
    ends : of arpd's relay, or of one in ten lines of rclpy ("bare"); plain nodes stay on their hosts with "two"
    is_governed : `arpd run` and `arpd peer` run, too
    has_profile : the nodes have arpd's Fast DDS profile
    has_memory : Fast DDS may use shared memory within a host
    is_told : the daemon is told the link's course (the bound)
    tree : source tree of arpd's processes
    warm_up_s : time in which the nodes publish and nothing counts (s)
    """

    name: str
    way: Way = Way()  # noqa: RUF009 - frozen
    ends: str = ""
    is_governed: bool = False
    has_profile: bool = False
    is_over_tcp: bool = False
    is_told: bool = False
    has_memory: bool = False
    tree: Path = REPO
    warm_up_s: float = 4.0

    @property
    def transports(self) -> dict[str, str]:
        """Environment of every process; that of two ends keeps nodes on their hosts, as on a real robot."""
        if self.ends == "two":
            return _CONFINED
        return _LARGE_DATA if self.is_over_tcp else _MEMORY if self.has_memory else {}


_ADAPTIVE: dict[str, Any] = {"way": Way(is_adaptive=True), "is_governed": True, "has_profile": True, "warm_up_s": 8.0}
_TWO_ENDS: dict[str, Any] = {"ends": "two", "is_governed": True, "warm_up_s": 8.0}
SIDES = {
    side.name: side
    for side in (
        Side(name="plain"),
        Side(name="large_data", is_over_tcp=True),
        Side(name="adaptive", **_ADAPTIVE),
        Side(name="adaptive_tcp", is_over_tcp=True, **_ADAPTIVE),
        Side(name="two_ends", **_TWO_ENDS),
        Side(name="bound", is_told=True, **_TWO_ENDS),
        Side(name="one_end", way=Way(prefix=PREFIX), ends="one"),
        Side(name="bare", way=Way(prefix=BARE), ends="bare"),
    )
}
