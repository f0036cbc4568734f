"""How far a plan has come: which nodes must be asked for their rows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from arpd.apply.transitions import has_lease, is_confirmed
from arpd.model.plan import Transition

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.model.endpoints import PublisherState
    from arpd.model.plan import QosPlan, TopicPlan

_Identity = tuple[str, str]  # node and topic


class _Ask(NamedTuple):
    generation: int
    terms: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Steps:
    """Transitions to send now, and the progress of the plan.

    Invariant: any prefix of the steps leaves every publisher in its old or its new row. Their order does not matter to
    the link, because the rates follow its price.

    Parameters
    ----------
    transitions : all rows of each node that has something to do, repeated until its publishers announce them
    confirmed : publishers that need nothing more
    """

    transitions: tuple[Transition, ...]
    confirmed: int


class Progress:
    """Brings publishers to a plan: a node is asked for all its rows until it announces each.

    No announcement shows the terms of the price. So a publisher has those of a plan whose generation it announces, and
    those it was asked for since.
    """

    def __init__(self) -> None:
        self._asked: dict[_Identity, _Ask] = {}
        self._done: tuple[tuple[Sequence[PublisherState], QosPlan, float], Steps] | None = None

    def steps(self, *, publishers: Sequence[PublisherState], plan: QosPlan, reason: str, lease_s: float = 0.0) -> Steps:
        """Return the steps that may be taken now; called at every whole turn.

        Parameters
        ----------
        publishers : all live ones
        plan : their rows; those without a row are left alone
        reason : cause of the plan, in words
        lease_s : silence after which nodes return to their own QoS, 0 = never (s)
        """
        if self._done is not None:
            (before, its_plan, its_lease_s), steps = self._done
            if publishers is before and plan is its_plan and lease_s == its_lease_s:
                return steps
        live = {(publisher.node, publisher.topic) for publisher in publishers}
        self._asked = {identity: ask for identity, ask in self._asked.items() if identity in live}
        rows = [(publisher, row) for publisher in publishers if (row := plan.topics.get(publisher.topic)) is not None]
        nodes = {
            publisher.node
            for publisher, row in rows
            if not self._is_settled(publisher, row, generation=plan.generation, lease_s=lease_s)
        }
        asked: dict[str, dict[str, TopicPlan]] = {}
        for publisher, row in rows:
            if publisher.node in nodes:
                self._asked[publisher.node, publisher.topic] = _Ask(plan.generation, row.terms)
                asked.setdefault(publisher.node, {})[publisher.topic] = row
        step = partial(Transition, generation=plan.generation, reason=reason, lease_s=lease_s)
        steps = Steps(
            transitions=tuple(step(node=node, topics=topics) for node, topics in sorted(asked.items())),
            confirmed=sum(is_confirmed(publisher, row) for publisher, row in rows),
        )
        self._done = None if steps.transitions else ((publishers, plan, lease_s), steps)
        return steps

    def _is_settled(self, publisher: PublisherState, row: TopicPlan, *, generation: int, lease_s: float) -> bool:
        """Return whether a publisher is known to have its row, with all terms."""
        ask = self._asked.get((publisher.node, publisher.topic))
        # A predecessor's terms are unknown, even where its QoS is the planned one; and who has no plan has no terms.
        known = row.terms if publisher.generation == generation else ()
        if ask is not None:
            known = ask.terms if publisher.generation or not generation else ()
            if publisher.generation < ask.generation:
                return False
        return known == row.terms and is_confirmed(publisher, row) and has_lease(publisher, lease_s)
