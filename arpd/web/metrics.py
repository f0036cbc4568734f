"""Prometheus metrics, every one read from the last snapshot: a scrape never sees half a tick."""

from __future__ import annotations

import math
import platform
import time
from collections import Counter
from typing import TYPE_CHECKING

from prometheus_client import CollectorRegistry, PlatformCollector, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily
from prometheus_client.registry import Collector

from arpd.model import NANOSECONDS_PER_SECOND, AllocationStatus, Binding, CapacityKind, LinkState
from arpd.refusal import RefusalReason
from arpd.settings import Backend
from arpd.swap import SwapResult
from arpd.version import VERSION
from arpd.web.families import counter_by
from arpd.web.intake_metrics import intake_metrics
from arpd.web.link_metrics import link_metrics
from arpd.web.reader_metrics import reader_metrics
from arpd.web.status import topic_rows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from enum import StrEnum

    from prometheus_client.metrics_core import Metric

    from arpd.model import PublisherState, TopicAllocation, TopicPlan
    from arpd.snapshot import Snapshot, Totals
    from arpd.web.status import TopicRow

_TOPIC_LABELS = ("topic", "node", "direction")

# Label values that are known beforehand start at zero, so that rate() sees their first increase.
_CAUSES = ("demand", "down", "memory", "readers", "reload", "start", "takeover", "topics", "up")
_REASONS = ("budget", "dwell")
_APPLIED = ("ok", "refused", "timeout", "unreachable")
_RELOADED = ("failed", "ok")
_EFFECTS = ("awaiting_restart", "in_force")


def _deadline_s(deadline_ns: int) -> float:
    return deadline_ns / NANOSECONDS_PER_SECOND if deadline_ns else math.inf


_GAUGES: tuple[tuple[str, str, Callable[[Snapshot], float]], ...] = (
    (
        "arpd_link_capacity_bytes_per_second",
        "Wire bytes per second the link is believed to carry.",
        lambda s: s.link.capacity_bytes_per_second,
    ),
    (
        "arpd_link_foreign_bytes_per_second",
        "What the link carries that arpd's topics and probes do not explain; at most half of the capacity is yielded.",
        lambda s: s.link.foreign_bytes_per_second,
    ),
    (
        "arpd_link_queue_delay_seconds",
        "One-way delay above its minimum of the last 10 seconds.",
        lambda s: s.link.queue_delay_s,
    ),
    (
        "arpd_link_delivery_rate_bytes_per_second",
        "What the peer received over the last 300 ms.",
        lambda s: s.link.delivery_rate_bytes_per_second,
    ),
    (
        "arpd_link_packet_overhead_seconds",
        "Link time every packet costs beyond its bytes.",
        lambda s: s.link.packet_overhead_s,
    ),
    ("arpd_link_estimate_age_seconds", "Time since the evidence behind the capacity estimate.", lambda s: s.link.age_s),
    ("arpd_link_app_limited", "1 when traffic alone says nothing about the capacity.", lambda s: s.link.is_app_limited),
    ("arpd_memory_total_bytes", "Memory of the robot computer.", lambda s: s.observation.memory.total_bytes),
    (
        "arpd_memory_available_bytes",
        "Memory of the robot computer that new work could use.",
        lambda s: s.observation.memory.available_bytes,
    ),
    (
        "arpd_other_daemons",
        "Further arpd daemons in the ROS domain; only the one that has run longest drives the robot.",
        lambda s: len(s.observation.other_daemons),
    ),
    (
        "arpd_standing_by",
        "1 while another daemon drives the robot in this one's place.",
        lambda s: bool(s.observation.superior),
    ),
    ("arpd_gate_ratio", "Factor on every paced rate above its floor.", lambda s: s.decision.gate),
    (
        "arpd_level_bytes_per_second",
        "Capacity the plan in force was made for.",
        lambda s: s.decision.plan.level_bytes_per_second,
    ),
    (
        "arpd_plan_generation",
        "Generation of the plan in force; 0 before the first.",
        lambda s: s.decision.plan.generation,
    ),
    ("arpd_plan_topics", "Topics the plan in force covers.", lambda s: len(s.decision.plan.topics)),
    (
        "arpd_publishers_managed",
        "Live publishers the plan in force covers.",
        lambda s: sum(row.planned is not None for row in topic_rows(s)),
    ),
    (
        "arpd_publishers_confirmed",
        "Managed publishers that announce the plan in force, or refuse its QoS for good and announce its rate.",
        lambda s: s.confirmed,
    ),
    (
        "arpd_allocation_capacity_bytes_per_second",
        "Capacity the program was last solved for, after headroom and foreign traffic.",
        lambda s: s.allocation.capacity_bytes_per_second,
    ),
    ("arpd_solve_duration_seconds", "Time the last solve took.", lambda s: s.allocation.solve_s),
    ("arpd_tick_duration_seconds", "Time the last finished tick took.", lambda s: s.tick_s),
    (
        "arpd_lease_seconds",
        "Silence of the daemon after which publishers return to their application's QoS; +Inf is never.",
        lambda s: s.lease_s or math.inf,
    ),
    (
        "arpd_config_last_reload_successful",
        "0 while the last reload was refused and an older configuration is in force.",
        lambda s: not s.config_error,
    ),
    (
        "arpd_config_last_reload_success_timestamp_seconds",
        "Unix time at which the configuration in force was read.",
        lambda s: s.config_loaded_at_s,
    ),
    (
        "arpd_config_keys_awaiting_restart",
        "Keys whose value in the file last read takes effect after a restart.",
        lambda s: len(s.keys_awaiting_restart),
    ),
)

