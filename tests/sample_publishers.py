"""Publishers and readers for tests: each says only what its test is about."""

from __future__ import annotations

from arpd.apply.ordering import Ordering
from arpd.model.endpoints import Direction, PublisherState, ReaderState


def publisher(node: str, topic: str, **fields) -> PublisherState:
    """Return a sensing publisher at 20 Hz of 1 kB that runs with its application's QoS, unless told otherwise."""
    neutral = {
        "type_name": "std_msgs/msg/String",
        "direction": Direction.SENSING,
        "payload_bytes": 1000.0,
        "source_rate_hz": 20.0,
        "depth": 10,
        "baseline_depth": 10,
    }
    return PublisherState(node=node, topic=topic, **{**neutral, **fields})


def reader(node: str, topic: str, **fields) -> ReaderState:
    """Return a reader with its application's QoS, unless told otherwise."""
    return ReaderState(node=node, topic=topic, **{"depth": 10, "baseline_depth": 10, **fields})


def plan_transitions(publishers, plan, *, reason="test", lease_s=0.0):
    """Return the steps from what was announced to a plan, where nothing was asked before and nobody reads."""
    steps = Ordering().steps(
        0.0, publishers=publishers, readers=(), plan=plan, reader_plans={}, reason=reason, lease_s=lease_s
    )
    return steps.transitions
