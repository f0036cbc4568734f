"""Prometheus metrics, all read from the last snapshot, so that a scrape never sees half a tick."""

from __future__ import annotations

import math
import platform
import time
from collections import Counter
from itertools import product
from typing import TYPE_CHECKING, TypeAlias

from prometheus_client import CollectorRegistry, PlatformCollector, ProcessCollector
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Sample,
)
from prometheus_client.registry import Collector

from arpd import __version__
from arpd.model.allocation import AllocationStatus, Binding
from arpd.model.endpoints import RefusalReason, SwapResult, WithheldCause
from arpd.model.interface import InterfaceState, state_of
from arpd.model.link import CapacityKind, LinkState
from arpd.model.observation import MessageKind, MessageRefusal
from arpd.model.plan import NANOSECONDS_PER_SECOND
from arpd.relay.calls import FailureReason
from arpd.report.conditions import MESSAGE_IDS, Condition
from arpd.report.durations import Distribution
from arpd.report.situation import judge
from arpd.report.topic_rows import topic_rows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from prometheus_client.core import Metric

    from arpd.model.endpoints import PublisherState
    from arpd.report.snapshot import Snapshot
    from arpd.report.topic_rows import TopicRow

_Labels: TypeAlias = dict[str, str]
_Rows: TypeAlias = "Iterable[tuple[_Labels, float]]"  # there may be thousands
# A number, one for each set of labels, a histogram, labels of an info; None is unknown and has no series.
_Value: TypeAlias = "_Rows | float | Distribution | _Labels | None"

