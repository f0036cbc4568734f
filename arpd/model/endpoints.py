"""Publishers that arpd re-tunes: their counters and settings."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from arpd.model.wire import wire_size

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from arpd.model.plan import PlanAnswer, TopicPlan
    from arpd.model.relay import RelaySummary

MOST_PUBLISHERS = 2000  # that a daemon manages, of all nodes together and so of one: more than any robot has


class Direction(StrEnum):
    """Direction in which a topic crosses the link."""

    SENSING = "sensing"  # robot computer -> base computer (the paper's SPt)
    ACTUATION = "actuation"  # base computer -> robot computer (the paper's PAAt)
    LOCAL = "local"  # does not cross the link (no reader on the other host)


class Overflow(StrEnum):
    """Treatment of samples above the paced rate."""

    LATEST = "latest"  # keep the newest sample only
    QUEUE = "queue"  # FIFO of at most depth samples; withhold the oldest


class RefusalReason(StrEnum):
    """Reason why requested QoS is not in force; words for people stand beside it.

    A lasting refusal is an answer: asking again changes nothing until the application itself changes.
    """

    NONE = "none"
    MIDDLEWARE = "middleware"  # nobody has measured QoS swaps on it
    TRANSIENT_LOCAL = "transient_local"  # a new endpoint would miss or repeat what late joiners need
    UNMATCHED = "unmatched"
    INCOMPATIBLE = "incompatible"
    FAILED = "failed"

    @property
    def is_lasting(self) -> bool:
        """True when depth and deadline stay as they are for good."""
        return self in {RefusalReason.MIDDLEWARE, RefusalReason.TRANSIENT_LOCAL}


class Refusal(NamedTuple):
    """Reason of a refusal, with words for people."""

    reason: RefusalReason = RefusalReason.NONE
    words: str = ""


NO_REFUSAL = Refusal()


class WithheldCause(StrEnum):
    """Reason why a sample of the application is withheld."""

    RATE = "rate"  # the application publishes faster than the ceiling of the plan
    PRICE = "price"  # the same, while the price or a slow start keeps the rate below that
    BLOCKED = "blocked"  # the writer or the reader before it had no time; no rate held the sample back
    FAILED = "failed"  # writing it raised, or the choice of what leaves
    CLOSED = "closed"  # it still waited when the publisher was destroyed


class SwapState(StrEnum):
    """State of a writer swap; docs/design.md has the transitions."""

    IDLE = "idle"
    MATCHING = "matching"
    WATCHING = "watching"
    HOLDING = "holding"
    PROVING = "proving"
    DOUBTING = "doubting"


class SwapResult(StrEnum):
    """Result of a writer swap."""

    OK = "ok"
    REORDER_POSSIBLE = "reorder_possible"  # samples left by one writer while the other had unacknowledged ones
    UNMATCHED = "unmatched"  # not all readers matched the new writer in time; the old one stays
    INCOMPATIBLE = "incompatible"  # a reader refuses the new QoS; the old writer stays
    SUPERSEDED = "superseded"  # a newer request came first
    UNDELIVERED = "undelivered"  # beside the swap's own result: an old writer went with samples unacknowledged
    FAILED = "failed"  # the middleware refused the new writer; the old one stays


@dataclass(frozen=True, kw_only=True, slots=True)
class SwapTiming:
    """Timeouts of a writer swap (s).

    Parameters
    ----------
    settle_s : least time between the last change of the matched readers and the switch: the readers' side matches later
    clean_settle_s : the same while the link loses less than 0.5 % of its packets
    clean_unproven_s : the same if a reader acknowledges nothing, so that a new writer cannot prove that it hears it
    match_timeout_s : time after which a new writer is destroyed when a reader does not match it, or does not
        acknowledge its samples; also the longest delay that readers which keep joining can cause
    watch_s : time to wait for an instant at which the old writer is acknowledged, before samples are held. A swap holds
        once: when that does not help, acknowledgements are slow, as with Fast DDS's default heartbeat of 3 s
    hold_s : longest time samples are held at a time
    patience_s : after this and ``settle_s`` the new writer takes over, even when the old one is not acknowledged
    drain_s : longest life of an old writer after the switch
    most_draining : old writers that may drain at a time; the next swap waits, so that histories cannot pile up
    burst : samples that were held and may leave at once where the caller comes late
    """

    settle_s: float = 3.0  # at 10 % loss, of 570 readers half matched at once, 2 % after 1 s, the last after 2.8 s
    clean_settle_s: float = 0.2
    clean_unproven_s: float = 1.5  # at 0.4 % loss, one lost packet delayed the match of 60 of 100 readers to 1.1 s
    match_timeout_s: float = 10.0
    watch_s: float = 0.3
    hold_s: float = 0.3
    patience_s: float = 4.0  # longer than the default heartbeat period, 3 s
    drain_s: float = 4.0
    most_draining: int = 4
    burst: int = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class WriterQos:
    """Policies that a writer swap changes: KEEP_LAST depth (samples) and offered deadline (ns, 0 = infinite)."""

    depth: int
    deadline_ns: int


class Writer(Protocol):
    """Writer, as far as a writer swap needs it."""

    def publish(self, sample: bytes) -> None:
        """Write one serialized sample."""

    def matched(self) -> int:
        """Count the matched readers."""

    def is_acknowledged(self) -> bool:
        """Return whether every written sample was acknowledged; never blocks."""

    def readers_acknowledge(self) -> bool:
        """Return whether the readers acknowledge what arrives; not so a best-effort one. Never blocks."""

    def disconnects_readers(self) -> bool:
        """Return whether a reader of its predecessor was discovered and refuses this writer's QoS; never blocks."""

    def deadlines_missed(self) -> int:
        """Count the missed offered deadlines; a destroyed writer keeps its last known count. Never blocks."""

    def destroy(self) -> None:
        """Destroy the writer."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SwapRecord:
    """Course of one writer swap, from its begin to its result.

    Parameters
    ----------
    number : counts up from 1 at its publisher, so a record that is read twice or missed shows
    result : `SwapResult`
    depth, deadline_ns : requested QoS (samples, ns)
    seconds_by_phase : time in each `SwapState` up to the result; the old writer drains later (s)
    """

    number: int
    result: str
    depth: int
    deadline_ns: int
    seconds_by_phase: Mapping[str, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class FlowState:
    """Counters and settings of one adaptive publisher.

    Parameters
    ----------
    payload_bytes : mean serialized size of recent samples (bytes)
    source_rate_hz : rate at which the application calls ``publish()`` (Hz)
    offered : samples that the application gave
    published : samples written to the link
    withheld : samples that did not leave: replaced by newer ones, or given up
    queued : samples waiting in the pacing queue now
    blocked_s : time spent inside the middleware's ``publish()`` since start (s); with two ends of a relay no
        write blocks
    rate_hz, depth, deadline_ns : settings in force; ``rate_hz`` is the ceiling, ``inf`` = unpaced, and ``deadline_ns``
        0 = infinite
    paced_rate_hz : rate that the price leaves the publisher now, ``inf`` = unpaced (Hz)
    swaps_by_result : QoS swaps since start, by result
    published_rate_hz : rate at which samples leave by the writer; 0 when silent or slower than 0.2 Hz (Hz)
    withheld_by_cause : ``withheld``, by `WithheldCause`
    deadlines_missed : offered deadlines that the middleware counted as missed, by each writer while it was in force
    swaps_begun : QoS swaps since start; each is under way or has one result, and perhaps ``undelivered`` beside it
    last_swap : course of the swap that finished last, None before the first
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
    paced_rate_hz: float = math.inf
    depth: int
    deadline_ns: int = 0
    swaps_by_result: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    withheld_by_cause: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    deadlines_missed: int = 0
    swaps_begun: int = 0
    last_swap: SwapRecord | None = None

    def counted(self) -> dict[str, Any]:
        """Return these fields, to make a `PublisherState` with them."""
        return {name: getattr(self, name) for name in _COUNTED}


