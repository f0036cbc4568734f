"""Prometheus metrics, all read from the last snapshot, so that a scrape never sees half a tick."""

from __future__ import annotations

import platform
import time
from collections import Counter
from itertools import product
from typing import TYPE_CHECKING, TypeAlias

from prometheus_client import CollectorRegistry, PlatformCollector, ProcessCollector
from prometheus_client.core import InfoMetricFamily
from prometheus_client.registry import Collector

from arpd import __version__
from arpd.model.allocation import AllocationStatus, Binding
from arpd.model.endpoints import RefusalReason
from arpd.model.interface import InterfaceState, state_of
from arpd.model.link import CapacityKind, LinkState
from arpd.model.observation import MessageKind, MessageRefusal
from arpd.relay.calls import FailureReason
from arpd.report.conditions import MESSAGE_IDS, Condition
from arpd.report.situation import judge
from arpd.report.topic_rows import topic_rows
from arpd.web.families import Rows, counts, family, histogram, states
from arpd.web.topic_metrics import topic_metrics

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from prometheus_client.core import Metric

    from arpd.model.interface import LinkCounters
    from arpd.model.relay import RelaySummary
    from arpd.report.durations import Distribution
    from arpd.report.snapshot import Snapshot, Totals

_Value: TypeAlias = "Rows | float | None"

# Known values start at zero, so that rate() sees their first increase.
_CAUSES = ("budget", "demand", "down", "memory", "readers", "reload", "start", "takeover", "topics", "up")
_LASTING = sorted(set(RefusalReason) - {RefusalReason.NONE})

_LINK: tuple[tuple[str, str, Callable[[Snapshot], _Value]], ...] = (
    (
        "arpd_link_capacity_bytes_per_second",
        "Wire bytes per second that the link carries, as estimated.",
        lambda s: s.link.capacity_bytes_per_second,
    ),
    (
        "arpd_link_capacity_kind",
        "Evidence behind the capacity estimate. 1 marks the current one.",
        lambda s: states("kind", CapacityKind, s.link.kind),
    ),
    (
        "arpd_link_state",
        "State of the link. 1 marks the current one.",
        lambda s: states("state", LinkState, s.link.state),
    ),
    ("arpd_link_estimate_age_seconds", "Time since the evidence behind the capacity estimate.", lambda s: s.link.age_s),
    (
        "arpd_link_cross_traffic_bytes_per_second",
        "Cross traffic, which arpd's topics and probes do not explain; arpd yields at most half of the capacity.",
        lambda s: s.link.cross_traffic_bytes_per_second,
    ),
    (
        "arpd_link_queue_delay_seconds",
        "One-way delay above its minimum of the last 10 seconds.",
        lambda s: s.link.queue_delay_s,
    ),
    (
        "arpd_link_return_delay_seconds",
        "One-way delay of the peer's reports above its minimum of the last 10 seconds; commands wait as long.",
        lambda s: s.link.return_delay_s,
    ),
    (
        "arpd_link_delivery_rate_bytes_per_second",
        "Bytes per second that the peer received over the last 300 ms.",
        lambda s: s.link.delivery_rate_bytes_per_second,
    ),
    (
        "arpd_link_loss_ratio",
        "Share of recent probe packets that never reached a peer.",
        lambda s: s.link.loss_ratio,
    ),
    ("arpd_peers", "Peers heard in the last minute.", lambda s: len(s.observation.peer_ages_s)),
    (
        "arpd_peer_report_age_seconds",
        "Time since the peer's last report.",
        lambda s: [({"peer": peer}, age_s) for peer, age_s in sorted(s.observation.peer_ages_s.items())],
    ),
    (
        "arpd_peer_clock_uncertainty_seconds",
        "Most error of the difference of the clocks: half the shortest round trip of the last 30 seconds.",
        lambda s: [({"peer": peer}, at.uncertainty_s) for peer, at in sorted(s.observation.peer_clocks.items())],
    ),
)

# With the configured name, because a rename of the interface must not begin new series.
_INTERFACE: tuple[tuple[str, str, Callable[[LinkCounters], float]], ...] = (
    (
        "arpd_interface_receive_bytes_total",
        "Bytes that the link interface received.",
        lambda c: c.rx_bytes,
    ),
    (
        "arpd_interface_transmit_bytes_total",
        "Bytes that the link interface sent.",
        lambda c: c.tx_bytes,
    ),
    (
        "arpd_interface_transmit_packets_total",
        "Packets that the link interface sent.",
        lambda c: c.tx_packets,
    ),
    (
        "arpd_interface_transmit_dropped_packets_total",
        "Packets dropped on the way out.",
        lambda c: c.tx_dropped,
    ),
)

