"""The relay with two ends, as its end on the robot sees it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, kw_only=True, slots=True)
class RelayTopics:
    """Topics of one direction.

    Parameters
    ----------
    offered, wanted : topics that one side may send, and those among them that the other side reads
    refused : topics and services of that side that an end refuses to carry, and why
    """

    offered: int = 0
    wanted: int = 0
    refused: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True)
class RelaySummary:
    """Everything that the robot's end tells the daemon.

    Parameters
    ----------
    other_host : host of the base computer's end, empty while it was never heard
    is_reachable : whether that end spoke lately
    fault : why its messages are not understood, empty if they are
    to_base, to_robot : topics by direction
    received, doubled, unknown, outdated : samples that the robot's end got: written there, had before, of unknown
        writers, and delayed by an outage until a newer one had come
    link_bytes : what both ends' chunks took of the link, headers and acknowledgements included
    incomplete : samples of groups that the robot's end dropped, because their set was never complete
    calls_failed : calls from the robot's nodes that had no answer, by reason
    strangers : nodes in the link domain that are not arpd's; the first few
    """

    other_host: str = ""
    is_reachable: bool = False
    fault: str = ""
    to_base: RelayTopics = field(default_factory=RelayTopics)
    to_robot: RelayTopics = field(default_factory=RelayTopics)
    received: int = 0
    doubled: int = 0
    unknown: int = 0
    outdated: int = 0
    link_bytes: int = 0
    incomplete: int = 0
    calls_failed: Mapping[str, int] = field(default_factory=dict)
    strangers: tuple[str, ...] = ()