# What each family says, in their order. One is a counter if its name ends in ``_total``.
_HELP = {
    "snapshot_age_seconds": "Time since the last tick finished.",
    "condition": "1 while arpd judges that the condition holds; wrong where somebody should look.",
    "link_capacity_bytes_per_second": "Wire bytes per second that the link carries, as estimated.",
    "link_capacity_kind": "Evidence behind the capacity estimate. 1 marks the current one.",
    "link_state": "State of the link. 1 marks the current one.",
    "link_estimate_age_seconds": "Time since the evidence behind the capacity estimate.",
    "link_cross_traffic_bytes_per_second": (
        "Cross traffic, which arpd's topics and probes do not explain; arpd yields at most half of the capacity."
    ),
    "link_queue_delay_seconds": "One-way delay above its minimum of the last 10 seconds.",
    "link_return_delay_seconds": (
        "One-way delay of the peer's reports above its minimum of the last 10 seconds; commands wait as long."
    ),
    "link_delivery_rate_bytes_per_second": "Bytes per second that the peer received over the last 300 ms.",
    "link_loss_ratio": "Share of recent probe packets that never reached a peer.",
    "peers": "Peers heard in the last minute.",
    "peer_report_age_seconds": "Time since the peer's last report.",
    "peer_clock_uncertainty_seconds": (
        "Most error of the difference of the clocks: half the shortest round trip of the last 30 seconds."
    ),
    "link_budget_bytes_per_second": "Wire bytes per second that the topics may put on the link now.",
    "allowed_ratio": "Part of the traffic above the minimum rates that the budget allows; 1 while no topic is slowed.",
    "level_bytes_per_second": "Lasting budget that the plan in force was made for.",
    "allocation_status": "Status of the allocation. 1 marks the current one.",
    "topics_bound_by_memory": "Topics whose depth memory limits.",
    "plan_generation": "Generation of the plan in force; 0 before the first.",
    "publishers_managed": "Live publishers that the plan in force covers.",
    "publishers_confirmed": (
        "Managed publishers that announce the plan in force, or refuse its QoS for good and announce its ceiling."
    ),
    "publishers_refused": (
        "Publishers that refuse the last request; middleware and transient_local refuse for good, but are paced."
    ),
    "endpoints_pending": "Publishers that announce themselves but that the ROS graph does not show.",
    "other_daemons": "Other arpd daemons in the ROS domain; only one of them drives the robot.",
    "standing_by": "1 while another daemon drives the robot and this one stands by.",
    "messages_refused_total": "Messages from the network, or parts of them, that arpd refused.",
    "memory_available_bytes": "Memory of the robot computer that new work could use.",
    "config_last_reload_successful": "0 while the last reload was refused and an older configuration is in force.",
    "config_keys_awaiting_restart": "Changed keys that take effect only after a restart.",
    "link_interface_state": "State of the link interface. 1 marks the current one.",
    "link_radio_bytes_per_second": "Bit rate at which the radio transmits; only a part of it is usable.",
    "interface_receive_bytes_total": "Bytes that the link interface received.",
    "interface_transmit_bytes_total": "Bytes that the link interface sent.",
    "interface_transmit_packets_total": "Packets that the link interface sent.",
    "interface_transmit_dropped_packets_total": "Packets dropped on the way out.",
    "rmw": "ROS middleware; if swaps is no, arpd only paces topics.",
    "ticks_total": "Ticks: each observes, estimates and sends the price; two a second also plan.",
    "tick_failures_total": "Ticks that raised an error; the plan in force stays and the journal has the error.",
    "ticks_late_total": "Ticks that began more than half a period late.",
    "probe_bytes_total": "Wire bytes of the probes.",
    "peer_reports_total": "Reports of peers that arrived.",
    "events_total": "Lines of the decision log.",
    "plans_total": "Plans made.",
    "refusals_total": "Plans and swaps that were due and had to wait.",
    "apply_failures_total": "Plans that a node refused or did not answer; arpd repeats them.",
    "solve_failures_total": (
        "Solves without an answer, or with one that missed the budget; the closed form answered instead."
    ),
    "tick_duration_seconds": "Duration of finished ticks.",
    "tick_lateness_seconds": "Delay after the planned time at which ticks began; above 0.05 counts as late.",
    "solve_duration_seconds": "Duration of solves of the whole program, one for each tick that plans.",
    "relay_end_up": "1 while the relay's end on the robot tells the daemon what it does.",
    "relay_other_end_up": "1 while the relay's other end is heard and understood.",
    "relay_topics": (
        "Topics that one side offers, that the other one reads, and that an end refuses, with refused services."
    ),
    "relay_samples_total": (
        "Samples at the robot's end: new, second copies, outdated in an outage, of unknown writers or half a group."
    ),
    "relay_calls_failed_total": "Calls from the robot's nodes across the link that had no answer.",
}
_HELP_OF_TOPIC = {
    "share_ratio": "Share of link time that the program gives the topic.",
    "planned_min_rate_hertz": (
        "Minimum rate of the plan; the price slows the topic below it only where not all minimum rates fit."
    ),
    "paced_rate_hertz": "Rate that plan and price leave the publisher, as announced; +Inf is unpaced.",
    "confirmed_depth_samples": "DEPTH announced.",
    "confirmed_deadline_seconds": "DEADLINE period announced; +Inf is none.",
    "source_rate_hertz": "Rate at which the application publishes.",
    "published_rate_hertz": "Rate at which messages leave for the link.",
    "payload_bytes": "Mean serialized size of recent messages.",
    "queued_messages": "Messages waiting in the pacing queue.",
    "remote_readers": "Off-host participants that read the topic.",
    "offered_messages_total": "Messages that the application published.",
    "published_messages_total": "Messages written to the link.",
    "publish_blocked_seconds_total": "Time spent in the middleware's publish().",
    "deadlines_missed_total": "Offered DEADLINE periods that passed without a message.",
    "swaps_total": "Writer swaps begun; each replaces the writer by one with other DEPTH or DEADLINE.",
    "swap_failures_total": "Writer swaps that replaced no writer or may have lost messages.",
}
_WITHHELD = "Messages not sent, by cause: ceiling (rate), price, writer that blocked or failed, publisher that closed."
_CAUSES = ("budget", "demand", "down", "memory", "readers", "reload", "start", "takeover", "topics", "up")
_LASTING = set(RefusalReason) - {RefusalReason.NONE}
_NO_FAILURES = {SwapResult.OK, SwapResult.SUPERSEDED, SwapResult.REORDER_POSSIBLE}


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
        yield _family("build", "Version of arpd and of Python.", self._build)
        yield _family("ready", "1 once the first tick has finished.", snapshot is not None)
        if snapshot is None:
            return
        rows = topic_rows(snapshot)
        values = {
            "snapshot_age_seconds": max(0.0, self._clock() - snapshot.finished_at_s),
            "condition": _conditions(snapshot, rows, now_s=self._clock()),
            **_of_link(snapshot),
            **_of_plan(snapshot),
            **_of_interface(snapshot),
            **_totals(snapshot),
            **_of_relay(snapshot),
        }
        for name, text in _HELP.items():
            made = _family(name, text, values.get(name))
            if made.samples:
                yield made
        yield from (made for made in _of_topics(rows) if made.samples)


def make_registry(
    snapshot: Callable[[], Snapshot | None], *, clock: Callable[[], float] = time.monotonic
) -> CollectorRegistry:
    """Return a registry with arpd's metrics and the usual ``process_*`` and ``python_info``."""
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(snapshot, clock=clock))
    ProcessCollector(registry=registry)
    PlatformCollector(registry=registry)
    return registry


