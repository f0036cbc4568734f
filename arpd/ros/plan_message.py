"""The plan of all nodes as a message."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy

from arpd.model.plan import MOST_GENERATION
from arpd.ros.bounds import LEAST_LEASE_S, MOST_LEASE_S, ROW_FIELDS
from arpd.ros.documents import integer, number, pack, unpack

if TYPE_CHECKING:
    from collections.abc import Mapping

    from arpd.model.plan import TopicPlan

MOST_BYTES = 1 << 20  # of its text; a thousand topics take a tenth of it
#: The last plan is kept for nodes that start later.
PLAN_QOS = QoSProfile(
    depth=1, reliability=QoSReliabilityPolicy.RELIABLE, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL
)


@dataclass(frozen=True, kw_only=True, slots=True)
class PlanMessage:
    """What is now asked of all nodes.

    Parameters
    ----------
    generation : number of the plan
    lease_s : silence of the daemon after which a node returns to its own QoS, 0 = never (s)
    rows : topic → row as it came; a node checks those of its publishers. Topics without one stay as they are
    """

    generation: int
    lease_s: float = 0.0
    rows: Mapping[str, Any]


def encode_plan(*, generation: int, lease_s: float, topics: Mapping[str, TopicPlan]) -> bytes:
    """Return the message of a plan; the same plan has the same bytes."""
    rows = {topic: _row(row) for topic, row in sorted(topics.items())}
    return pack({"generation": generation, "lease_s": lease_s, "rows": rows})


def decode_plan(data: bytes) -> PlanMessage:
    """Read a plan.

    Raises
    ------
    ValueError
        If the bytes are no plan, or its generation or lease is out of bounds; the message names the fault.
    """
    document = unpack(data, most_bytes=MOST_BYTES)
    rows = document.get("rows")
    if not isinstance(rows, dict):
        raise ValueError("a plan without rows")  # noqa: TRY004 - a message may hold anything, so it is no type error
    lease_s = number("lease_s", document.get("lease_s"), most=MOST_LEASE_S)
    if 0 < lease_s < LEAST_LEASE_S:
        raise ValueError(f"lease_s = {lease_s} is below {LEAST_LEASE_S:g}; 0 = never ends")
    generation = integer("generation", document.get("generation"), most=MOST_GENERATION)
    return PlanMessage(generation=generation, lease_s=lease_s, rows=rows)


def _row(row: TopicPlan) -> list[float | None]:
    return [None if (value := getattr(row, name)) == math.inf else value for name in ROW_FIELDS]
