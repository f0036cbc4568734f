"""Events of publishers: topics that come and go, writer swaps, refusals."""

from __future__ import annotations

import math
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

from arpd.model.endpoints import RefusalReason, SwapPhase
from arpd.model.link import LinkState
from arpd.model.quantities import format_duration, format_number
from arpd.report.events import EventKind, Said, Severity
from arpd.report.wording import count, deadline, listed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from arpd.model.endpoints import PublisherState, SwapRecord
    from arpd.report.snapshot import Snapshot

_QUIET_S = 2.0  # a node brings its topics one after the other
_LONGEST_S = 10.0  # an event waits no longer, though topics keep coming
_TOGETHER_S = 1.5  # publishers announce once a second, each at another time
_LOST_S = 2.0
_AFTER_OUTAGE_S = 10.0  # by then publishers across the link have announced themselves again
_MOST_ALONE = 3  # a larger batch is one event

_Identity = tuple[str, str]  # node and topic
_FACTS = attrgetter("node", "topic", "refusal_reason", "last_swap")

# Results of a swap that kept the old writer, in words; a refusal of the publisher says more.
_KEPT = {
    "unmatched": "its readers did not take the new writer in time",
    "incompatible": "a reader would have been lost to the new QoS",
    "failed": "the middleware refused the new writer",
}
_FAILED_CHANGES = frozenset({RefusalReason.UNMATCHED, RefusalReason.INCOMPATIBLE, RefusalReason.FAILED})


class EndpointLog:
    """Publishers; costs little while none of them announces anything new."""

    def __init__(self) -> None:
        self._facts: list[tuple[object, ...]] = []
        self._topics = _TopicLog()
        self._swaps = _SwapLog()
        self._refusals = _RefusalLog()

    def follow(self, snapshot: Snapshot) -> Iterator[Said]:
        """Return what happened since the snapshot before."""
        publishers = snapshot.observation.publishers
        facts: list[tuple[object, ...]] = [*map(_FACTS, publishers)]
        is_new, self._facts = facts != self._facts, facts
        if is_new:
            self._swaps.see(snapshot.finished_at_s, publishers)
            self._refusals.see(snapshot.finished_at_s, publishers)
        yield from self._topics.follow(snapshot, is_new=is_new)
        yield from self._refusals.due(snapshot.finished_at_s)
        yield from self._swaps.due(snapshot.finished_at_s)


class _TopicLog:
    """Topics that come and go; one that returns within two seconds was never gone."""

    def __init__(self) -> None:
        self._node_of: dict[str, str] = {}  # topic → a node that publishes it
        self._known: set[str] = set()
        self._found: dict[str, float] = {}  # since when (s)
        self._missed: dict[str, float] = {}
        self._out_at_s = -math.inf

    def follow(self, snapshot: Snapshot, *, is_new: bool) -> Iterator[Said]:
        now_s = snapshot.finished_at_s
        if snapshot.link.state is LinkState.OUTAGE:
            self._out_at_s = now_s
        if is_new:
            here = {publisher.topic: publisher.node for publisher in snapshot.observation.publishers}
            self._node_of.update(here)
            self._found = {topic: self._found.get(topic, now_s) for topic in here if topic not in self._known}
            self._missed = {topic: self._missed.get(topic, now_s) for topic in self._known if topic not in here}
        if self._found and _is_due(now_s, self._found.values()):
            found, self._found = sorted(self._found), {}
            self._known.update(found)
            yield self._tell(EventKind.TOPIC_FOUND, found, "found", "publishes it")
        is_heard = now_s - self._out_at_s >= _AFTER_OUTAGE_S
        if self._missed and is_heard and now_s - max(self._missed.values()) >= _LOST_S:
            lost, self._missed = sorted(self._missed), {}
            self._known.difference_update(lost)
            yield self._tell(EventKind.TOPIC_LOST, lost, "lost", "no longer announces it")
            self._node_of = {
                topic: node for topic, node in self._node_of.items() if topic in self._known or topic in self._found
            }

    def _tell(self, kind: EventKind, topics: list[str], word: str, alone: str) -> Said:
        if len(topics) > 1:
            text = f"{count(len(topics), 'topic')} {word}: {listed(topics)}"
            return Said(kind, Severity.INFO, text, details={"topics": str(len(topics))})
        node = self._node_of[topics[0]]
        text = f"{topics[0]} {word}: {node} {alone}"
        return Said(kind, Severity.INFO, text, topic=topics[0], node=node, details={"topics": "1"})


class _Swap(NamedTuple):
    node: str
    topic: str
    record: SwapRecord
    why: str