def _family(name: str, text: str, value: _Value) -> Metric:
    name = f"arpd_{name}"
    if isinstance(value, dict):
        return InfoMetricFamily(name, text, value)
    if isinstance(value, Distribution):
        buckets = [("+Inf" if math.isinf(bound) else str(bound), count) for bound, count in value.up_to]
        return HistogramMetricFamily(name, text, buckets=buckets, sum_value=value.total_s)
    made = CounterMetricFamily(name, text) if name.endswith("_total") else GaugeMetricFamily(name, text)
    rows = () if value is None else [({}, value)] if isinstance(value, int | float) else value
    # Samples made here share the labels of their row; `add_metric` would copy them.
    made.samples = [Sample(name, labels, float(number)) for labels, number in rows]
    return made


def _states(label: str, known: Iterable[str], current: str, **outer: str) -> _Rows:
    """Return a row for each known state; 1 marks the current one."""
    return [({**outer, label: state}, state == current) for state in sorted({*map(str, known), str(current)})]


def _counts(label: str, known: Iterable[str], found: Mapping[str, float], outer: _Labels | None = None) -> _Rows:
    """Return a row for each known value, from zero so that rate() sees the first; no message can add another."""
    return [({**(outer or {}), label: value}, found.get(value, 0)) for value in sorted(map(str, known))]


def _conditions(snapshot: Snapshot, rows: tuple[TopicRow, ...], *, now_s: float) -> _Rows:
    held = {finding.condition for finding in judge(snapshot, rows=rows, now_s=now_s).findings}
    return [
        ({"condition": each, "severity": each.severity, "wrong": str(each.is_wrong).lower()}, each in held)
        for each in sorted(Condition)
    ]


def _of_link(snapshot: Snapshot) -> dict[str, _Value]:
    link, observation = snapshot.link, snapshot.observation
    return {
        "link_capacity_bytes_per_second": link.capacity_bytes_per_second,
        "link_capacity_kind": _states("kind", CapacityKind, link.kind),
        "link_state": _states("state", LinkState, link.state),
        "link_estimate_age_seconds": link.age_s,
        "link_cross_traffic_bytes_per_second": link.cross_traffic_bytes_per_second,
        "link_queue_delay_seconds": link.queue_delay_s,
        "link_return_delay_seconds": link.return_delay_s,
        "link_delivery_rate_bytes_per_second": link.delivery_rate_bytes_per_second,
        "link_loss_ratio": link.loss_ratio,
        "peers": len(observation.peer_ages_s),
        "peer_report_age_seconds": [({"peer": peer}, age_s) for peer, age_s in sorted(observation.peer_ages_s.items())],
        "peer_clock_uncertainty_seconds": [
            ({"peer": peer}, clock.uncertainty_s) for peer, clock in sorted(observation.peer_clocks.items())
        ],
    }


def _of_plan(snapshot: Snapshot) -> dict[str, _Value]:
    observation, allocation, taken = snapshot.observation, snapshot.allocation, snapshot.observation.taken
    return {
        "link_budget_bytes_per_second": allocation.capacity_bytes_per_second,
        "allowed_ratio": snapshot.decision.allowed,
        "level_bytes_per_second": snapshot.decision.plan.level_bytes_per_second,
        "allocation_status": _states("status", AllocationStatus, allocation.status),
        "topics_bound_by_memory": sum(topic.depth_binding is Binding.MEMORY for topic in allocation.topics),
        "plan_generation": snapshot.decision.plan.generation,
        "publishers_managed": snapshot.managed,
        "publishers_confirmed": snapshot.confirmed,
        "publishers_refused": _counts("reason", _LASTING, Counter(p.refusal_reason for p in observation.publishers)),
        "endpoints_pending": taken.pending,
        "other_daemons": len(observation.other_daemons),
        "standing_by": bool(observation.active_daemon),
        "messages_refused_total": [
            ({"kind": kind, "reason": reason}, taken.refused.get((kind, reason), 0))
            for kind, reason in product(MessageKind, MessageRefusal)
        ],
        "memory_available_bytes": observation.memory.available_bytes,
        "config_last_reload_successful": not snapshot.config_error,
        "config_keys_awaiting_restart": len(snapshot.keys_awaiting_restart),
    }


