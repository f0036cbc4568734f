"""Publishers for tests: each test states only what it is about."""

from __future__ import annotations

from arpd.model.endpoints import Direction, PublisherState


def publisher(node: str, topic: str, **fields) -> PublisherState:
    """Return a sensing publisher of 1 kB at 20 Hz with its application's QoS, except for ``fields``."""
    neutral = {
        "type_name": "std_msgs/msg/String",
        "direction": Direction.SENSING,
        "payload_bytes": 1000.0,
        "source_rate_hz": 20.0,
        "depth": 10,
        "baseline_depth": 10,
    }
    return PublisherState(node=node, topic=topic, **{**neutral, **fields})
