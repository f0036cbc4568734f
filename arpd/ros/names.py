"""Names of arpd's topics, and bounds that several of its messages share (docs/design.md, Protocols)."""

from __future__ import annotations

import re

from arpd.model.names import LONGEST_NAME

PUBLISHERS_TOPIC = "/arpd/publishers"
PLAN_TOPIC = "/arpd/plan"
PRICE_TOPIC = "/arpd/price"
PROBE_TOPIC = "/arpd/probe"
REPORT_TOPIC = "/arpd/peer/report"

INFINITE_NS = 2**63 - 1  # ROS 2's "no deadline"
# No topic that crosses a link is faster than 100 kHz. The timer of a deadline much shorter than the source's period
# takes a tenth of a core (measured from 1 ms down, Fast DDS).
LEAST_DEADLINE_NS = 10_000
MOST_LEASE_S = 1e9

_FULL_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")


def is_arpds(node: str) -> bool:
    """Return whether a node, by its full name, is one of arpd's processes."""
    return node.startswith("/arpd")


def checked_full_name(name: str) -> str:
    """Return a full name; raises ValueError if `is_full_name` says that it is none."""
    if not is_full_name(name):
        raise ValueError("no full name of ROS")
    return name


def is_full_name(name: str) -> bool:
    """Return whether ROS allows this as the full name of a topic; arpd takes no longer one of a node, either."""
    return len(name) <= LONGEST_NAME and _FULL_NAME.fullmatch(name) is not None
