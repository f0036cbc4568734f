"""Events of swaps: publishers that have new QoS, or keep theirs, and why."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from arpd.model.endpoints import RefusalReason
from arpd.model.quantities import format_duration, format_number
from arpd.report.conditions import Happening, Severity
from arpd.report.events import Event
from arpd.report.wording import count, deadline, listed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from arpd.model.endpoints import PublisherState, SwapRecord
    from arpd.report.snapshot import Snapshot

_TOGETHER_S = 1.5  # publishers announce once a second, each at another time
_MOST_ALONE = 3  # a larger batch is one event

_Identity = tuple[str, str]  # node and topic

# Results of a swap that kept the old writer, in words; a refusal of the publisher says more.
_KEPT = {
    "unmatched": "its readers did not take the new writer in time",
    "incompatible": "a reader cannot accept the new QoS",
    "failed": "the middleware refused the new writer",
}
_FAILED_CHANGES = frozenset({RefusalReason.UNMATCHED, RefusalReason.INCOMPATIBLE, RefusalReason.FAILED})


class _Outcome(NamedTuple):
    """One publisher's answer; those with the same ``together`` of one plan come within a second or two."""

    topic: str
    node: str
    together: str
    text: str
    details: dict[str, str]


class SwapLog:
    """Swaps that ended, by their numbers, and refusals, each reason once per publisher."""

    def __init__(self) -> None:
        self._numbers: dict[_Identity, int] = {}
        self._refused: dict[_Identity, frozenset[RefusalReason]] = {}
        self._waiting: list[_Outcome] = []
        self._since_s = math.inf

    def follow(self, snapshot: Snapshot) -> Iterator[Event]:
        """Return what happened since the snapshot before."""
        now_s, publishers = snapshot.finished_at_s, snapshot.observation.publishers
        new = [outcome for publisher in publishers for outcome in self._of(publisher)]
        here = {(publisher.node, publisher.topic) for publisher in publishers}
        self._numbers = {identity: self._numbers[identity] for identity in here}
        self._refused = {identity: reasons for identity, reasons in self._refused.items() if identity in here}
        if new:
            self._waiting += new
            self._since_s = min(self._since_s, now_s)
        if now_s - self._since_s < _TOGETHER_S:
            return
        waiting, self._waiting, self._since_s = sorted(self._waiting, key=lambda one: one[:2]), [], math.inf
        for together in dict.fromkeys(outcome.together for outcome in waiting):
            yield from _events([outcome for outcome in waiting if outcome.together == together])

    def _of(self, publisher: PublisherState) -> Iterator[_Outcome]:
        identity, record, reason = (publisher.node, publisher.topic), publisher.last_swap, publisher.refusal_reason
        number = record.number if record is not None else 0
        # A swap that a new publisher brings along happened before this daemon saw it.
        before, self._numbers[identity] = self._numbers.get(identity, number), number
        if record is not None and number != before and (text := _ended(publisher, record)):
            together = "keep their QoS" if record.result in _KEPT else "swapped"
            yield _Outcome(publisher.topic, publisher.node, together, text, _details(record))
        reasons = self._refused.get(identity, frozenset())
        is_of_a_swap = reason in _FAILED_CHANGES and record is not None  # whose event has it
        if reason is not RefusalReason.NONE and reason not in reasons and not is_of_a_swap:
            self._refused[identity] = reasons | {reason}
            text = f"{publisher.topic} keeps its QoS: {publisher.refusal}"
            yield _Outcome(publisher.topic, publisher.node, "keep their QoS", text, {"result": str(reason)})


def _ended(publisher: PublisherState, record: SwapRecord) -> str:
    asked = f"depth {record.depth}, {deadline(record.deadline_ns)}"
    if record.result in _KEPT:
        return f"{publisher.topic} keeps its QoS, not {asked}: {publisher.refusal or _KEPT[record.result]}"
    if record.result not in {"ok", "reorder_possible"}:
        return ""
    phases = ", ".join(
        f"{phase} {seconds:.1f}" for phase, seconds in record.seconds_by_phase.items() if seconds >= 0.05
    )
    order = "; samples may have arrived out of order" if record.result == "reorder_possible" else ""
    took = f" in {format_duration(sum(record.seconds_by_phase.values()))}" if record.seconds_by_phase else ""
    return f"{publisher.topic} swapped to {asked}{took}" + (f" ({phases})" if phases else "") + order


def _events(outcomes: list[_Outcome]) -> Iterator[Event]:
    severity = Severity.INFO if outcomes[0].together == "swapped" else Severity.WARNING
    if len(outcomes) <= _MOST_ALONE:
        for one in outcomes:
            yield Event(Happening.SWAP, severity, one.text, one.topic, one.node, one.details)
        return
    text = f"{count(len(outcomes), 'publisher')} {outcomes[0].together}"
    details = {"publishers": str(len(outcomes))}
    if took_s := [float(outcome.details["seconds"]) for outcome in outcomes if "seconds" in outcome.details]:
        least, most = format_number(min(took_s)), format_number(max(took_s))
        text += f" in {most} s" if least == most else f" in {least} to {most} s"
        details["seconds"] = f"{max(took_s):.3f}"
    yield Event(Happening.SWAP, severity, f"{text}: {listed([one.topic for one in outcomes])}", details=details)


def _details(record: SwapRecord) -> dict[str, str]:
    return {
        "result": record.result,
        "depth": str(record.depth),
        "deadline_ns": str(record.deadline_ns),
        "seconds": f"{sum(record.seconds_by_phase.values()):.3f}",
        **{f"{phase}_seconds": f"{seconds:.3f}" for phase, seconds in record.seconds_by_phase.items()},
    }