_COUNTERS: tuple[tuple[str, str, Callable[[Totals], float]], ...] = (
    ("arpd_ticks", "Ticks that finished.", lambda t: t.ticks),
    ("arpd_ticks_failed", "Ticks that raised.", lambda t: t.ticks_failed),
    ("arpd_ticks_late", "Ticks that started more than half a period late.", lambda t: t.ticks_late),
    (
        "arpd_cross_check_disagreements",
        "Answers of the solver that the exact one contradicted.",
        lambda t: t.cross_check_disagreements,
    ),
    ("arpd_probes", "Probe trains and pings put on the link.", lambda t: t.probes),
    ("arpd_probe_bytes", "Wire bytes of the probes.", lambda t: t.probe_bytes),
    ("arpd_peer_reports", "Receiver reports that arrived.", lambda t: t.reports),
)

_COUNTERS_BY: tuple[tuple[str, str, str, tuple[str, ...], Callable[[Totals], Mapping[str, int]]], ...] = (
    ("arpd_levels", "New plans.", "cause", _CAUSES, lambda t: t.levels_by_cause),
    ("arpd_refusals", "Plan changes wanted but refused.", "reason", _REASONS, lambda t: t.refusals_by_reason),
    ("arpd_applies", "Parameter calls to publishers.", "result", _APPLIED, lambda t: t.applies_by_result),
    ("arpd_config_reloads", "Configuration reloads.", "result", _RELOADED, lambda t: t.reloads_by_result),
    (
        "arpd_config_changed_keys",
        "Keys that reloads changed: in force at once, or after a restart.",
        "effect",
        _EFFECTS,
        lambda t: t.changed_keys_by_effect,
    ),
)

_STATE_SETS: tuple[tuple[str, str, str, type[StrEnum], Callable[[Snapshot], str]], ...] = (
    ("arpd_link_capacity_kind", "How the capacity was estimated.", "kind", CapacityKind, lambda s: s.link.kind),
    ("arpd_link_state", "What the link is doing.", "state", LinkState, lambda s: s.link.state),
    (
        "arpd_allocation_status",
        "Whether the program could keep all constraints.",
        "status",
        AllocationStatus,
        lambda s: s.allocation.status,
    ),
    ("arpd_allocation_binding", "Binding constraint in all.", "binding", Binding, lambda s: s.allocation.binding),
    ("arpd_allocation_backend", "Solver that answered last.", "backend", Backend, lambda s: s.allocation.backend),
)

_ALLOCATION_GAUGES: tuple[tuple[str, str, Callable[[TopicAllocation], float]], ...] = (
    (
        "arpd_topic_max_rate_hertz",
        "Rmax: the rate the topic would reach with the link to itself.",
        lambda a: a.max_rate_hz,
    ),
    ("arpd_topic_share_ratio", "Share of link time the program gives the topic.", lambda a: a.share),
)

