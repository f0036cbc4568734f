"""Publishers and readers that arpd re-tunes: what each counts, runs with and announces."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping


class Direction(StrEnum):
    """Which way a topic crosses the link."""

    SENSING = "sensing"  # robot computer -> CEDDP (the paper's SPt)
    ACTUATION = "actuation"  # CEDDP -> robot computer (the paper's PAAt)
    LOCAL = "local"  # does not cross the link (no reader on the other host)


class RefusalReason(StrEnum):
    """Why QoS that was asked for is not in force; the words for a human stand beside it.

    A refusal that lasts is an answer: asking again changes nothing until the application itself does something else.
    """

    NONE = "none"
    MIDDLEWARE = "middleware"  # its QoS swaps were never measured
    TRANSIENT_LOCAL = "transient_local"  # a new endpoint would miss, or repeat, what late joiners need
    CLAMPED = "clamped"  # the deadline is the longest that a reader requests
    UNMATCHED = "unmatched"
    INCOMPATIBLE = "incompatible"
    FAILED = "failed"
    OTHER = "other"  # of an announcer that is older, or newer, than these words

    @property
    def is_lasting(self) -> bool:
        """Whether depth and deadline stay as they are for good."""
        return self in {RefusalReason.MIDDLEWARE, RefusalReason.TRANSIENT_LOCAL}

    @classmethod
    def told(cls, name: str | None, *, words: str) -> RefusalReason:
        """Understand what an announcement says; a refusal whose reason is not known counts as passing.

        Parameters
        ----------
        name : reason as announced, None where the announcer knows none
        words : refusal for a human, empty = nothing is refused
        """
        if not words:
            return cls.NONE
        reason = next((reason for reason in cls if reason == name), cls.OTHER)
        return cls.OTHER if reason is cls.NONE else reason


class Refusal(NamedTuple):
    """A reason, with the words for a human."""

    reason: RefusalReason = RefusalReason.NONE
    words: str = ""


NO_REFUSAL = Refusal()


class DropCause(StrEnum):
    """Why a sample of the application's was not published."""

    RATE = "rate"  # the application was faster than the plan's rate
    GATE = "gate"  # the same, while the gate kept the rate below the plan's, or a slow start before the first plan
    BLOCKED = "blocked"  # no rate kept it back, but the writer that blocked
    FAILED = "failed"  # writing it raised
    CLOSED = "closed"  # it still waited when the publisher was destroyed


class SwapPhase(StrEnum):
    """What the time of a swap is spent on: the states of it, and draining the old writer once it is over."""

    MATCHING = "matching"
    WATCHING = "watching"
    HOLDING = "holding"
    PROVING = "proving"
    DOUBTING = "doubting"
    DRAINING = "draining"


class SwapResult(StrEnum):
    """How a swap ended."""

    OK = "ok"
    REORDER_POSSIBLE = "reorder_possible"  # samples left by one writer while the other's were not all acknowledged
    UNMATCHED = "unmatched"  # readers did not match the new writer in time; the old one stays
    INCOMPATIBLE = "incompatible"  # a reader would have been lost to the new QoS; the old writer stays
    SUPERSEDED = "superseded"  # a newer request came first
    UNDELIVERED = "undelivered"  # beside the swap's own result: an old writer was given up with samples unacknowledged
    FAILED = "failed"  # the middleware refused the new writer; the old one stays


class ReaderSwapResult(StrEnum):
    """How a handover ended."""

    OK = "ok"
    INCOMPLETE = "incomplete"  # the old reader still missed what the new one had; with loss, its older samples too
    UNMATCHED = "unmatched"  # writers did not match the new reader in time; the old one stays
    SUPERSEDED = "superseded"  # a newer request came first
    FAILED = "failed"  # the middleware refused the new reader, or it ran too far ahead; the old one stays


@dataclass(frozen=True, kw_only=True, slots=True)
class WriterQos:
    """The two policies a swap changes: KEEP_LAST depth (samples) and offered deadline (ns, 0 = infinite)."""

    depth: int
    deadline_ns: int


