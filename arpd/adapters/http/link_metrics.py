"""Metrics of the link interface, of its radio, and of the peers behind it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

from arpd.adapters.http.families import counter_by, gauge
from arpd.model.interface import InterfaceState, state_of
from arpd.model.link import EstimatorEvent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from prometheus_client.metrics_core import Metric

    from arpd.model.interface import LinkCounters
    from arpd.model.link import LinkEstimate
    from arpd.report.snapshot import Snapshot

_INTERFACE_COUNTERS: tuple[tuple[str, str, Callable[[LinkCounters], int]], ...] = (
    ("arpd_interface_receive_bytes", "Bytes the link interface received.", lambda c: c.rx_bytes),
    ("arpd_interface_transmit_bytes", "Bytes the link interface sent.", lambda c: c.tx_bytes),
    ("arpd_interface_receive_packets", "Packets the link interface received.", lambda c: c.rx_packets),
    ("arpd_interface_transmit_packets", "Packets the link interface sent.", lambda c: c.tx_packets),
    ("arpd_interface_transmit_dropped_packets", "Packets dropped on the way out.", lambda c: c.tx_dropped),
)


def link_metrics(snapshot: Snapshot) -> Iterator[Metric]:
    """Yield the families; what cannot be read has no series."""
    # The name as configured, whatever the interface is called by now: a rename must not begin new series.
    interface, counters = snapshot.interface, snapshot.observation.counters
    current = state_of(counters)
    up = GaugeMetricFamily("arpd_interface_up", "1 while the link interface is up and readable.", labels=("interface",))
    up.add_metric((interface,), current is InterfaceState.UP)
    yield up
    states = GaugeMetricFamily(
        "arpd_link_interface_state",
        "What the link interface can do. 1 marks what holds.",
        labels=("interface", "state"),
    )
    for state in sorted(InterfaceState):
        states.add_metric((interface, state), state is current)
    yield states
    if (rate := snapshot.observation.radio_bytes_per_second) is not None:
        radio = GaugeMetricFamily(
            "arpd_link_radio_bytes_per_second",
            "Bit rate the radio transmits at; a bound, of which only a part is usable.",
            labels=("interface",),
        )
        radio.add_metric((interface,), rate)
        yield radio
    yield from _of_peers(snapshot.observation.peer_ages_s)
    yield from _of_probes(snapshot.link)
    if counters is None:
        return
    if counters.backlog_bytes is not None:
        backlog = GaugeMetricFamily(
            "arpd_interface_backlog_bytes", "What waits in the link interface's own queue.", labels=("interface",)
        )
        backlog.add_metric((interface,), counters.backlog_bytes)
        yield backlog
    for name, text, read in _INTERFACE_COUNTERS:
        family = CounterMetricFamily(name, text, labels=("interface",))
        family.add_metric((interface,), read(counters))
        yield family


def _of_peers(ages_s: Mapping[str, float]) -> Iterator[Metric]:
    yield GaugeMetricFamily("arpd_peers", "Peers heard in the last minute.", value=float(len(ages_s)))
    family = GaugeMetricFamily("arpd_peer_report_age_seconds", "Time since the peer's last report.", labels=("peer",))
    for peer, age_s in sorted(ages_s.items()):
        family.add_metric((peer,), age_s)
    yield family


def _of_probes(link: LinkEstimate) -> Iterator[Metric]:
    """Yield what probes and reports say beside the capacity; what is not known has no series."""
    if link.loss_ratio is not None:
        yield gauge(
            "arpd_link_loss_ratio", "Share of the probe packets of late that never reached a peer.", link.loss_ratio
        )
    if link.return_delay_s is not None:
        yield gauge(
            "arpd_link_return_delay_seconds",
            "One-way delay of the peer's reports above its minimum of the last 10 seconds: what commands wait.",
            link.return_delay_s,
        )
    yield counter_by(
        "arpd_estimator_events",
        "Times each rule changed the capacity estimate, and outages that began.",
        "event",
        EstimatorEvent,
        (({}, link.events_by_kind),),
    )