_PLAN: tuple[tuple[str, str, Callable[[Snapshot], _Value]], ...] = (
    (
        "arpd_link_budget_bytes_per_second",
        "Wire bytes per second that the topics may put on the link now.",
        lambda s: s.allocation.capacity_bytes_per_second,
    ),
    (
        "arpd_allowed_ratio",
        "Part of the traffic above the minimum rates that the budget allows; 1 while no topic is slowed.",
        lambda s: s.decision.allowed,
    ),
    (
        "arpd_level_bytes_per_second",
        "Lasting budget that the plan in force was made for.",
        lambda s: s.decision.plan.level_bytes_per_second,
    ),
    (
        "arpd_allocation_status",
        "Status of the allocation. 1 marks the current one.",
        lambda s: states("status", AllocationStatus, s.allocation.status),
    ),
    (
        "arpd_topics_bound_by_memory",
        "Topics whose depth memory limits.",
        lambda s: sum(topic.depth_binding is Binding.MEMORY for topic in s.allocation.topics),
    ),
    (
        "arpd_plan_generation",
        "Generation of the plan in force; 0 before the first.",
        lambda s: s.decision.plan.generation,
    ),
    ("arpd_publishers_managed", "Live publishers that the plan in force covers.", lambda s: s.managed),
    (
        "arpd_publishers_confirmed",
        "Managed publishers that announce the plan in force, or refuse its QoS for good and announce its ceiling.",
        lambda s: s.confirmed,
    ),
    (
        "arpd_publishers_refused",
        "Publishers that refuse the last request; middleware and transient_local refuse for good, but are paced.",
        lambda s: counts("reason", _LASTING, Counter(p.refusal_reason for p in s.observation.publishers)),
    ),
    (
        "arpd_endpoints_pending",
        "Publishers that announce themselves but that the ROS graph does not show.",
        lambda s: s.observation.taken.pending,
    ),
    (
        "arpd_other_daemons",
        "Other arpd daemons in the ROS domain; only one of them drives the robot.",
        lambda s: len(s.observation.other_daemons),
    ),
    (
        "arpd_standing_by",
        "1 while another daemon drives the robot and this one stands by.",
        lambda s: bool(s.observation.active_daemon),
    ),
    (
        "arpd_messages_refused_total",
        "Messages from the network, or parts of them, that arpd refused.",
        lambda s: [
            ({"kind": kind, "reason": reason}, s.observation.taken.refused.get((kind, reason), 0))
            for kind, reason in product(MessageKind, MessageRefusal)
        ],
    ),
)

_DAEMON: tuple[tuple[str, str, Callable[[Snapshot], _Value]], ...] = (
    (
        "arpd_memory_available_bytes",
        "Memory of the robot computer that new work could use.",
        lambda s: s.observation.memory.available_bytes,
    ),
    (
        "arpd_config_last_reload_successful",
        "0 while the last reload was refused and an older configuration is in force.",
        lambda s: not s.config_error,
    ),
    (
        "arpd_config_keys_awaiting_restart",
        "Changed keys that take effect only after a restart.",
        lambda s: len(s.keys_awaiting_restart),
    ),
)

_TOTALS: tuple[tuple[str, str, Callable[[Totals], _Value]], ...] = (
    (
        "arpd_ticks_total",
        "Ticks: each observes, estimates and sends the price; two a second also plan.",
        lambda t: t.ticks + t.ticks_failed,
    ),
    (
        "arpd_tick_failures_total",
        "Ticks that raised an error; the plan in force stays and the journal has the error.",
        lambda t: t.ticks_failed,
    ),
    ("arpd_ticks_late_total", "Ticks that began more than half a period late.", lambda t: t.ticks_late),
    ("arpd_probe_bytes_total", "Wire bytes of the probes.", lambda t: t.probe_bytes),
    ("arpd_peer_reports_total", "Reports of peers that arrived.", lambda t: t.reports),
    ("arpd_events_total", "Lines of the decision log.", lambda t: counts("event", MESSAGE_IDS, t.events_by_kind)),
    ("arpd_plans_total", "Plans made.", lambda t: counts("cause", _CAUSES, t.plans_by_cause)),
    (
        "arpd_refusals_total",
        "Plans and swaps that were due and had to wait.",
        lambda t: counts("reason", ("budget", "dwell"), t.refusals_by_reason),
    ),
    (
        "arpd_apply_failures_total",
        "Plans that a node refused or did not answer; arpd repeats them.",
        lambda t: counts("reason", ("refused", "timeout"), t.applies_by_result),
    ),
    (
        "arpd_solve_failures_total",
        "Solves without an answer, or with one that missed the budget; the closed form answered instead.",
        lambda t: sum(many for (_, outcome), many in t.solves_by_outcome.items() if outcome in ("failed", "disagreed")),
    ),
)

_HISTOGRAMS: tuple[tuple[str, str, Callable[[Totals], Distribution]], ...] = (
    ("arpd_tick_duration_seconds", "Duration of finished ticks.", lambda t: t.durations.ticks),
    (
        "arpd_tick_lateness_seconds",
        "Delay after the planned time at which ticks began; above 0.05 counts as late.",
        lambda t: t.durations.lateness,
    ),
    (
        "arpd_solve_duration_seconds",
        "Duration of solves of the whole program, one for each tick that plans.",
        lambda t: t.durations.solves,
    ),
)

