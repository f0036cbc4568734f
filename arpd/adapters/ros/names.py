"""Names of arpd's topics and parameters: the protocol (docs/design.md, Protocols) in one place."""

from __future__ import annotations

import re

PUBLISHERS_TOPIC = "/arpd/publishers"
READERS_TOPIC = "/arpd/subscriptions"
DAEMONS_TOPIC = "/arpd/daemons"
GATE_TOPIC = "/arpd/gate"
PROBE_TOPIC = "/arpd/probe"
REPORT_TOPIC = "/arpd/peer/report"
GENERATION_PARAMETER = "arpd.generation"
LEASE_PARAMETER = "arpd.lease"
READERS_GENERATION_PARAMETER = "arpd.readers.generation"
READERS_LEASE_PARAMETER = "arpd.readers.lease"

INFINITE_NS = 2**63 - 1  # how ROS 2 says "no deadline"

DEPTH = "depth"
DEADLINE = "deadline"
RATE = "rate"
MIN_RATE = "min_rate"

_FULL_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
_MOST_NAME = 256  # characters; ROS itself ends at 255


def parameter_name(topic: str, setting: str) -> str:
    """Full parameter name of one setting of the publisher on ``topic``.

    Depth and deadline use ROS 2's standard QoS-override names (design.ros2.org, "QoS Overrides by Parameters"),
    so that a user finds them where they already look; rate and floor are ours.
    """
    if setting in {DEPTH, DEADLINE}:
        return f"qos_overrides.{topic}.publisher.{setting}"
    return f"arpd.{topic}.publisher.{setting}"


def reader_parameter_name(topic: str, setting: str) -> str:
    """Full parameter name of depth or deadline of the reader of ``topic``, by the same standard."""
    return f"qos_overrides.{topic}.subscription.{setting}"


def is_internal(topic: str) -> bool:
    """Whether a topic belongs to ROS or arpd itself and is no robot traffic."""
    return topic in {"/rosout", "/parameter_events"} or topic.startswith("/arpd/")


def is_full_name(name: str) -> bool:
    """Whether this is a fully qualified name of a node or a topic, as ROS allows it."""
    return len(name) <= _MOST_NAME and _FULL_NAME.fullmatch(name) is not None
