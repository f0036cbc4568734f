"""The plan of all nodes as a message, and the bounds of what it may ask of a publisher."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy

from arpd.model.plan import MOST_GENERATION, TopicPlan
from arpd.ros.documents import pack, unpack
from arpd.ros.names import INFINITE_NS, LEAST_DEADLINE_NS, MOST_LEASE_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from arpd.model.endpoints import WriterQos

MOST_BYTES = 1 << 20  # of its text; a thousand topics take a tenth of it
#: The last plan is kept for nodes that start later.
PLAN_QOS = QoSProfile(
    depth=1, reliability=QoSReliabilityPolicy.RELIABLE, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL
)
MOST_DEPTH = 5000
#: Least and most of each number of a plan; each may be 0, too, and a depth of 0 is that of the application.
BOUNDS: dict[str, tuple[float, float]] = {
    "generation": (0, MOST_GENERATION),
    "lease_s": (5.0, MOST_LEASE_S),  # the price, which renews a lease, comes once a second, and may be lost
    "depth": (1, MOST_DEPTH),
    "deadline_ns": (LEAST_DEADLINE_NS, INFINITE_NS),
    "rate_hz": (0.0, 1e6),
    "min_rate_hz": (0.0, 1e6),
    "weight": (1e-6, 1e6),
    "wire_bytes": (1.0, 1e12),  # the largest sample there is, to a thousand readers
    "packets": (0, 10**9),
    "max_rate_hz": (0.0, 1e6),
}
ROW = tuple(BOUNDS)[2:]  # fields of a row, in their order


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
    rows = {
        topic: [None if (value := getattr(row, name)) == math.inf else value for name in ROW]
        for topic, row in sorted(topics.items())
    }
    return pack({"generation": generation, "lease_s": lease_s, "rows": rows})


def decode_plan(data: bytes) -> PlanMessage:
    """Read a plan; raises ValueError, which names the fault, also where generation or lease is out of bounds."""
    document = unpack(data, most_bytes=MOST_BYTES)
    rows = document.get("rows")
    if not isinstance(rows, dict):
        raise ValueError("a plan without rows")  # noqa: TRY004 - a message may hold anything, so it is no type error
    return PlanMessage(rows=rows, **{name: checked(name, document.get(name)) for name in ("generation", "lease_s")})


def checked_row(topic: str, row: Any, own: WriterQos) -> TopicPlan:
    """Return the row of a plan message for a publisher whose application chose ``own``.

    Raises ValueError, which names topic and field, if a value is missing or out of bounds.
    """
    if not isinstance(row, list) or len(row) != len(ROW):
        raise ValueError(f"{topic}: {str(row)[:80]!r} has not the numbers {', '.join(ROW)}")
    if row[0] == 0:  # see `TopicPlan`
        row = [own.depth, own.deadline_ns, *row[2:]]
    try:
        given = {name: checked(name, value, own) for name, value in zip(ROW, row, strict=True)}
    except ValueError as fault:
        raise ValueError(f"{topic}: {fault}") from fault
    return TopicPlan(**given)


def checked(name: str, value: Any, own: WriterQos | None = None) -> Any:
    """Return a number of a plan within its bounds; the application's own depth and deadline always are.

    Raises ValueError, which names the field, if it is out of bounds.
    """
    if name in {"rate_hz", "max_rate_hz"} and value is None:
        return math.inf
    least, most = BOUNDS[name]
    is_whole = type(most) is int
    if type(value) is int or (type(value) is float and not is_whole):
        if (least <= value <= most) or (value == 0 and name != "depth"):
            return (0 if value == INFINITE_NS else value) if is_whole else float(value)
        if value == getattr(own, name, None):
            return value
    kind, zero = "an integer" if is_whole else "a number", "" if name == "depth" else ", or 0"
    raise ValueError(f"{name} = {str(value)[:40]!r} is not {kind} from {least:g} to {most:g}{zero}")