_RELAY: tuple[tuple[str, str, Callable[[RelaySummary], _Value]], ...] = (
    (
        "arpd_relay_other_end_up",
        "1 while the relay's other end is heard and understood.",
        lambda r: r.is_reachable and not r.fault,
    ),
    (
        "arpd_relay_topics",
        "Topics that one side offers, that the other one reads, and that an end refuses, with refused services.",
        lambda r: [
            ({"direction": direction, "state": state}, many)
            for direction, each in (("to_base", r.to_base), ("to_robot", r.to_robot))
            for state, many in (("offered", each.offered), ("refused", len(each.refused)), ("wanted", each.wanted))
        ],
    ),
    (
        "arpd_relay_samples_total",
        "Samples at the robot's end: new, second copies, outdated in an outage, of unknown writers or half a group.",
        lambda r: [
            ({"result": result}, getattr(r, result))
            for result in ("doubled", "incomplete", "outdated", "received", "unknown")
        ],
    ),
    (
        "arpd_relay_calls_failed_total",
        "Calls from the robot's nodes across the link that had no answer.",
        lambda r: counts("reason", (reason.value for reason in FailureReason), r.calls_failed),
    ),
)


class SnapshotCollector(Collector):
    """Makes metric families from the snapshot that is current when Prometheus asks.

    Parameters
    ----------
    snapshot : returns the last snapshot, None before the first tick finished
    clock : monotonic clock of the snapshot's time (s)
    version, python : labels of ``arpd_build_info``
    """

    def __init__(
        self,
        snapshot: Callable[[], Snapshot | None],
        *,
        clock: Callable[[], float] = time.monotonic,
        version: str = __version__,
        python: str = platform.python_version(),
    ) -> None:
        self._snapshot = snapshot
        self._clock = clock
        self._build = {"version": version, "python": python}

    def collect(self) -> Iterator[Metric]:
        """Yield the families in a fixed order; what is not known has none."""
        snapshot = self._snapshot()
        yield InfoMetricFamily("arpd_build", "Version of arpd and of Python.", value=self._build)
        yield family("arpd_ready", "1 once the first tick has finished.", snapshot is not None)
        if snapshot is not None:
            yield from (made for made in self._of(snapshot) if made.samples)

    def _of(self, snapshot: Snapshot) -> Iterator[Metric]:
        age_s = max(0.0, self._clock() - snapshot.finished_at_s)
        yield family("arpd_snapshot_age_seconds", "Time since the last tick finished.", age_s)
        yield _conditions(snapshot, now_s=self._clock())
        for name, text, read in (*_LINK, *_PLAN, *_DAEMON):
            yield family(name, text, read(snapshot))
        yield from _of_interface(snapshot)
        if rmw := snapshot.observation.rmw:
            labels = {"rmw": rmw, "swaps": "no" if snapshot.observation.rmw_refusal else "yes"}
            yield InfoMetricFamily("arpd_rmw", "ROS middleware; if swaps is no, arpd only paces topics.", labels)
        for name, text, total in _TOTALS:
            yield family(name, text, total(snapshot.totals))
        for name, text, distribution in _HISTOGRAMS:
            yield histogram(name, text, distribution(snapshot.totals))
        yield from _of_relay(snapshot)
        yield from topic_metrics(topic_rows(snapshot))


def make_registry(
    snapshot: Callable[[], Snapshot | None], *, clock: Callable[[], float] = time.monotonic
) -> CollectorRegistry:
    """Return a registry with arpd's metrics and the usual ``process_*`` and ``python_info``."""
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(snapshot, clock=clock))
    ProcessCollector(registry=registry)
    PlatformCollector(registry=registry)
    return registry


def _conditions(snapshot: Snapshot, *, now_s: float) -> Metric:
    held = {finding.condition for finding in judge(snapshot, now_s=now_s).findings}
    return family(
        "arpd_condition",
        "1 while arpd judges that the condition holds; wrong where somebody should look.",
        [
            ({"condition": each, "severity": each.severity, "wrong": str(each.is_wrong).lower()}, each in held)
            for each in sorted(Condition)
        ],
    )


def _of_interface(snapshot: Snapshot) -> Iterator[Metric]:
    labels, counters = {"interface": snapshot.interface}, snapshot.observation.counters
    yield family(
        "arpd_link_interface_state",
        "State of the link interface. 1 marks the current one.",
        states("state", InterfaceState, state_of(counters), **labels),
    )
    radio = snapshot.observation.radio_bytes_per_second
    text = "Bit rate at which the radio transmits; only a part of it is usable."
    yield family("arpd_link_radio_bytes_per_second", text, None if radio is None else [(labels, radio)])
    if counters is not None:
        for name, text, read in _INTERFACE:
            yield family(name, text, [(labels, read(counters))])


def _of_relay(snapshot: Snapshot) -> Iterator[Metric]:
    """Yield nothing without two ends, and only the first while the end on the robot is silent."""
    relay = snapshot.observation.relay
    if relay is None and not snapshot.observation.is_relay_silent:
        return
    text = "1 while the relay's end on the robot tells the daemon what it does."
    yield family("arpd_relay_end_up", text, relay is not None)
    if relay is not None:
        for name, text, read in _RELAY:
            yield family(name, text, read(relay))
