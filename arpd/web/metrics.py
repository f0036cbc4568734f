"""Prometheus metrics, all read from the last snapshot, so that a scrape never sees half a tick."""

from __future__ import annotations

import math
import platform
import time
from collections import Counter
from itertools import product
from typing import TYPE_CHECKING

from prometheus_client import CollectorRegistry, PlatformCollector, ProcessCollector
from prometheus_client.core import InfoMetricFamily
from prometheus_client.registry import Collector

from arpd import __version__
from arpd.model.allocation import AllocationStatus, Binding
from arpd.model.endpoints import RefusalReason
from arpd.model.link import CapacityKind, LinkState
from arpd.model.observation import MessageKind, MessageRefusal
from arpd.model.settings import Backend
from arpd.report.topic_rows import topic_rows
from arpd.web.families import counter_of, gauge, gauge_by, gauge_of
from arpd.web.link_metrics import link_metrics
from arpd.web.relay_metrics import relay_metrics
from arpd.web.topic_metrics import topic_metrics
from arpd.web.total_metrics import total_metrics

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from enum import StrEnum

    from prometheus_client.metrics_core import Metric

    from arpd.report.snapshot import Snapshot

_GAUGES: tuple[tuple[str, str, Callable[[Snapshot], float]], ...] = (
    (
        "arpd_link_capacity_bytes_per_second",
        "Wire bytes per second that the link carries, as estimated.",
        lambda s: s.link.capacity_bytes_per_second,
    ),
    (
        "arpd_link_foreign_bytes_per_second",
        "Cross traffic, which arpd's topics and probes do not explain; arpd yields at most half of the capacity.",
        lambda s: s.link.cross_traffic_bytes_per_second,
    ),
    (
        "arpd_link_queue_delay_seconds",
        "One-way delay above its minimum of the last 10 seconds.",
        lambda s: s.link.queue_delay_s,
    ),
    (
        "arpd_link_delivery_rate_bytes_per_second",
        "Bytes per second that the peer received over the last 300 ms.",
        lambda s: s.link.delivery_rate_bytes_per_second,
    ),
    (
        "arpd_link_packet_overhead_seconds",
        "Link time that every packet costs beyond its bytes.",
        lambda s: s.link.packet_overhead_s,
    ),
    ("arpd_link_estimate_age_seconds", "Time since the evidence behind the capacity estimate.", lambda s: s.link.age_s),
    (
        "arpd_link_app_limited",
        "1 while the traffic is too small to show the capacity.",
        lambda s: s.link.is_app_limited,
    ),
    ("arpd_memory_total_bytes", "Memory of the robot computer.", lambda s: s.observation.memory.total_bytes),
    (
        "arpd_memory_available_bytes",
        "Memory of the robot computer that new work could use.",
        lambda s: s.observation.memory.available_bytes,
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
        "arpd_link_budget_bytes_per_second",
        "Wire bytes per second that the topics may put on the link now.",
        lambda s: s.allocation.capacity_bytes_per_second,
    ),
    (
        "arpd_gate_ratio",
        "Part of the traffic above the floors that the budget admits; 1 while no topic is slowed.",
        lambda s: s.decision.gate,
    ),
    (
        "arpd_level_bytes_per_second",
        "Lasting budget that the plan in force was made for.",
        lambda s: s.decision.plan.level_bytes_per_second,
    ),
    (
        "arpd_plan_generation",
        "Generation of the plan in force; 0 before the first.",
        lambda s: s.decision.plan.generation,
    ),
    ("arpd_plan_topics", "Topics that the plan in force covers.", lambda s: len(s.decision.plan.topics)),
    (
        "arpd_publishers_managed",
        "Live publishers that the plan in force covers.",
        lambda s: sum(row.planned is not None for row in topic_rows(s)),
    ),
    (
        "arpd_publishers_confirmed",
        "Managed publishers that announce the plan in force, or refuse its QoS for good and announce its ceiling.",
        lambda s: s.confirmed,
    ),
    (
        "arpd_allocation_capacity_bytes_per_second",
        "The same as arpd_link_budget_bytes_per_second, under its older name.",
        lambda s: s.allocation.capacity_bytes_per_second,
    ),
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
        "Changed keys that take effect only after a restart.",
        lambda s: len(s.keys_awaiting_restart),
    ),
)
_STATE_SETS: tuple[tuple[str, str, str, type[StrEnum], Callable[[Snapshot], str]], ...] = (
    ("arpd_link_capacity_kind", "Evidence behind the capacity estimate.", "kind", CapacityKind, lambda s: s.link.kind),
    ("arpd_link_state", "State of the link.", "state", LinkState, lambda s: s.link.state),
    ("arpd_allocation_status", "Status of the allocation.", "status", AllocationStatus, lambda s: s.allocation.status),
    (
        "arpd_allocation_binding",
        "Constraint that binds the allocation as a whole.",
        "binding",
        Binding,
        lambda s: s.allocation.binding,
    ),
    ("arpd_allocation_backend", "Solver that answered last.", "backend", Backend, lambda s: s.allocation.backend),
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
        """Yield the families in a fixed order, their series sorted by label."""
        snapshot = self._snapshot()
        yield InfoMetricFamily("arpd_build", "Version of arpd and of Python.", value=self._build)
        yield gauge("arpd_ready", "1 once the first tick has finished.", snapshot is not None)
        if snapshot is None:
            return
        age_s = max(0.0, self._clock() - snapshot.finished_at_s)
        yield gauge("arpd_snapshot_age_seconds", "Time since the last tick finished.", age_s)
        yield from _of_daemon(snapshot)
        yield from total_metrics(snapshot.totals)
        yield from link_metrics(snapshot)
        yield from relay_metrics(snapshot.observation)
        yield from topic_metrics(topic_rows(snapshot), now_s=snapshot.observation.now_s)
        yield from refusal_metrics(snapshot)


def make_registry(snapshot: Callable[[], Snapshot | None]) -> CollectorRegistry:
    """Return a registry with arpd's metrics and the usual ``process_*`` and ``python_info``."""
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(snapshot))
    ProcessCollector(registry=registry)
    PlatformCollector(registry=registry)
    return registry


