"""Events of swaps: publishers that have new QoS, or keep theirs, and why."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.model.endpoints import PublisherState, RefusalReason, SwapRecord
from arpd.model.quantities import format_duration, format_period
from arpd.report.conditions import Event, Happening, Severity
from arpd.report.wording import count, listed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from arpd.report.snapshot import Snapshot

_MOST_ALONE = 3  # more publishers that announce the same between two looks are one event

# Results of a swap that kept the old writer, in words; a refusal of the publisher says more.
_KEPT = {
    "unmatched": "its readers did not take the new writer in time",
    "incompatible": "a reader cannot accept the new QoS",
    "failed": "the middleware refused the new writer",
}
_FAILED_CHANGES = frozenset({RefusalReason.UNMATCHED, RefusalReason.INCOMPATIBLE, RefusalReason.FAILED})


class SwapLog:
    """Swaps that ended, by their numbers, and refusals, each reason once per publisher."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[str, str], int] = {}  # by node and topic
        self._refused: dict[tuple[str, str], set[RefusalReason]] = {}

    def follow(self, snapshot: Snapshot) -> Iterator[Event]:
        """Return what happened since the snapshot before."""
        publishers = snapshot.observation.publishers
        told = sorted(
            (event for publisher in publishers for event in self._of(publisher)),
            key=lambda event: (event.topic, event.node),
        )
        here = {(publisher.node, publisher.topic) for publisher in publishers}
        self._numbers = {identity: self._numbers[identity] for identity in here}
        self._refused = {identity: reasons for identity, reasons in self._refused.items() if identity in here}
        for severity, what in ((Severity.INFO, "swapped"), (Severity.WARNING, "keep their QoS")):
            alike = [event for event in told if event.severity is severity]
            if len(alike) > _MOST_ALONE:
                text = f"{count(len(alike), 'publisher')} {what}: {listed([event.topic for event in alike])}"
                alike = [Event(Happening.SWAP, severity, text, details={"publishers": str(len(alike))})]
            yield from alike

    def _of(self, publisher: PublisherState) -> Iterator[Event]:
        identity, record, reason = (publisher.node, publisher.topic), publisher.last_swap, publisher.refusal_reason
        number = record.number if record is not None else 0
        # A swap that a new publisher brings along happened before this daemon saw it.
        before, self._numbers[identity] = self._numbers.get(identity, number), number
        if record is not None and number != before and (text := _ended(publisher, record)):
            severity = Severity.WARNING if record.result in _KEPT else Severity.INFO
            yield _event(publisher, severity, text, _details(record))
        reasons = self._refused.setdefault(identity, {RefusalReason.NONE})
        is_of_a_swap = reason in _FAILED_CHANGES and record is not None  # whose event has it
        if reason not in reasons and not is_of_a_swap:
            reasons.add(reason)
            text = f"{publisher.topic} keeps its QoS: {publisher.refusal}"
            yield _event(publisher, Severity.WARNING, text, {"result": str(reason)})


def _event(publisher: PublisherState, severity: Severity, text: str, details: dict[str, str]) -> Event:
    return Event(Happening.SWAP, severity, text, publisher.topic, publisher.node, details)


def _ended(publisher: PublisherState, record: SwapRecord) -> str:
    deadline = f"deadline {format_period(record.deadline_ns)}" if record.deadline_ns else "no deadline"
    asked = f"depth {record.depth}, {deadline}"
    if record.result in _KEPT:
        return f"{publisher.topic} keeps its QoS, not {asked}: {publisher.refusal or _KEPT[record.result]}"
    if record.result not in {"ok", "reorder_possible"}:
        return ""
    took_s = record.seconds_by_phase
    phases = ", ".join(f"{phase} {seconds:.1f}" for phase, seconds in took_s.items() if seconds >= 0.05)
    took = f" in {format_duration(sum(took_s.values()))}" if took_s else ""
    order = "; samples may have arrived out of order" if record.result == "reorder_possible" else ""
    return f"{publisher.topic} swapped to {asked}{took}" + (f" ({phases})" if phases else "") + order


def _details(record: SwapRecord) -> dict[str, str]:
    return {
        "result": record.result,
        "depth": str(record.depth),
        "deadline_ns": str(record.deadline_ns),
        "seconds": f"{sum(record.seconds_by_phase.values()):.3f}",
        **{f"{phase}_seconds": f"{seconds:.3f}" for phase, seconds in record.seconds_by_phase.items()},
    }
