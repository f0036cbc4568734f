"""How far a plan has come, by what nodes tell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from arpd.model.endpoints import PublisherState
    from arpd.model.plan import QosPlan, TopicPlan


@dataclass(frozen=True, kw_only=True, slots=True)
class Progress:
    """How far a plan has come.

    Parameters
    ----------
    missing : nodes that do not show the plan, or whose publishers do not show their rows
    confirmed : publishers that show their row
    """

    missing: frozenset[str]
    confirmed: int


def progress(publishers: Iterable[PublisherState], plan: QosPlan, *, lease_s: float = 0.0) -> Progress:
    """Return how far a plan has come.

    No snapshot shows the terms of the price. They are in force where the plan's generation is.

    Parameters
    ----------
    publishers : all live ones; those without a row do not count
    lease_s : silence after which nodes return to their own QoS, 0 = never (s)
    """
    missing, confirmed = set(), 0
    for publisher in publishers:
        if (row := plan.topics.get(publisher.topic)) is None:
            continue
        has_row = is_confirmed(publisher, row)
        confirmed += has_row
        has_lease = math.isclose(publisher.lease_s, lease_s, rel_tol=1e-4)  # told with six digits, as rates are
        if not (has_row and has_lease and publisher.generation == plan.generation):
            missing.add(publisher.node)
    return Progress(missing=frozenset(missing), confirmed=confirmed)


def is_confirmed(publisher: PublisherState, row: TopicPlan) -> bool:
    """Return whether a publisher shows the row in force.

    A publisher that refuses new QoS for good is confirmed by its ceiling: it is paced, and takes no more.
    """
    if not (publisher.rate_hz == row.rate_hz or math.isclose(publisher.rate_hz, row.rate_hz, rel_tol=1e-4)):
        return False
    if publisher.refusal_reason.is_lasting:
        return True
    same_depth = publisher.keeps_all or publisher.depth == row.depth
    return same_depth and publisher.deadline_ns == row.deadline_ns
