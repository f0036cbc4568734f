"""Publishers in the document of ``/api/v1/status``, each from an `arpd.report.topic_rows.TopicRow`."""

from __future__ import annotations

from arpd.model.allocation import Binding
from arpd.model.endpoints import Direction
from arpd.web.api.part import Age, Amount, Count, Counts, Kept, Measured, Part, Period, Seconds, of


class Qos(Part):
    """Depth and DEADLINE."""

    depth: Count
    """KEEP_LAST depth (samples)."""
    deadline_ns: Period
    """DEADLINE period (ns); null = infinite."""


class Baseline(Qos):
    """The application's own QoS, restored on a clean stop."""

    depth: Count = of("baseline_depth")
    """KEEP_LAST depth (samples)."""
    deadline_ns: Period = of("baseline_deadline_ns")
    """DEADLINE period (ns); null = infinite."""


class Planned(Qos):
    """Settings in the plan in force; null if no plan has the topic."""

    rate_hz: Measured
    """Ceiling of the paced rate (Hz); null = unpaced."""
    min_rate_hz: Measured
    """Minimum rate: the price does not slow the topic below it while the link carries all minimum rates (Hz)."""
    weight: Amount
    """Share of link time relative to other topics; 0 = no price applies, the rate is the ceiling."""
    wire_bytes: Amount
    """Bytes that one sample puts on the link, over all copies (bytes)."""
    packets: Count
    """Packets of one sample, over all copies."""


class Confirmed(Qos):
    """Settings in the last announcement."""

    rate_hz: Measured
    """Ceiling of the paced rate (Hz); null = unpaced."""
    paced_rate_hz: Measured
    """Rate that the price leaves the publisher now (Hz); null = unpaced."""
    generation: Count
    """Generation of the plan that these settings came from; 0 = the application's own."""


class LastSwap(Part):
    """Last finished writer swap; null before the first."""

    number: Count
    """Number of the swap, from 1 for each publisher."""
    result: str
    """ok, or the reason why the old writer stayed."""
    depth: Count
    """Requested depth (samples)."""
    deadline_ns: Period
    """Requested DEADLINE (ns); null = infinite."""
    seconds_by_phase: Seconds
    """Time in each phase (s)."""


class Topic(Part):
    """One publisher that has announced itself."""

    topic: str = of("publisher.topic")
    """Topic name; topic and node identify the publisher."""
    node: str = of("publisher.node")
    """Fully qualified node name."""
    type: str = of("publisher.type_name")
    """Message type, such as sensor_msgs/msg/Imu."""
    direction: Direction = of("publisher.direction")
    """sensing leaves the robot, actuation reaches it, local does neither."""
    planned: Planned | None
    confirmed: Confirmed = of("publisher")
    baseline: Baseline = of("publisher")
    max_rate_hz: Measured = of("allocation.max_rate_hz", default=None)
    """Rate with the link to itself, Rmax (Hz); null if the program does not have the topic."""
    optimal_rate_hz: Measured = of("allocation.rate_hz", default=None)
    """Rate that the last tick gives the topic (Hz); null as above."""
    optimal_depth: Measured = of("allocation.depth", default=None)
    """Real-valued optimum D* of the program (samples); null as above."""
    share: Measured = of("allocation.share", default=None)
    """Share of link time that the program gives the topic, 0 to 1; null as above."""
    kept_ratio: Kept
    """Part of the source's rate that the link leaves it now, 0 to 1; 1 where the link does not slow it."""
    binding: Binding | None = of("allocation.binding", default=None)
    """Constraint that stops the rate from being larger; null as above."""
    depth_binding: Binding | None = of("allocation.depth_binding", default=None)
    """Constraint that stops the depth from being larger; null as above."""
    source_rate_hz: Measured = of("publisher.source_rate_hz")
    """Rate at which the application calls publish() (Hz)."""
    published_rate_hz: Measured = of("publisher.published_rate_hz")
    """Rate at which the writer sends samples (Hz)."""
    payload_bytes: Measured = of("publisher.payload_bytes")
    """Mean serialized size of recent samples (bytes)."""
    offered: Count = of("publisher.offered")
    """Samples that the application published, since the publisher started."""
    published: Count = of("publisher.published")
    """Samples written to the link, since the publisher started."""
    withheld: Count = of("publisher.withheld")
    """Samples that did not leave the publisher since it started."""
    withheld_by_cause: Counts = of("publisher.withheld_by_cause")
    """Withheld samples by cause: rate, price, blocked, failed, closed."""
    queued: Count = of("publisher.queued")
    """Samples that now wait in the pacing queue."""
    blocked_seconds: Measured = of("publisher.blocked_s")
    """Time spent inside the middleware's publish(), since the publisher started (s)."""
    remote_readers: Count = of("publisher.remote_readers")
    """Participants on other hosts that read the topic."""
    requested_deadline_ns: Period = of("publisher.requested_deadline_ns")
    """Shortest DEADLINE that a reader requests (ns); null if none does."""
    deadlines_missed: Count = of("publisher.deadlines_missed")
    """Missed deadlines that the middleware counted, over all writers so far."""
    swaps: Counts = of("publisher.swaps_by_result")
    """Finished writer swaps since the publisher started, by result."""
    swaps_begun: Count = of("publisher.swaps_begun")
    """Writer swaps since the publisher started, finished or not."""
    swap_seconds_by_phase: Seconds = of("publisher.swap_seconds_by_phase")
    """Time that all writer swaps spent in each phase (s)."""
    last_swap: LastSwap | None = of("publisher.last_swap")
    lacks_profile: bool = of("publisher.lacks_profile")
    """True if its process says that it runs without arpd's Fast DDS profile."""
    refusal: str = of("publisher.refusal")
    """Why the publisher refuses the last request, in words; empty if it does not."""
    refusal_reason: str = of("publisher.refusal_reason")
    """The same reason by name; none if it does not refuse."""
    refusal_lasts: bool = of("publisher.refusal_reason.is_lasting")
    """True if depth and deadline stay for good, so that arpd manages only the rate."""
    age_seconds: Age = of("age_s")
    """Time since the announcement (s)."""
