"""Live AdaptivePublishers: what each counts, and what it runs with."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.model.refusal import RefusalReason

if TYPE_CHECKING:
    from collections.abc import Mapping

    from arpd.model.values import Direction


@dataclass(frozen=True, kw_only=True, slots=True)
class SwapRecord:
    """How one QoS swap went, from its begin to its result.

    Parameters
    ----------
    number : counts up from 1 at its publisher, so that a record read twice is known again, and one missed shows
    result : `arpd.apply.endpoint.writer_swap.SwapResult`
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
    withheld_by_cause : what ``withheld`` is made of, by `arpd.apply.endpoint.pacing.DropCause`
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