def _of_interface(snapshot: Snapshot) -> dict[str, _Value]:
    """Return what the interface does, with its configured name, because a rename must not begin new series."""
    labels, observation = {"interface": snapshot.interface}, snapshot.observation
    swaps = "no" if observation.rmw_refusal else "yes"
    found: dict[str, _Value] = {
        "link_interface_state": _states("state", InterfaceState, state_of(observation.counters), **labels),
        "rmw": {"rmw": observation.rmw, "swaps": swaps} if observation.rmw else None,
    }
    if (radio := observation.radio_bytes_per_second) is not None:
        found["link_radio_bytes_per_second"] = [(labels, radio)]
    if (counters := observation.counters) is not None:
        found["interface_receive_bytes_total"] = [(labels, counters.rx_bytes)]
        found["interface_transmit_bytes_total"] = [(labels, counters.tx_bytes)]
        found["interface_transmit_packets_total"] = [(labels, counters.tx_packets)]
        found["interface_transmit_dropped_packets_total"] = [(labels, counters.tx_dropped)]
    return found


def _totals(snapshot: Snapshot) -> dict[str, _Value]:
    totals = snapshot.totals
    return {
        "ticks_total": totals.ticks + totals.ticks_failed,
        "tick_failures_total": totals.ticks_failed,
        "ticks_late_total": totals.ticks_late,
        "probe_bytes_total": totals.probe_bytes,
        "peer_reports_total": totals.reports,
        "events_total": _counts("event", MESSAGE_IDS, totals.events_by_kind),
        "plans_total": _counts("cause", _CAUSES, totals.plans_by_cause),
        "refusals_total": _counts("reason", ("budget", "dwell"), totals.refusals_by_reason),
        "apply_failures_total": _counts("reason", ("refused", "timeout"), totals.applies_by_result),
        "solve_failures_total": sum(
            many for (_, outcome), many in totals.solves_by_outcome.items() if outcome in {"failed", "disagreed"}
        ),
        "tick_duration_seconds": totals.durations.ticks,
        "tick_lateness_seconds": totals.durations.lateness,
        "solve_duration_seconds": totals.durations.solves,
    }


def _of_relay(snapshot: Snapshot) -> dict[str, _Value]:
    """Return nothing without two ends, and only the first while the end on the robot is silent."""
    relay = snapshot.observation.relay
    if relay is None:
        return {"relay_end_up": False} if snapshot.observation.is_relay_silent else {}
    return {
        "relay_end_up": True,
        "relay_other_end_up": relay.is_reachable and not relay.fault,
        "relay_topics": [
            ({"direction": direction, "state": state}, many)
            for direction, each in (("to_base", relay.to_base), ("to_robot", relay.to_robot))
            for state, many in (("offered", each.offered), ("refused", len(each.refused)), ("wanted", each.wanted))
        ],
        "relay_samples_total": [
            ({"result": result}, getattr(relay, result))
            for result in ("doubled", "incomplete", "outdated", "received", "unknown")
        ],
        "relay_calls_failed_total": _counts("reason", (each.value for each in FailureReason), relay.calls_failed),
    }


def _of_topics(rows: tuple[TopicRow, ...]) -> Iterator[Metric]:
    """Yield about twenty series for each publisher, in the order of the rows."""
    labels = [_labels(row.publisher) for row in rows]
    values = [_of_topic(row) for row in rows]
    for name, text in _HELP_OF_TOPIC.items():
        found = ((of, value[name]) for of, value in zip(labels, values, strict=True))
        yield _family(f"topic_{name}", text, ((of, value) for of, value in found if value is not None))
    withheld = (
        series
        for of, row in zip(labels, rows, strict=True)
        for series in _counts("cause", WithheldCause, row.publisher.withheld_by_cause, of)
    )
    yield _family("topic_withheld_messages_total", _WITHHELD, withheld)


def _labels(publisher: PublisherState) -> _Labels:
    return {"topic": publisher.topic, "node": publisher.node, "direction": str(publisher.direction)}


def _of_topic(row: TopicRow) -> dict[str, float | None]:
    publisher, swaps = row.publisher, row.publisher.swaps_by_result
    return {
        "share_ratio": row.allocation.share if row.allocation else None,
        "planned_min_rate_hertz": row.planned.min_rate_hz if row.planned else None,
        "paced_rate_hertz": publisher.paced_rate_hz,
        "confirmed_depth_samples": publisher.depth,
        "confirmed_deadline_seconds": publisher.deadline_ns / NANOSECONDS_PER_SECOND or math.inf,
        "source_rate_hertz": publisher.source_rate_hz,
        "published_rate_hertz": publisher.published_rate_hz,
        "payload_bytes": publisher.payload_bytes,
        "queued_messages": publisher.queued,
        "remote_readers": publisher.remote_readers,
        "offered_messages_total": publisher.offered,
        "published_messages_total": publisher.published,
        "publish_blocked_seconds_total": publisher.blocked_s,
        "deadlines_missed_total": publisher.deadlines_missed,
        "swaps_total": publisher.swaps_begun,
        "swap_failures_total": sum(many for result, many in swaps.items() if result not in _NO_FAILURES),
    }
