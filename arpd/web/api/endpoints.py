"""Publishers in the document of ``/api/v1/status``."""

from __future__ import annotations

from arpd.model.allocation import Binding
from arpd.model.endpoints import Direction
from arpd.web.api.part import Amount, Count, Part, Ratio


class Qos(Part):
    """Depth and DEADLINE."""

    depth: Count
    """KEEP_LAST depth (samples)."""
    deadline_ns: Count | None
    """DEADLINE period (ns); null = infinite."""


class Planned(Qos):
    """Settings in the plan in force; null if no plan has the topic."""

    rate_hz: Amount | None
    """Ceiling of the paced rate (Hz); null = unpaced."""
    min_rate_hz: Amount | None
    """Floor: the price does not slow the topic below this rate while the link carries all floors (Hz)."""
    weight: Amount
    """Share of link time relative to other topics; 0 = no price applies, the rate is the ceiling."""
    wire_bytes: Amount
    """Bytes that one sample puts on the link, over all copies (bytes)."""
    packets: Count
    """Packets of one sample, over all copies."""


class Confirmed(Qos):
    """Settings in the last announcement."""

    rate_hz: Amount | None
    """Ceiling of the paced rate (Hz); null = unpaced."""
    paced_rate_hz: Amount | None
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
    deadline_ns: Count | None
    """Requested DEADLINE (ns); null = infinite."""
    seconds_by_phase: dict[str, Amount]
    """Time in each phase (s)."""


class Topic(Part):
    """One publisher that has announced itself."""

    topic: str
    """Topic name; topic and node identify the publisher."""
    node: str
    """Fully qualified node name."""
    type: str
    """Message type, such as sensor_msgs/msg/Imu."""
    direction: Direction
    """sensing leaves the robot, actuation reaches it, local does neither."""
    planned: Planned | None
    confirmed: Confirmed
    baseline: Qos
    """The application's own QoS, restored on a clean stop."""
    max_rate_hz: float | None
    """Rate with the link to itself, Rmax (Hz); null if the program does not have the topic."""
    optimal_rate_hz: float | None
    """Rate that the last tick gives the topic (Hz); null as above."""
    optimal_depth: float | None
    """Real-valued optimum D* of the program (samples); null as above."""
    share: float | None
    """Share of link time that the program gives the topic, 0 to 1; null as above."""
    kept_ratio: Ratio
    """Part of the source's rate that the link leaves it now, 0 to 1; 1 where the link does not slow it."""
    binding: Binding | None
    """Constraint that stops the rate from being larger; null as above."""
    depth_binding: Binding | None
    """Constraint that stops the depth from being larger; null as above."""
    source_rate_hz: Amount | None
    """Rate at which the application calls publish() (Hz)."""
    published_rate_hz: Amount | None
    """Rate at which the writer sends samples (Hz)."""
    payload_bytes: Amount | None
    """Mean serialized size of recent samples (bytes)."""
    offered: Count
    """Samples that the application published, since the publisher started."""
    published: Count
    """Samples written to the link, since the publisher started."""
    withheld: Count
    """Samples that did not leave the publisher since it started."""
    withheld_by_cause: dict[str, Count]
    """Withheld samples by cause: rate, price, blocked, failed, closed."""
    queued: Count
    """Samples that now wait in the pacing queue."""
    blocked_seconds: Amount | None
    """Time spent inside the middleware's publish(), since the publisher started (s)."""
    remote_readers: Count
    """Participants on other hosts that read the topic."""
    requested_deadline_ns: Count | None
    """Shortest DEADLINE that a reader requests (ns); null if none does."""
    deadlines_missed: Count
    """Missed deadlines that the middleware counted, over all writers so far."""
    swaps: dict[str, Count]
    """Finished writer swaps since the publisher started, by result."""
    swaps_begun: Count
    """Writer swaps since the publisher started, finished or not."""
    swap_seconds_by_phase: dict[str, Amount]
    """Time that all writer swaps spent in each phase (s)."""
    last_swap: LastSwap | None
    lacks_profile: bool
    """True if its process says that it runs without arpd's Fast DDS profile."""
    refusal: str
    """Why the publisher refuses the last request, in words; empty if it does not."""
    refusal_reason: str
    """The same reason by name; none if it does not refuse."""
    refusal_lasts: bool
    """True if depth and deadline stay for good, so that arpd governs only the rate."""
    age_seconds: Amount | None
    """Time since the announcement (s)."""
