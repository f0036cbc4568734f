"""The order in which the writers and readers of a topic take a plan, so that no pair of them disconnects."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from arpd.apply.readers import is_reader_confirmed
from arpd.apply.transitions import has_lease, is_confirmed
from arpd.model.plan import ReaderPlan, TopicPlan, Transition

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from arpd.model.endpoints import PublisherState, ReaderState
    from arpd.model.plan import QosPlan, ReaderPlans

PATIENCE_S = 10.0  # a reader swap takes at most 7 s, and its announcement comes within another second

_MOST_ASKED = 64

_Identity = tuple[str, str]  # node and topic
E = TypeVar("E", "PublisherState", "ReaderState")
R = TypeVar("R", TopicPlan, ReaderPlan)


class _Ask(NamedTuple):
    generation: int
    deadline_ns: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Steps:
    """Transitions to send now, and the progress of the plan.

    Invariant: any prefix of the steps leaves every publisher in its old or its new row. Their order does not matter to
    the link, because the rates follow its price.

    Parameters
    ----------
    transitions : one per node and kind of endpoint; repeated until the endpoints announce them
    confirmed, readers_confirmed : publishers and readers that need nothing more
    """

    transitions: tuple[Transition, ...]
    confirmed: int
    readers_confirmed: int


class _Side:
    """All endpoints of one kind: the requests to each, and the time since which it waits for the other kind."""

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._asked: dict[_Identity, list[_Ask]] = {}
        self._waiting_since_s: dict[_Identity, float] = {}
        self._waiting: dict[_Identity, float] = {}

    def hear(self, states: Iterable[PublisherState | ReaderState]) -> None:
        """Forget requests that can no longer come into force: a node refuses plans older than the one it announces."""
        announced = {(state.node, state.topic): state.generation for state in states}
        self._asked = {
            identity: [ask for ask in asks if ask.generation >= announced[identity]]
            for identity, asks in self._asked.items()
            if identity in announced
        }
        self._waiting_since_s, self._waiting = self._waiting, {}

    def due(self, rows: Iterable[tuple[E, R, bool]], generation: int) -> list[tuple[str, dict[str, R]]]:
        """Return the rows to request now, by node, and remember them: from now on each may be in force.

        Parameters
        ----------
        rows : endpoints, the row of each, and whether it is known to be in force
        """
        due: dict[str, dict[str, R]] = {}
        for state, row, is_settled in rows:
            if not is_settled or self._is_unanswered(state):
                self._remember((state.node, state.topic), _Ask(generation, row.deadline_ns))
                due.setdefault(state.node, {})[state.topic] = row
        return sorted(due.items())

    def _remember(self, identity: _Identity, ask: _Ask) -> None:
        others = [known for known in self._asked.get(identity, ()) if known.deadline_ns != ask.deadline_ns]
        self._asked[identity] = [*others[-_MOST_ASKED:], ask]

    def _is_unanswered(self, state: PublisherState | ReaderState) -> bool:
        """Return whether an endpoint does not yet announce the last request."""
        asks = self._asked.get((state.node, state.topic))
        if not asks or (state.refusal_reason.is_lasting and state.generation >= asks[-1].generation):
            return False
        return state.generation < asks[-1].generation or state.deadline_ns != asks[-1].deadline_ns

    def periods(self, state: PublisherState | ReaderState) -> list[float]:
        """Return every period that may be in force (ns)."""
        asks = self._asked.get((state.node, state.topic), ())
        return [_period(state.deadline_ns), *(_period(ask.deadline_ns) for ask in asks)]

    def is_patient(self, state: PublisherState | ReaderState, now_s: float) -> bool:
        """Return whether an endpoint goes on waiting for the other side."""
        identity = state.node, state.topic
        since_s = self._waiting[identity] = self._waiting_since_s.get(identity, now_s)
        return now_s - since_s <= self._patience_s


class Ordering:
    """Brings publishers and readers to a plan: readers relax their deadlines before writers, and tighten them after.

    A reader hears a writer only while the offered period is no longer than the requested one. The daemon does not know
    exactly which period an endpoint has: the announced one, or any it was asked for since. So it never asks a writer
    for a longer period than the shortest that a reader may request now, and never asks a reader for a shorter one than
    the longest that a writer it hears may offer.

    Invariant: no order of answers makes a compatible pair incompatible.

    Ceilings and terms of the price wait for nobody. Depth waits with the deadline, because each change costs a new
    writer or reader. Nobody waits longer than ``patience_s``. Then the writer offers what the slowest reader still
    requests, or the reader requests what the slowest writer still offers, until the other side answers.

    Parameters
    ----------
    patience_s : longest time that one side waits for the other (s)
    """

    def __init__(self, *, patience_s: float = PATIENCE_S) -> None:
        self._writers, self._readers = _Side(patience_s), _Side(patience_s)
        self._silent: dict[_Identity, tuple[float, ...]] = {}  # last requests of what no announcement shows

    def steps(
        self,
        now_s: float,
        *,
        publishers: Sequence[PublisherState],
        readers: Sequence[ReaderState],
        plan: QosPlan,
        reader_plans: ReaderPlans,
        reason: str,
        lease_s: float = 0.0,
    ) -> Steps:
        """Return the steps that may be taken now; called at every tick.

        Parameters
        ----------
        now_s : monotonic clock (s)
        publishers, readers : all live ones
        plan, reader_plans : rows for publishers and for readers; readers without a row are left alone
        reason : cause of the plan, in words
        lease_s : silence after which nodes return to their own QoS, 0 = never (s)
        """
        self._writers.hear(publishers)
        self._readers.hear(readers)
        live = {(publisher.node, publisher.topic) for publisher in publishers}
        self._silent = {identity: terms for identity, terms in self._silent.items() if identity in live}
        driven = [reader for reader in readers if (reader.node, reader.topic) in reader_plans]
        readers_of, writers_of = _by_topic(driven), _by_topic(publishers)
        writer_rows = [
            (publisher, *self._writer_row(now_s, publisher, row, readers_of.get(publisher.topic, ()), reader_plans))
            for publisher in publishers
            if (row := plan.topics.get(publisher.topic)) is not None
        ]
        reader_rows = [
            (reader, target)
            for reader in driven
            if (target := self._reader_row(now_s, reader, writers_of.get(reader.topic, ()), reader_plans)) is not None
        ]
        to_writers = self._writers.due(
            (
                (publisher, row, self._is_settled(publisher, row, plan.generation, lease_s))
                for publisher, row, _ in writer_rows
            ),
            plan.generation,
        )
        to_readers = self._readers.due(
            (
                (reader, row, is_reader_confirmed(reader, row) and has_lease(reader, lease_s))
                for reader, row in reader_rows
            ),
            plan.generation,
        )
        step = partial(Transition, generation=plan.generation, reason=reason, lease_s=lease_s)
        return Steps(
            transitions=(
                *(step(node=node, topics=rows) for node, rows in to_writers),
                *(step(node=node, topics={}, readers=rows) for node, rows in to_readers),
            ),
            confirmed=sum(not is_held and is_confirmed(publisher, row) for publisher, row, is_held in writer_rows),
            readers_confirmed=sum(is_reader_confirmed(reader, row) for reader, row in reader_rows),
        )

    def _is_settled(self, publisher: PublisherState, row: TopicPlan, generation: int, lease_s: float) -> bool:
        """Return whether a publisher is known to have a row, which counts as its last request now."""
        identity = publisher.node, publisher.topic
        # A predecessor's terms are unknown, even where its QoS is the planned one.
        known = self._silent.get(identity, row.terms if publisher.generation == generation else ())
        self._silent[identity] = row.terms
        return known == row.terms and is_confirmed(publisher, row) and has_lease(publisher, lease_s)

    def _writer_row(
        self,
        now_s: float,
        publisher: PublisherState,
        row: TopicPlan,
        readers: Sequence[ReaderState],
        reader_plans: ReaderPlans,
    ) -> tuple[TopicPlan, bool]:
        """Return the row a writer may have now, and whether the rest of its plan waits for readers."""
        # No reader will request more than its target, so waiting for a longer period would be in vain.
        targets = (_period(reader_plans[reader.node, reader.topic].deadline_ns) for reader in readers)
        wanted = min((_period(row.deadline_ns), *targets))
        requests = (
            period
            for reader in readers
            for period in (*self._readers.periods(reader), *map(_period, reader.requests_ns))
        )
        longest = min(requests, default=math.inf)
        if wanted > longest and self._writers.is_patient(publisher, now_s):
            kept = min(_period(publisher.deadline_ns), longest)
            return replace(row, depth=publisher.depth, deadline_ns=_nanoseconds(kept)), True
        return replace(row, deadline_ns=_nanoseconds(min(wanted, longest))), False

    def _reader_row(
        self, now_s: float, reader: ReaderState, writers: Iterable[PublisherState], reader_plans: ReaderPlans
    ) -> ReaderPlan | None:
        """Return the row a reader may have now, None while it waits for writers."""
        row = reader_plans[reader.node, reader.topic]
        offers = [period for writer in writers for period in self._writers.periods(writer)]
        # A writer that the reader does not hear even now cannot be lost.
        longest = max(self._readers.periods(reader))
        heard = (period for period in (*offers, *map(_period, reader.offers_ns)) if period <= longest)
        shortest = max(heard, default=0)
        if _period(row.deadline_ns) < shortest and self._readers.is_patient(reader, now_s):
            return None
        return replace(row, deadline_ns=_nanoseconds(max(_period(row.deadline_ns), shortest)))


def _by_topic(states: Iterable[E]) -> dict[str, list[E]]:
    found: dict[str, list[E]] = {}
    for state in states:
        found.setdefault(state.topic, []).append(state)
    return found


def _period(deadline_ns: int) -> float:
    """Return a deadline as a number to compare: none is infinite (ns)."""
    return deadline_ns or math.inf


def _nanoseconds(period: float) -> int:
    return 0 if math.isinf(period) else int(period)