def _of_daemon(snapshot: Snapshot) -> Iterator[Metric]:
    for name, text, read in _GAUGES:
        yield gauge(name, text, read(snapshot))
    for name, text, label, states, current in _STATE_SETS:
        holds = current(snapshot)
        yield gauge_by(name, text, label, {*states, holds}, (({}, holds),))
    reasons = Counter(row.publisher.refusal_reason for row in topic_rows(snapshot))
    yield gauge_of(
        "arpd_publishers_refused",
        "Publishers that refuse the last request; middleware and transient_local refuse for good, but are paced.",
        (({"reason": reason}, reasons[reason]) for reason in sorted(set(RefusalReason) - {RefusalReason.NONE})),
    )
    observation = snapshot.observation
    counts = {"actuation": observation.actuation_topics, "sensing": observation.sensing_topics}
    series = (({"direction": direction}, count) for direction, count in counts.items())
    yield gauge_of("arpd_graph_topics", "Topics that cross the link, managed or not.", series)
    if observation.rmw:
        swaps = "no" if observation.rmw_refusal else "yes"
        labels = {"rmw": observation.rmw, "swaps": swaps}
        yield InfoMetricFamily("arpd_rmw", "ROS middleware; if swaps is no, arpd only paces topics.", labels)


def refusal_metrics(snapshot: Snapshot) -> Iterator[Metric]:
    """Yield the families in a fixed order; no message from the network can add a value to a label."""
    taken = snapshot.observation.taken
    yield counter_of(
        "arpd_messages_refused",
        "Messages from the network, or parts of them, that arpd refused.",
        (
            ({"kind": kind, "reason": reason}, taken.refused.get((kind, reason), 0))
            for kind, reason in product(MessageKind, MessageRefusal)
        ),
    )
    text = "Publishers that announce themselves but that the ROS graph does not show."
    yield gauge("arpd_endpoints_pending", text, taken.pending)