_COUNTED = tuple(each.name for each in fields(FlowState))


@dataclass(frozen=True, kw_only=True, slots=True)
class PublisherState(FlowState):
    """What a node tells of one AdaptivePublisher, joined with what the graph says of its readers.

    Parameters
    ----------
    node : fully qualified node name; with ``topic`` the publisher's identity
    baseline_depth, baseline_deadline_ns : the application's own QoS, to be restored on a clean stop
    generation : plan that the settings came from, 0 = the application's own
    lease_s : silence of the daemon after which the node returns to its own QoS, 0 = never (s)
    refusal, refusal_reason : why the last request was refused, in words and by name; empty and ``none`` if it was not
    keeps_all : True when its history is KEEP_ALL, where a depth means nothing
    lacks_profile : True when it says that its process runs without arpd's Fast DDS profile
    remote_readers : participants on other hosts that read the topic
    requested_deadline_ns : tightest deadline that a reader requests, 0 when none does
    announced_at_s : when the node told it, by the monotonic clock; ``inf`` before it did (s)
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
    lacks_profile: bool = False
    remote_readers: int = 0
    requested_deadline_ns: int = 0
    announced_at_s: float = math.inf

    def age_s(self, now_s: float) -> float:
        """Return the time since the node told it (s)."""
        return max(0.0, now_s - self.announced_at_s)

    @property
    def copies(self) -> int:
        """Times that each sample crosses the link: one unicast copy per remote reader, and one while none is known."""
        return max(1, self.remote_readers)

    def qos_by(self, row: TopicPlan) -> tuple[int, int]:
        """Return the depth and the deadline that a row of a plan gives it."""
        return row.qos if row.depth else (self.baseline_depth, self.baseline_deadline_ns)

    def wire_bytes(self, rate_hz: float) -> float:
        """Return what a sample, at this rate, puts on the link in all its copies; 0 where none crosses it."""
        if self.direction is Direction.LOCAL or not self.payload_bytes:
            return 0.0
        return self.copies * wire_size(self.payload_bytes, rate_hz=rate_hz)[0]


@dataclass(frozen=True, kw_only=True, slots=True)
class NodeSnapshot:
    """What a node tells once a second.

    Parameters
    ----------
    node : its full name
    answer : to the daemon's plans
    publishers : fields of the `PublisherState` of each, without those that the graph shows
    left_out : number of its publishers beyond `MOST_PUBLISHERS`, of which it tells nothing
    relay : summary of the relay that this node belongs to
    host : where it runs, as `arpd.ros.graph.this_host` says it there; empty = not known
    """

    node: str
    answer: PlanAnswer
    publishers: Sequence[Mapping[str, Any]] = ()
    left_out: int = 0
    relay: RelaySummary | None = None
    host: str = ""