_PLAN_GAUGES: tuple[tuple[str, str, Callable[[TopicPlan], float]], ...] = (
    ("arpd_topic_planned_rate_hertz", "Publish rate of the plan; +Inf is unpaced.", lambda p: p.rate_hz),
    ("arpd_topic_planned_min_rate_hertz", "Rate below which the gate does not push.", lambda p: p.min_rate_hz),
    ("arpd_topic_planned_depth_samples", "DEPTH of the plan.", lambda p: p.depth),
    (
        "arpd_topic_planned_deadline_seconds",
        "Offered DEADLINE period of the plan; +Inf is none.",
        lambda p: _deadline_s(p.deadline_ns),
    ),
)

_PUBLISHER_GAUGES: tuple[tuple[str, str, Callable[[PublisherState], float]], ...] = (
    ("arpd_topic_confirmed_rate_hertz", "Publish rate announced; +Inf is unpaced.", lambda p: p.rate_hz),
    ("arpd_topic_confirmed_depth_samples", "DEPTH announced.", lambda p: p.depth),
    (
        "arpd_topic_confirmed_deadline_seconds",
        "DEADLINE period announced; +Inf is none.",
        lambda p: _deadline_s(p.deadline_ns),
    ),
    (
        "arpd_topic_confirmed_generation",
        "Plan generation the announced settings came from; 0 is the application's own.",
        lambda p: p.generation,
    ),
    ("arpd_topic_source_rate_hertz", "Rate at which the application publishes.", lambda p: p.source_rate_hz),
    ("arpd_topic_payload_bytes", "Mean serialized size of recent messages.", lambda p: p.payload_bytes),
    ("arpd_topic_queued_messages", "Messages waiting in the pacing queue.", lambda p: p.queued),
    ("arpd_topic_remote_readers", "Off-host participants that read the topic.", lambda p: p.remote_readers),
    ("arpd_topic_refused", "1 while the last request stands refused.", lambda p: bool(p.refusal)),
    ("arpd_topic_announcement_age_seconds", "Time since the publisher's announcement.", lambda p: p.age_s),
)

_PUBLISHER_COUNTERS: tuple[tuple[str, str, Callable[[PublisherState], float]], ...] = (
    ("arpd_topic_offered_messages", "Messages the application gave.", lambda p: p.offered),
    ("arpd_topic_published_messages", "Messages written to the link.", lambda p: p.published),
    ("arpd_topic_withheld_messages", "Messages pacing chose not to send.", lambda p: p.withheld),
    ("arpd_topic_publish_blocked_seconds", "Time spent in the middleware's publish().", lambda p: p.blocked_s),
)

_BINDINGS: tuple[tuple[str, str, Callable[[TopicAllocation], Binding]], ...] = (
    ("arpd_topic_rate_binding", "Constraint that stopped the rate.", lambda a: a.binding),
    ("arpd_topic_depth_binding", "Constraint that stopped the depth.", lambda a: a.depth_binding),
)


class SnapshotCollector(Collector):
    """Makes the metric families of the snapshot that is current when Prometheus asks.

    Parameters
    ----------
    snapshot : returns the last snapshot, None before the first tick finished
    clock : monotonic clock the snapshot was stamped with (s)
    version, python : labels of ``arpd_build_info``
    """

    def __init__(
        self,
        snapshot: Callable[[], Snapshot | None],
        *,
        clock: Callable[[], float] = time.monotonic,
        version: str = VERSION,
        python: str = platform.python_version(),
    ) -> None:
        self._snapshot = snapshot
        self._clock = clock
        self._build = {"version": version, "python": python}

    def collect(self) -> Iterator[Metric]:
        """Yield the families in a fixed order, their series sorted by label."""
        snapshot = self._snapshot()
        yield InfoMetricFamily("arpd_build", "Version of arpd and of Python.", value=self._build)
        yield _gauge("arpd_ready", "1 once the first tick has finished.", snapshot is not None)
        if snapshot is None:
            return
        age_s = max(0.0, self._clock() - snapshot.finished_at_s)
        yield _gauge("arpd_snapshot_age_seconds", "Time since the last tick finished.", age_s)
        yield from _of_daemon(snapshot)
        yield from _of_totals(snapshot.totals)
        yield from link_metrics(snapshot)
        yield from _of_topics(topic_rows(snapshot))
        yield from reader_metrics(snapshot)
        yield from intake_metrics(snapshot)


def make_registry(snapshot: Callable[[], Snapshot | None]) -> CollectorRegistry:
    """Return a registry with arpd's metrics and the usual ``process_*`` and ``python_info``."""
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(snapshot))
    ProcessCollector(registry=registry)
    PlatformCollector(registry=registry)
    return registry


