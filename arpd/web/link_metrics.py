"""Metrics of the link interface, its radio and the peers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.model.interface import InterfaceState, state_of
from arpd.model.link import EstimatorEvent
from arpd.web.families import counter_by, counter_of, gauge, gauge_by, gauge_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from prometheus_client.metrics_core import Metric

    from arpd.model.interface import LinkCounters
    from arpd.model.link import LinkEstimate
    from arpd.model.observation import Observation
    from arpd.report.snapshot import Snapshot

_INTERFACE_COUNTERS: tuple[tuple[str, str, Callable[[LinkCounters], int]], ...] = (
    ("arpd_interface_receive_bytes", "Bytes that the link interface received.", lambda c: c.rx_bytes),
    ("arpd_interface_transmit_bytes", "Bytes that the link interface sent.", lambda c: c.tx_bytes),
    ("arpd_interface_receive_packets", "Packets that the link interface received.", lambda c: c.rx_packets),
    ("arpd_interface_transmit_packets", "Packets that the link interface sent.", lambda c: c.tx_packets),
    ("arpd_interface_transmit_dropped_packets", "Packets dropped on the way out.", lambda c: c.tx_dropped),
)


def link_metrics(snapshot: Snapshot) -> Iterator[Metric]:
    """Yield the families; an unknown value has no series."""
    # The configured name, because a rename of the interface must not begin new series.
    labels, counters = {"interface": snapshot.interface}, snapshot.observation.counters
    current = state_of(counters)
    up = float(current is InterfaceState.UP)
    yield gauge_of("arpd_interface_up", "1 while the link interface is up and readable.", ((labels, up),))
    text = "State of the link interface."
    yield gauge_by("arpd_link_interface_state", text, "state", InterfaceState, ((labels, current),))
    if (rate := snapshot.observation.radio_bytes_per_second) is not None:
        text = "Bit rate at which the radio transmits; only a part of it is usable."
        yield gauge_of("arpd_link_radio_bytes_per_second", text, ((labels, rate),))
    yield from _of_peers(snapshot.observation)
    yield from _of_probes(snapshot.link)
    if (other := snapshot.other_traffic) is not None:
        text = (
            "Traffic of the last second that topics, probes and reports do not explain: DDS discovery, "
            "acknowledgements, calls, and other programs."
        )
        rates = (({"direction": direction}, rate) for direction, rate in sorted(other._asdict().items()))
        yield gauge_of("arpd_link_other_bytes_per_second", text, rates)
    if counters is None:
        return
    if counters.backlog_bytes is not None:
        text = "Bytes that wait in the link interface's own queue."
        yield gauge_of("arpd_interface_backlog_bytes", text, ((labels, counters.backlog_bytes),))
    for name, text, read in _INTERFACE_COUNTERS:
        yield counter_of(name, text, ((labels, read(counters)),))


def _of_peers(observation: Observation) -> Iterator[Metric]:
    ages_s, clocks = observation.peer_ages_s, sorted(observation.peer_clocks.items())
    yield gauge("arpd_peers", "Peers heard in the last minute.", len(ages_s))
    series = (({"peer": peer}, age_s) for peer, age_s in sorted(ages_s.items()))
    yield gauge_of("arpd_peer_report_age_seconds", "Time since the peer's last report.", series)
    text = "The peer's clock less this host's, by the shortest round trip of the last 30 seconds."
    yield gauge_of("arpd_peer_clock_offset_seconds", text, (({"peer": peer}, clock.offset_s) for peer, clock in clocks))
    text = "Most error of the clock offset: half that round trip."
    errors = (({"peer": peer}, clock.uncertainty_s) for peer, clock in clocks)
    yield gauge_of("arpd_peer_clock_uncertainty_seconds", text, errors)


def _of_probes(link: LinkEstimate) -> Iterator[Metric]:
    """Yield loss, return delay and estimator events; an unknown value has no series."""
    if link.loss_ratio is not None:
        yield gauge("arpd_link_loss_ratio", "Share of recent probe packets that never reached a peer.", link.loss_ratio)
    if link.return_delay_s is not None:
        yield gauge(
            "arpd_link_return_delay_seconds",
            "One-way delay of the peer's reports above its minimum of the last 10 seconds; commands wait as long.",
            link.return_delay_s,
        )
    yield counter_by(
        "arpd_estimator_events",
        "Changes of the estimated capacity by kind, and outages that began.",
        "event",
        EstimatorEvent,
        (({}, link.events_by_kind),),
    )