class _SwapLog:
    """Swaps that ended, by their numbers. The swaps of one plan end within a second or two of each other."""

    def __init__(self) -> None:
        self._numbers: dict[_Identity, int] = {}
        self._done: list[_Swap] = []
        self._kept: list[_Swap] = []
        self._since_s = math.inf

    def see(self, now_s: float, publishers: Iterable[PublisherState]) -> None:
        numbers: dict[_Identity, int] = {}
        for publisher in publishers:
            record, identity = publisher.last_swap, (publisher.node, publisher.topic)
            numbers[identity] = record.number if record is not None else 0
            # A swap that a new publisher brings along happened before this daemon saw it.
            if record is None or record.number == self._numbers.get(identity, record.number):
                continue
            swap = _Swap(publisher.node, publisher.topic, record, publisher.refusal)
            if record.result in {"ok", "reorder_possible"}:
                self._done.append(swap)
            elif record.result in _KEPT:
                self._kept.append(swap)
            self._since_s = min(self._since_s, now_s)
        self._numbers = numbers

    def due(self, now_s: float) -> Iterator[Said]:
        if now_s - self._since_s < _TOGETHER_S:
            return
        self._since_s = math.inf
        done, self._done, kept, self._kept = self._done, [], self._kept, []
        yield from self._tell(done, EventKind.WRITER_REPLACED, Severity.INFO, _swapped, "swapped")
        yield from self._tell(kept, EventKind.WRITER_KEPT, Severity.WARNING, _not_swapped, "not swapped")

    @staticmethod
    def _tell(
        swaps: list[_Swap], kind: EventKind, severity: Severity, alone: Callable[[_Swap], str], together: str
    ) -> Iterator[Said]:
        swaps.sort(key=lambda swap: (swap.topic, swap.node))
        if len(swaps) <= _MOST_ALONE:
            for swap in swaps:
                yield Said(kind, severity, alone(swap), swap.topic, swap.node, _swap_details(swap.record))
            return
        took_s = [_total_s(swap.record) for swap in swaps]
        least, most = format_number(min(took_s)), format_number(max(took_s))
        took = f"{most} s" if least == most else f"{least} to {most} s"
        yield Said(
            kind,
            severity,
            f"{count(len(swaps), 'publisher')} {together} in {took}: {listed([swap.topic for swap in swaps])}",
            details={"publishers": str(len(swaps)), "seconds": f"{max(took_s):.3f}"},
        )


def _swapped(swap: _Swap) -> str:
    record = swap.record
    phases = ", ".join(
        f"{phase} {seconds:.1f}"
        for phase, seconds in record.seconds_by_phase.items()
        if seconds >= 0.05 and phase != SwapPhase.DRAINING
    )
    order = "; samples may have arrived out of order" if record.result == "reorder_possible" else ""
    took = f" in {format_duration(_total_s(record))}" if record.seconds_by_phase else ""
    return (
        f"{swap.topic} swapped to depth {record.depth}, {deadline(record.deadline_ns)}{took}"
        + (f" ({phases})" if phases else "")
        + order
    )


def _not_swapped(swap: _Swap) -> str:
    record = swap.record
    why = swap.why or _KEPT[record.result]
    return f"{swap.topic} kept its writer, not swapped to depth {record.depth}, {deadline(record.deadline_ns)}: {why}"


def _swap_details(record: SwapRecord) -> dict[str, str]:
    return {
        "result": record.result,
        "depth": str(record.depth),
        "deadline_ns": str(record.deadline_ns),
        "seconds": f"{_total_s(record):.3f}",
        **{f"{phase}_seconds": f"{seconds:.3f}" for phase, seconds in record.seconds_by_phase.items()},
    }


def _total_s(record: SwapRecord) -> float:
    """Return the time from begin to result (s); the old writer drains beside the new one and does not count."""
    return sum(seconds for phase, seconds in record.seconds_by_phase.items() if phase != SwapPhase.DRAINING)


class _Refused(NamedTuple):
    node: str
    topic: str
    reason: RefusalReason
    words: str


class _RefusalLog:
    """Refusals, each reason once per publisher; a refused swap is an event of its own kind."""

    def __init__(self) -> None:
        self._told: dict[_Identity, frozenset[RefusalReason]] = {}
        self._new: list[_Refused] = []
        self._since_s = math.inf

    def see(self, now_s: float, publishers: Iterable[PublisherState]) -> None:
        told: dict[_Identity, frozenset[RefusalReason]] = {}
        for publisher in publishers:
            identity = publisher.node, publisher.topic
            reasons = self._told.get(identity, frozenset())
            reason = publisher.refusal_reason
            if reason is not RefusalReason.NONE and reason not in reasons and not _is_of_a_swap(publisher):
                reasons |= {reason}
                self._new.append(_Refused(publisher.node, publisher.topic, reason, publisher.refusal))
                self._since_s = min(self._since_s, now_s)
            if reasons:
                told[identity] = reasons
        self._told = told

    def due(self, now_s: float) -> Iterator[Said]:
        if now_s - self._since_s < _TOGETHER_S:
            return
        self._since_s = math.inf
        by_reason: dict[RefusalReason, list[_Refused]] = {}
        for refused in self._new:
            by_reason.setdefault(refused.reason, []).append(refused)
        self._new = []
        for reason, all_of_them in by_reason.items():
            if len(all_of_them) <= _MOST_ALONE:
                for one in all_of_them:
                    text = f"{one.topic} refuses: {one.words}"
                    yield Said(EventKind.REFUSED, Severity.WARNING, text, one.topic, one.node, {"reason": str(reason)})
                continue
            topics = sorted({one.topic for one in all_of_them})
            text = f"{listed(topics)} {'refuse' if len(topics) > 1 else 'refuses'}: {all_of_them[0].words}"
            details = {"reason": str(reason), "publishers": str(len(all_of_them))}
            yield Said(EventKind.REFUSED, Severity.WARNING, text, details=details)


def _is_of_a_swap(publisher: PublisherState) -> bool:
    return publisher.refusal_reason in _FAILED_CHANGES and publisher.last_swap is not None


def _is_due(now_s: float, since_s: Iterable[float]) -> bool:
    times = list(since_s)
    return now_s - max(times) >= _QUIET_S or now_s - min(times) >= _LONGEST_S
