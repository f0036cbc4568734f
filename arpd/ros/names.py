"""Names of arpd's topics (docs/design.md, Protocols)."""

from __future__ import annotations

import re

PUBLISHERS_TOPIC = "/arpd/publishers"
PLAN_TOPIC = "/arpd/plan"
PRICE_TOPIC = "/arpd/price"
PROBE_TOPIC = "/arpd/probe"
REPORT_TOPIC = "/arpd/peer/report"

INFINITE_NS = 2**63 - 1  # ROS 2's "no deadline"

_FULL_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
_MOST_NAME = 256  # characters; ROS itself ends at 255


def is_full_name(name: str) -> bool:
    """Return whether ROS allows this as the fully qualified name of a node or a topic."""
    return len(name) <= _MOST_NAME and _FULL_NAME.fullmatch(name) is not None
