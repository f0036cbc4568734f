"""Names of arpd's topics (docs/design.md, Protocols)."""

from __future__ import annotations

import re

PUBLISHERS_TOPIC = "/arpd/publishers"
COUNTERS_TOPIC = "/arpd/counters"
DAEMONS_TOPIC = "/arpd/daemons"
PRICE_TOPIC = "/arpd/price"
PROBE_TOPIC = "/arpd/probe"
REPORT_TOPIC = "/arpd/peer/report"
RELAY_SUMMARY_TOPIC = "/arpd/relay/summary"  # in the link domain, from the robot's end
PLAN_TOPICS = "/arpd/plan"  # followed by the node's full name

INFINITE_NS = 2**63 - 1  # ROS 2's "no deadline"

_FULL_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
_MOST_NAME = 256  # characters; ROS itself ends at 255


def plan_topic(node: str) -> str:
    """Return the topic of a node's plans, from its full name."""
    return PLAN_TOPICS + node


def is_full_name(name: str) -> bool:
    """Return whether ROS allows this as the fully qualified name of a node or a topic."""
    return len(name) <= _MOST_NAME and _FULL_NAME.fullmatch(name) is not None
