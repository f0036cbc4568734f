"""The order in which the writers and readers of a topic take a plan, so that no pair of them disconnects."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from arpd.apply.readers import is_reader_confirmed
from arpd.apply.transitions import has_lease, is_confirmed
from arpd.model.plan import ReaderPlan, TopicPlan, Transition

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from arpd.model.endpoints import PublisherState, ReaderState
    from arpd.model.plan import QosPlan, ReaderPlans

PATIENCE_S = 10.0  # a reader swap takes at most 7 s, and its announcement comes within another second

_MOST_ASKED = 64

_Identity = tuple[str, str]  # node and topic
E = TypeVar("E", "PublisherState", "ReaderState")
R = TypeVar("R", TopicPlan, ReaderPlan)


_settings_of = attrgetter("generation", "depth", "deadline_ns", "rate_hz", "lease_s", "refusal_reason", "keeps_all")


class _Ask(NamedTuple):
    generation: int
    deadline_ns: int


class _Asked(NamedTuple):
    """All that the steps depend on, when nobody waits."""

    publishers: Sequence[PublisherState]
    readers: Sequence[ReaderState]
    plan: QosPlan
    reader_plans: ReaderPlans
    lease_s: float

    def is_same_as(self, other: _Asked) -> bool:
        """Return whether nothing changed; endpoints that did not change are the same objects."""
        return (
            self.publishers is other.publishers
            and self.readers is other.readers
            and self.plan is other.plan
            and self.lease_s == other.lease_s
            and self.reader_plans == other.reader_plans
        )


class _WriterRow(NamedTuple):
    """A row that a writer may have now.

    Parameters
    ----------
    is_settled : whether it is known to have it, with all terms
    is_in_force : whether it announces it, and it is all of its plan
    """

    state: PublisherState
    row: TopicPlan
    is_settled: bool
    is_in_force: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Steps:
    """Transitions to send now, and the progress of the plan.

    Invariant: any prefix of the steps leaves every publisher in its old or its new row. Their order does not matter to
    the link, because the rates follow its price.

    Parameters
    ----------
    transitions : all rows of each node that has something to do, one for its publishers and one for its readers;
        repeated until the endpoints announce them
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

    def due(self, rows: Iterable[tuple[E, R, bool]]) -> set[str]:
        """Return the nodes of which something is to be asked now.

        Parameters
        ----------
        rows : endpoints, the row of each, and whether it is known to be in force
        """
        return {state.node for state, _, is_settled in rows if not is_settled or self._is_unanswered(state)}

    def ask(
        self, rows: Iterable[tuple[E, R, bool]], nodes: Collection[str], generation: int
    ) -> dict[str, dict[str, R]]:
        """Return all rows of these nodes, and remember them: from now on each may be in force."""
        asked: dict[str, dict[str, R]] = {}
        for state, row, _ in rows:
            if state.node in nodes:
                self._remember((state.node, state.topic), _Ask(generation, row.deadline_ns))
                asked.setdefault(state.node, {})[state.topic] = row
        return asked

    @property
    def is_waiting(self) -> bool:
        """True while an endpoint waits for the other side."""
        return bool(self._waiting)

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
        self._settled: dict[_Identity, tuple[object, ...]] = {}  # what publishers without readers told when settled
        self._done: tuple[_Asked, Steps] | None = None  # the last call, if it left nothing to do and nobody waiting

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
        """Return the steps that may be taken now; called at every whole turn.

        Parameters
        ----------
        now_s : monotonic clock (s)
        publishers, readers : all live ones
        plan, reader_plans : rows for publishers and for readers; readers without a row are left alone
        reason : cause of the plan, in words
        lease_s : silence after which nodes return to their own QoS, 0 = never (s)
        """
        asked = _Asked(publishers, readers, plan, reader_plans, lease_s)
        if self._done is not None and asked.is_same_as(self._done[0]):
            return self._done[1]
        generation = plan.generation
        self._writers.hear(publishers)
        self._readers.hear(readers)
        if len(self._silent) > len(publishers):
            live = {(publisher.node, publisher.topic) for publisher in publishers}
            self._silent = {identity: terms for identity, terms in self._silent.items() if identity in live}
            self._settled = {identity: known for identity, known in self._settled.items() if identity in live}
        driven = [reader for reader in readers if (reader.node, reader.topic) in reader_plans]
        readers_of, writers_of = _by_topic(driven), _by_topic(publishers)
        writer_rows = [
            self._judge(
                publisher,
                row,
                readers_of.get(publisher.topic, ()),
                reader_plans,
                now_s=now_s,
                generation=generation,
                lease_s=lease_s,
            )
            for publisher in publishers
            if (row := plan.topics.get(publisher.topic)) is not None
        ]
        reader_rows = [
            (reader, target)
            for reader in driven
            if (target := self._reader_row(now_s, reader, writers_of.get(reader.topic, ()), reader_plans)) is not None
        ]
        for_readers = [
            (reader, row, is_reader_confirmed(reader, row) and has_lease(reader, lease_s))
            for reader, row in reader_rows
        ]
        for_writers = [(state, row, is_settled) for state, row, is_settled, _ in writer_rows]
        nodes = self._writers.due(for_writers) | self._readers.due(for_readers)
        to_writers = self._writers.ask(for_writers, nodes, generation)
        to_readers = self._readers.ask(for_readers, nodes, generation)
        step = partial(Transition, generation=generation, reason=reason, lease_s=lease_s)
        steps = Steps(
            transitions=(
                *(step(node=node, topics=rows) for node, rows in sorted(to_writers.items())),
                *(step(node=node, topics={}, readers=rows) for node, rows in sorted(to_readers.items())),
            ),
            confirmed=sum(is_in_force for *_, is_in_force in writer_rows),
            readers_confirmed=sum(is_reader_confirmed(reader, row) for reader, row in reader_rows),
        )
        is_done = not (steps.transitions or self._writers.is_waiting or self._readers.is_waiting)
        self._done = (asked, steps) if is_done else None
        return steps

    def _judge(
        self,
        publisher: PublisherState,
        planned: TopicPlan,
        readers: Sequence[ReaderState],
        reader_plans: ReaderPlans,
        *,
        now_s: float,
        generation: int,
        lease_s: float,
    ) -> _WriterRow:
        """Return the row a writer may have now, and whether it has it."""
        identity = publisher.node, publisher.topic
        told = planned, generation, lease_s, _settings_of(publisher)
        if not readers and self._settled.get(identity) == told:
            return _WriterRow(publisher, planned, is_settled=True, is_in_force=True)
        row, is_held = self._writer_row(now_s, publisher, planned, readers, reader_plans)
        is_settled = self._is_settled(publisher, row, generation, lease_s)
        if is_settled and not is_held and not readers:
            self._settled[identity] = told
        return _WriterRow(publisher, row, is_settled, not is_held and (is_settled or is_confirmed(publisher, row)))

    def _is_settled(self, publisher: PublisherState, row: TopicPlan, generation: int, lease_s: float) -> bool:
        """Return whether a publisher is known to have a row, which counts as its last request now."""
        identity = publisher.node, publisher.topic
        # A predecessor's terms are unknown, even where its QoS is the planned one; and who has no plan has no terms.
        known = self._silent.get(identity, row.terms if publisher.generation == generation else ())
        if publisher.generation == 0 < generation:
            known = ()
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
        return _with_deadline(row, min(wanted, longest)), False

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
        return _with_deadline(row, max(_period(row.deadline_ns), shortest))


def _by_topic(states: Iterable[E]) -> dict[str, list[E]]:
    found: dict[str, list[E]] = {}
    for state in states:
        found.setdefault(state.topic, []).append(state)
    return found


def _with_deadline(row: R, period: float) -> R:
    deadline_ns = _nanoseconds(period)
    return row if row.deadline_ns == deadline_ns else replace(row, deadline_ns=deadline_ns)


def _period(deadline_ns: int) -> float:
    """Return a deadline as a number to compare: none is infinite (ns)."""
    return deadline_ns or math.inf


def _nanoseconds(period: float) -> int:
    return 0 if math.isinf(period) else int(period)
