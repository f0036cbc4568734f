"""What the daemon observes, in the document of ``/api/v1/status``."""

from __future__ import annotations

from arpd.model.link import CapacityKind, LinkState
from arpd.web.api.part import Age, Count, Counts, Measured, MeasuredRatio, Offset, Part, of


class Counters(Part):
    """Counters of the interface, which never fall while the daemon runs; null while it is gone."""

    interface: str
    """Name of the interface."""
    up: bool = of("is_up")
    """State of the interface."""
    receive_bytes: Count = of("rx_bytes")
    """Bytes received."""
    transmit_bytes: Count = of("tx_bytes")
    """Bytes sent."""
    receive_packets: Count = of("rx_packets")
    """Packets received."""
    transmit_packets: Count = of("tx_packets")
    """Packets sent."""
    transmit_dropped_packets: Count = of("tx_dropped")
    """Packets dropped on the way out."""
    backlog_bytes: Count | None
    """Bytes that wait in the interface's queue; null if the kernel does not tell."""


class Link(Part):
    """Estimate of the link."""

    capacity_bytes_per_second: Measured = of("link.capacity_bytes_per_second")
    """Capacity of the whole link (bytes/s on the wire)."""
    foreign_bytes_per_second: Measured = of("link.cross_traffic_bytes_per_second")
    """Cross traffic, which arpd's topics and probes do not explain (bytes/s on the wire)."""
    available_bytes_per_second: Measured = of("link.available_bytes_per_second")
    """Capacity left for arpd's topics (bytes/s on the wire)."""
    kind: CapacityKind = of("link.kind")
    """Evidence behind the capacity, best first."""
    state: LinkState = of("link.state")
    """State of the link; app_limited means that the traffic does not fill it."""
    app_limited: bool = of("link.is_app_limited")
    """True while the traffic is too small to show the capacity."""
    queue_delay_seconds: Measured = of("link.queue_delay_s")
    """One-way delay from robot to peer above its recent minimum (s)."""
    delivery_rate_bytes_per_second: Measured = of("link.delivery_rate_bytes_per_second")
    """Rate at which the peer received bytes recently (bytes/s on the wire)."""
    packet_overhead_seconds: Measured = of("link.packet_overhead_s")
    """Link time that each packet costs beyond its bytes (s)."""
    loss_ratio: MeasuredRatio = of("link.loss_ratio")
    """Share of recent probe packets that never arrived, 0 to 1; null if too few were sent."""
    return_delay_seconds: Measured = of("link.return_delay_s")
    """Delay of the peer's reports above its recent minimum, which commands wait, too (s); null without a peer."""
    radio_bytes_per_second: Measured = of("observation.radio_bytes_per_second")
    """Bit rate at which the radio transmits (bytes/s); null without a radio or its answer."""
    age_seconds: Age = of("link.age_s")
    """Time since the evidence behind the capacity (s)."""
    evidence: str = of("link.evidence")
    """Reason of the last change of the estimate, in words."""
    events: Counts = of("link.events_by_kind")
    """Changes of the estimate by rule, and outages, since the start."""


class Peer(Part):
    """One peer."""

    peer: str
    """Name of the peer."""
    report_age_seconds: Age
    """Time since the peer's last report (s)."""
    clock_offset_seconds: Offset = of("clock.offset_s", default=None)
    """The peer's clock less this host's (s), above 0 ahead; null if no probe of the last 30 s was answered."""
    clock_uncertainty_seconds: Measured = of("clock.uncertainty_s", default=None)
    """Most error of clock_offset_seconds (s): half the shortest round trip of the last 30 s."""


class Memory(Part):
    """Memory of the robot computer."""

    total_bytes: Count
    """Total memory (bytes)."""
    available_bytes: Count
    """Memory available without swapping (bytes)."""


class Graph(Part):
    """Topics in the ROS graph that cross the link, managed by arpd or not."""

    sensing_topics: Count
    """Topics from the robot."""
    actuation_topics: Count
    """Topics to the robot."""


class Rmw(Part):
    """Middleware of ROS; null without ROS."""

    name: str = of("rmw")
    """RMW identifier of the middleware."""
    refusal: str = of("rmw_refusal")
    """Why arpd only paces publishers; empty if it can swap their writers."""


class Daemons(Part):
    """Other arpd daemons in the ROS domain."""

    others: list[str] = of("other_daemons")
    """Hosts of the other daemons."""
    standing_by_for: str = of("active_daemon")
    """Host of the active daemon while this one stands by; empty if this one is active."""


class RelayDirection(Part):
    """Topics of one direction."""

    offered: Count
    """Topics that the one side may send."""
    wanted: Count
    """Those that the other side reads."""
    refused: dict[str, str]
    """Topics and services that an end refuses to carry, with the reason; at most a hundred."""


class Relay(Part):
    """Relay with two ends, as its end on the robot tells it; null without one, and while that end is silent."""

    other_host: str
    """Host of the end on the base computer; empty while it was never heard."""
    fault: str
    """Why that end's messages are not understood; empty if they are."""
    to_base: RelayDirection
    """Topics from the robot to the base computer."""
    to_robot: RelayDirection
    """Topics from the base computer to the robot."""
    received: Count
    """Samples that the robot's end received and wrote."""
    doubled: Count
    """Samples that it received a second time."""
    unknown: Count
    """Samples of writers that it does not know."""
    outdated: Count
    """Samples that an outage delayed until a newer one of their source had come."""
    link_bytes: Count
    """What both ends' chunks took of the link, headers and acknowledgements included."""
    incomplete: Count
    """Samples of groups that it dropped, because their set was never complete."""
    calls_failed: dict[str, Count]
    """Calls from the robot's nodes that had no answer, by reason."""
    strangers: list[str]
    """Nodes in the link domain that are not arpd's; the first three."""
    types_differ: dict[str, str]
    """Topics whose type differs between the sides, with both types."""
    reachable: bool = of("is_reachable")
    """True if the end on the base computer spoke in the last 3.5 s."""