def _of_daemon(snapshot: Snapshot) -> Iterator[Metric]:
    for name, text, read in _GAUGES:
        yield _gauge(name, text, read(snapshot))
    for name, text, label, states, current in _STATE_SETS:
        family = GaugeMetricFamily(name, f"{text} 1 marks what holds.", labels=(label,))
        for state in sorted({*states, current(snapshot)}):
            family.add_metric((state,), state == current(snapshot))
        yield family
    refused = GaugeMetricFamily(
        "arpd_publishers_refused",
        "Publishers whose last request stands refused; middleware and transient_local last: paced and gated only.",
        labels=("reason",),
    )
    reasons = Counter(row.publisher.refusal_reason for row in topic_rows(snapshot))
    for reason in sorted(set(RefusalReason) - {RefusalReason.NONE}):
        refused.add_metric((reason,), reasons[reason])
    yield refused
    topics = GaugeMetricFamily(
        "arpd_graph_topics", "Topics that cross the link, managed or not.", labels=("direction",)
    )
    topics.add_metric(("actuation",), snapshot.observation.actuation_topics)
    topics.add_metric(("sensing",), snapshot.observation.sensing_topics)
    yield topics
    observation = snapshot.observation
    if observation.rmw:
        swaps = "no" if observation.rmw_refusal else "yes"
        labels = {"rmw": observation.rmw, "swaps": swaps}
        yield InfoMetricFamily("arpd_rmw", "Middleware of ROS; without swaps, topics are paced and gated only.", labels)


def _of_totals(totals: Totals) -> Iterator[Metric]:
    for name, text, read in _COUNTERS:
        yield CounterMetricFamily(name, text, value=read(totals))
    for name, text, label, known, read_by in _COUNTERS_BY:
        yield counter_by(name, text, (label,), (((), known, read_by(totals)),))
    solves = CounterMetricFamily("arpd_solves", "Solves of the program.", labels=("backend", "outcome"))
    for (backend, outcome), count in sorted(totals.solves_by_outcome.items()):
        solves.add_metric((backend, outcome), count)
    yield solves


def _of_topics(rows: tuple[TopicRow, ...]) -> Iterator[Metric]:
    publishers = [(_labels(row), row.publisher) for row in rows]
    planned = [(_labels(row), row.planned) for row in rows if row.planned is not None]
    allocated = [(_labels(row), row.allocation) for row in rows if row.allocation is not None]
    for name, text, read_row in _ALLOCATION_GAUGES:
        yield _topic_gauge(name, text, ((labels, read_row(a)) for labels, a in allocated))
    for name, text, read_plan in _PLAN_GAUGES:
        yield _topic_gauge(name, text, ((labels, read_plan(p)) for labels, p in planned))
    for name, text, read_state in _PUBLISHER_GAUGES:
        yield _topic_gauge(name, text, ((labels, read_state(p)) for labels, p in publishers))
    for name, text, read_total in _PUBLISHER_COUNTERS:
        counter = CounterMetricFamily(name, text, labels=_TOPIC_LABELS)
        for labels, publisher in publishers:
            counter.add_metric(labels, read_total(publisher))
        yield counter
    for name, text, binding_of in _BINDINGS:
        family = GaugeMetricFamily(name, f"{text} 1 marks what holds.", labels=(*_TOPIC_LABELS, "binding"))
        for labels, allocation in allocated:
            for binding in sorted(Binding):
                family.add_metric((*labels, binding), binding is binding_of(allocation))
        yield family
    yield counter_by(
        "arpd_topic_swaps",
        "QoS swaps of the publisher.",
        (*_TOPIC_LABELS, "result"),
        ((labels, tuple(SwapResult), publisher.swaps_by_result) for labels, publisher in publishers),
    )


def _labels(row: TopicRow) -> tuple[str, ...]:
    return row.publisher.topic, row.publisher.node, row.publisher.direction


def _gauge(name: str, text: str, value: float) -> GaugeMetricFamily:
    return GaugeMetricFamily(name, text, value=float(value))


def _topic_gauge(name: str, text: str, series: Iterable[tuple[tuple[str, ...], float]]) -> GaugeMetricFamily:
    family = GaugeMetricFamily(name, text, labels=_TOPIC_LABELS)
    for labels, value in series:
        family.add_metric(labels, value)
    return family
