"""Events of the decision log: one plain sentence each, and what a program needs to find them."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping


class Severity(StrEnum):
    """Weight of an event or a condition for the people who run the robot."""

    INFO = "info"
    WARNING = "warning"  # something is worse than it should be, and arpd copes
    ERROR = "error"  # arpd cannot cope


class EventKind(StrEnum):
    """Kinds of events; each is a label of ``arpd_events_total`` and ``ARPD_EVENT`` in the journal."""

    STARTED = "started"
    OUTAGE = "outage"  # the link carries nothing
    RECOVERED = "recovered"
    INTERFACE = "interface"  # the link interface changed its state
    PEER_FOUND = "peer_found"
    PEER_LOST = "peer_lost"
    PLAN = "plan"  # a new plan
    CONFIRMED = "confirmed"  # every publisher announces it
    RATES = "rates"  # the link slows other topics than before, or by another amount, for long
    PLAN_REFUSED = "plan_refused"  # a plan or a swap is due, and dwell or budget forbids it
    INFEASIBLE = "infeasible"  # not everything asked for fits
    FEASIBLE = "feasible"  # it does again
    MEMORY = "memory"  # depths follow memory
    WRITER_REPLACED = "swap"  # a topic has a new writer
    WRITER_KEPT = "swap_failed"  # a topic keeps its old writer
    REFUSED = "refused"  # a publisher refuses new QoS
    TOPIC_FOUND = "topic_found"
    TOPIC_LOST = "topic_lost"
    RELOADED = "reloaded"
    RELOAD_FAILED = "reload_failed"
    STANDING_BY = "standing_by"
    IN_CHARGE = "in_charge"


@dataclass(frozen=True, kw_only=True, slots=True)
class Event:
    """One line of the decision log.

    Parameters
    ----------
    number : counts up from 1 since the daemon started
    unix_time_s : wall clock when it happened (s)
    kind, severity : what it is about, and its weight
    text : a plain sentence without a full stop: "the link slows 1 topic: /camera/image 30 → 2.1 Hz"
    topic, node : the topic and the node it is about, empty when there are several
    details : further facts by lower-case name, for programs
    """

    number: int
    unix_time_s: float
    kind: EventKind
    severity: Severity
    text: str
    topic: str = ""
    node: str = ""
    details: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))


class Said(NamedTuple):
    """An event before it has its number and its time."""

    kind: EventKind
    severity: Severity
    text: str
    topic: str = ""
    node: str = ""
    details: Mapping[str, str] = {}
