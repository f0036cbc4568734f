"""Names of arpd's topics, and bounds that several of its messages share (docs/design.md, Protocols)."""

from __future__ import annotations

import re

from arpd.model.names import LONGEST_NAME

PUBLISHERS_TOPIC = "/arpd/publishers"
PLAN_TOPIC = "/arpd/plan"
PRICE_TOPIC = "/arpd/price"
PROBE_TOPIC = "/arpd/probe"
REPORT_TOPIC = "/arpd/peer/report"

# Topics of a relay's two ends have names of their own on the link. All endpoints of one topic name in a process take
# their samples from one pool, whatever their domain (Fast DDS 2.14, TopicPayloadPoolRegistry), and a buffer never
# shrinks: beside a map of 4 MB each buffer for a chunk of it grew to 4 MB, up to `LINK_DEPTH` of them.
_ON_LINK = "/arpd/link"

INFINITE_NS = 2**63 - 1  # ROS 2's "no deadline"
# No topic that crosses a link is faster than 100 kHz. The timer of a deadline much shorter than the source's period
# takes a tenth of a core (measured from 1 ms down, Fast DDS).
LEAST_DEADLINE_NS = 10_000
MOST_LEASE_S = 1e9

_FULL_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")


def is_arpds(node: str) -> bool:
    """Return whether a node, by its full name, is one of arpd's processes."""
    return node.startswith("/arpd")


def on_link(topic: str) -> str:
    """Return the name in the link's domain of a topic that a relay with two ends carries; ValueError = too long."""
    if len(topic) > (most := LONGEST_NAME - len(_ON_LINK)):
        raise ValueError(f"its name has {len(topic)} characters, and no more than {most} cross")
    return _ON_LINK + topic


def off_link(name: str) -> str:
    """Return the topic of a name in the link's domain; other names stay as they are."""
    return name.removeprefix(_ON_LINK) if name.startswith(f"{_ON_LINK}/") else name


def checked_full_name(name: str) -> str:
    """Return a full name; raises ValueError if `is_full_name` says that it is none."""
    if not is_full_name(name):
        raise ValueError("no full name of ROS")
    return name


def is_full_name(name: str) -> bool:
    """Return whether ROS allows this as the full name of a topic; arpd takes no longer one of a node, either."""
    return len(name) <= LONGEST_NAME and _FULL_NAME.fullmatch(name) is not None