class Writer(Protocol):
    """What a swap needs of a writer."""

    def publish(self, sample: bytes) -> None:
        """Write one serialized sample."""

    def matched(self) -> int:
        """Count the matched readers."""

    def is_acknowledged(self) -> bool:
        """Whether every sample written was acknowledged; never blocks."""

    def disconnects_readers(self) -> bool:
        """Whether a reader that its predecessor serves was discovered and refuses this writer's QoS; never blocks."""

    def deadlines_missed(self) -> int:
        """Count the offered deadlines missed since it was made, by a destroyed one as far as known; never blocks."""

    def destroy(self) -> None:
        """Destroy the writer."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SwapRecord:
    """How one QoS swap went, from its begin to its result.

    Parameters
    ----------
    number : counts up from 1 at its publisher, so that a record read twice is known again, and one missed shows
    result : `arpd.model.endpoints.SwapResult`
    depth, deadline_ns : what it was about (samples, ns)
    seconds_by_phase : time in each phase it was in, by `SwapPhase`; the old writer drains after that (s)
    """

    number: int
    result: str
    depth: int
    deadline_ns: int
    seconds_by_phase: Mapping[str, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class FlowState:
    """What one adaptive publisher counts and runs with.

    Parameters
    ----------
    payload_bytes : mean serialized size of recent samples (bytes)
    source_rate_hz : rate at which the application calls ``publish()`` (Hz)
    offered : samples the application gave
    published : samples written to the link
    withheld : samples that never left: conflated, dropped from the queue, or given up
    queued : samples waiting in the pacing queue now
    blocked_s : time spent inside the middleware's ``publish()`` since start (s)
    rate_hz, depth, deadline_ns : settings in force; ``rate_hz`` ``inf`` = unpaced, ``deadline_ns`` 0 = infinite
    swaps_by_result : QoS swaps since start, by result
    published_rate_hz : rate at which samples leave by the writer; 0 when it is silent, or slower than 0.2 Hz (Hz)
    withheld_by_cause : what ``withheld`` is made of, by `arpd.model.endpoints.DropCause`
    deadlines_missed : offered deadlines the middleware counted as missed, by each writer while it was in force
    swaps_begun : QoS swaps since start; each has one result, beside ``undelivered``, or is under way
    swap_seconds_by_phase : time all swaps spent in each phase that is over, draining too, by `SwapPhase` (s)
    last_swap : how the swap that finished last went, None before the first
    """

    payload_bytes: float
    source_rate_hz: float
    published_rate_hz: float = 0.0
    offered: int = 0
    published: int = 0
    withheld: int = 0
    queued: int = 0
    blocked_s: float = 0.0
    rate_hz: float = math.inf
    depth: int
    deadline_ns: int = 0
    swaps_by_result: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    withheld_by_cause: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    deadlines_missed: int = 0
    swaps_begun: int = 0
    swap_seconds_by_phase: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    last_swap: SwapRecord | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class PublisherState(FlowState):
    """What one AdaptivePublisher announced, joined with what the graph says of its readers.

    Parameters
    ----------
    node : fully qualified node name; with ``topic`` the publisher's identity
    baseline_depth, baseline_deadline_ns : the application's own QoS, to be restored on a clean stop
    generation : generation of the plan these settings came from, 0 = the application's own
    lease_s : silence of the daemon after which the node returns to its own QoS, 0 = never (s)
    refusal, refusal_reason : why the last request was refused, in words and by name; empty and ``none`` if it was not
    keeps_all : whether its history is KEEP_ALL, so that a depth means nothing
    remote_readers : off-host participants that read the topic
    requested_deadline_ns : tightest deadline a reader requests that arpd does not drive, 0 when none does
    age_s : time since the announcement (s)
    """

    node: str
    topic: str
    type_name: str
    direction: Direction
    baseline_depth: int
    baseline_deadline_ns: int = 0
    generation: int = 0
    lease_s: float = 0.0
    refusal: str = ""
    refusal_reason: RefusalReason = RefusalReason.NONE
    keeps_all: bool = False
    remote_readers: int = 0
    requested_deadline_ns: int = 0
    age_s: float = 0.0

    @property
    def copies(self) -> int:
        """Times each sample crosses the link: one unicast copy per remote reader, and one while none is known."""
        return max(1, self.remote_readers)


@dataclass(frozen=True, kw_only=True, slots=True)
class ReaderState:
    """What one AdaptiveSubscription announced, joined with what the graph says of its topic.

    Parameters
    ----------
    node, topic : fully qualified names, together the reader's identity
    depth, deadline_ns : in force; ``deadline_ns`` is the requested period, 0 = infinite (samples, ns)
    baseline_depth, baseline_deadline_ns : the application's own, to be restored on a clean stop
    generation : generation of the plan last asked for, 0 = the application's own
    lease_s : silence of the daemon after which the node returns to its own QoS, 0 = never (s)
    keeps_all : whether its history is KEEP_ALL, so that a depth means nothing
    refusal, refusal_reason : why the last request was refused, or any would be, in words and by name
    swaps_by_result : handovers since start, by result
    requests_ns : periods its node's readers of the topic request in the graph; two while one replaces the other
    offers_ns : periods the topic's writers offer in the graph, 0 = infinite
    deadlines_missed : requested deadlines the middleware counted as missed, over all readers so far
    age_s : time since the announcement (s)
    """

    node: str
    topic: str
    depth: int
    deadline_ns: int = 0
    baseline_depth: int
    baseline_deadline_ns: int = 0
    generation: int = 0
    lease_s: float = 0.0
    keeps_all: bool = False
    refusal: str = ""
    refusal_reason: RefusalReason = RefusalReason.NONE
    swaps_by_result: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    requests_ns: tuple[int, ...] = ()
    offers_ns: tuple[int, ...] = ()
    deadlines_missed: int = 0
    age_s: float = 0.0

    @property
    def is_driven(self) -> bool:
        """Whether arpd may change it; otherwise its request binds writers as any other reader's does."""
        return not self.refusal_reason.is_lasting
