"""How far a plan has come, by what nodes tell."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable

    from arpd.model.endpoints import PublisherState
    from arpd.model.plan import QosPlan, TopicPlan

_SIX_DIGITS = 1e-4  # rates and leases are told so


class Progress(NamedTuple):
    """Nodes that do not show a plan, or whose publishers do not show their rows; publishers that show their row."""

    missing: frozenset[str] = frozenset()
    confirmed: int = 0


def progress(publishers: Iterable[PublisherState], plan: QosPlan, *, lease_s: float = 0.0) -> Progress:
    """Return how far a plan has come; publishers without a row do not count.

    No snapshot shows the terms of the price. They are in force where the plan's generation is.

    Parameters
    ----------
    lease_s : silence after which nodes return to their own QoS, 0 = never (s)
    """
    missing, confirmed = set(), 0
    for publisher in publishers:
        if (row := plan.topics.get(publisher.topic)) is None:
            continue
        has_row = is_confirmed(publisher, row)
        confirmed += has_row
        has_lease = math.isclose(publisher.lease_s, lease_s, rel_tol=_SIX_DIGITS)
        if not (has_row and has_lease and publisher.generation == plan.generation):
            missing.add(publisher.node)
    return Progress(frozenset(missing), confirmed)


def is_confirmed(publisher: PublisherState, row: TopicPlan) -> bool:
    """Return whether a publisher shows the row in force.

    A publisher that refuses new QoS for good is confirmed by its ceiling: it is paced, and takes no more.
    """
    if not math.isclose(publisher.rate_hz, row.rate_hz, rel_tol=_SIX_DIGITS):
        return False
    depth, deadline_ns = publisher.qos_by(row)
    has_depth = publisher.keeps_all or publisher.depth == depth
    return publisher.refusal_reason.is_lasting or (has_depth and publisher.deadline_ns == deadline_ns)
