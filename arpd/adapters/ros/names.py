"""Names of arpd's topics and parameters (docs/design.md, Protocols)."""

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
GENERATION_PARAMETER = "arpd.generation"
LEASE_PARAMETER = "arpd.lease"

INFINITE_NS = 2**63 - 1  # ROS 2's "no deadline"

DEPTH = "depth"
DEADLINE = "deadline"
RATE = "rate"
MIN_RATE = "min_rate"
WEIGHT = "weight"
WIRE_BYTES = "wire_bytes"
PACKETS = "packets"

_FULL_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
_MOST_NAME = 256  # characters; ROS itself ends at 255


def plan_topic(node: str) -> str:
    """Return the topic of a node's plans, from its full name."""
    return PLAN_TOPICS + node


def parameter_name(topic: str, setting: str) -> str:
    """Return the full parameter name of one setting of the publisher on ``topic``.

    Depth and deadline have ROS 2's standard names (design.ros2.org, "QoS Overrides by Parameters"); all others
    have arpd's own.
    """
    if setting in {DEPTH, DEADLINE}:
        return f"qos_overrides.{topic}.publisher.{setting}"
    return f"arpd.{topic}.publisher.{setting}"


def is_full_name(name: str) -> bool:
    """Return whether ROS allows this as the fully qualified name of a node or a topic."""
    return len(name) <= _MOST_NAME and _FULL_NAME.fullmatch(name) is not None
