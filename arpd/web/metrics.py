"""Prometheus metrics, all read from the last snapshot, so that a scrape never sees half a tick."""

from __future__ import annotations

import math
import platform
import time
from collections import Counter
from itertools import chain, product
from typing import TYPE_CHECKING, TypeAlias

from prometheus_client import CollectorRegistry, Histogram, PlatformCollector, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric, Sample
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
from arpd.report.situation import judge
from arpd.report.topic_rows import Topic, topic_rows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from arpd.report.snapshot import Snapshot

_Labels: TypeAlias = dict[str, str]
_Rows: TypeAlias = "Iterable[tuple[_Labels, float]]"  # there may be thousands
# A number, one for each set of labels, labels of an info; None is unknown and has no series.
_Value: TypeAlias = "_Rows | float | _Labels | None"

_CAUSES = ("budget", "demand", "down", "memory", "readers", "reload", "start", "takeover", "topics", "up")
_LASTING = set(RefusalReason) - {RefusalReason.NONE}
_NO_FAILURES = {SwapResult.OK, SwapResult.SUPERSEDED, SwapResult.REORDER_POSSIBLE}


class SnapshotCollector(Collector):
    """Makes metric families from the snapshot that is current when Prometheus asks; none before the first tick."""

    def __init__(self, snapshot: Callable[[], Snapshot | None], *, clock: Callable[[], float] = time.monotonic) -> None:
        self._snapshot = snapshot
        self._clock = clock

    def collect(self) -> Iterator[Metric]:
        """Yield the families in a fixed order; what is not known has none."""
        snapshot = self._snapshot()
        build = {"version": __version__, "python": platform.python_version()}
        yield _family("build", "Version of arpd and of Python.", build)
        yield _family("ready", "1 once the first tick has finished.", snapshot is not None)
        if snapshot is None:
            return
        rows = topic_rows(snapshot)
        held = {finding.condition for finding in judge(snapshot, rows=rows, now_s=self._clock()).findings}
        yield _family(
            "condition",
            "1 while arpd judges that the condition holds; wrong where somebody should look.",
            [
                ({"condition": each, "severity": each.severity, "wrong": str(each.is_wrong).lower()}, each in held)
                for each in sorted(Condition)
            ],
        )
        parts = (part(snapshot) for part in (_of_link, _of_plan, _of_interface, _totals, _of_relay))
        yield from (made for made in chain(*parts, _of_topics(rows)) if made.samples)


def make_registry(
    snapshot: Callable[[], Snapshot | None],
    *,
    clock: Callable[[], float] = time.monotonic,
    durations: Iterable[Histogram] = (),
) -> CollectorRegistry:
    """Return a registry with arpd's metrics and the usual ``process_*`` and ``python_info``."""
    registry = CollectorRegistry()
    for collector in (SnapshotCollector(snapshot, clock=clock), *durations):
        registry.register(collector)
    ProcessCollector(registry=registry)
    PlatformCollector(registry=registry)
    return registry


def _family(name: str, text: str, value: _Value) -> Metric:
    name = f"arpd_{name}"
    if isinstance(value, dict):
        return InfoMetricFamily(name, text, value)
    made = CounterMetricFamily(name, text) if name.endswith("_total") else GaugeMetricFamily(name, text)
    rows = () if value is None else [({}, value)] if isinstance(value, int | float) else value
    # Samples made here share the labels of their row; `add_metric` would copy them.
    made.samples = [Sample(name, labels, float(number)) for labels, number in rows]
    return made


def _states(label: str, known: Iterable[str], current: str, **outer: str) -> _Rows:
    return [({**outer, label: state}, state == current) for state in sorted({*map(str, known), str(current)})]


def _counts(label: str, known: Iterable[str], found: Mapping[str, float], outer: _Labels | None = None) -> _Rows:
    """Return a row for each known value, from zero so that rate() sees the first; no message can add another."""
    return [({**(outer or {}), label: value}, found.get(value, 0)) for value in sorted(map(str, known))]


def _of_link(snapshot: Snapshot) -> Iterator[Metric]:
    link, observation = snapshot.link, snapshot.observation
    yield _family(
        "link_capacity_bytes_per_second", "Wire bytes per second that the link carries.", link.capacity_bytes_per_second
    )
    yield _family(
        "link_capacity_kind", "1 marks the evidence of the estimate.", _states("kind", CapacityKind, link.kind)
    )
    yield _family("link_state", "1 marks the state of the link.", _states("state", LinkState, link.state))
    yield _family("link_estimate_age_seconds", "Time since the evidence behind the capacity estimate.", link.age_s)
    yield _family(
        "link_cross_traffic_bytes_per_second",
        "Cross traffic, which arpd's topics and probes do not explain; arpd yields at most half of the capacity.",
        link.cross_traffic_bytes_per_second,
    )
    yield _family("link_queue_delay_seconds", "One-way delay above its minimum of the last 10 s.", link.queue_delay_s)
    text = "One-way delay of the peer's reports above its minimum of the last 10 s; commands wait as long."
    yield _family("link_return_delay_seconds", text, link.return_delay_s)
    text = "Bytes per second that the peer received over the last 300 ms; without one, those that left this host."
    yield _family("link_delivery_rate_bytes_per_second", text, link.delivery_rate_bytes_per_second)
    yield _family("link_loss_ratio", "Share of recent probe packets that never reached a peer.", link.loss_ratio)
    yield _family("peers", "Peers heard in the last minute.", len(observation.peer_ages_s))
    ages = [({"peer": peer}, age_s) for peer, age_s in sorted(observation.peer_ages_s.items())]
    yield _family("peer_report_age_seconds", "Time since the peer's last report.", ages)
    yield _family(
        "peer_clock_uncertainty_seconds",
        "Most error of the difference of the clocks: half the shortest round trip of the last 30 seconds.",
        [({"peer": peer}, clock.uncertainty_s) for peer, clock in sorted(observation.peer_clocks.items())],
    )


def _of_plan(snapshot: Snapshot) -> Iterator[Metric]:
    observation, allocation = snapshot.observation, snapshot.allocation
    plan = snapshot.decision.plan
    text = "Wire bytes per second that the topics may put on the link now."
    yield _family("link_budget_bytes_per_second", text, allocation.budget_bytes_per_second)
    text = "Part of the traffic above the minimum rates that the budget allows; 1 while no topic is slowed."
    yield _family("allowed_ratio", text, snapshot.decision.allowed)
    text = "Last lasting budget that the plan in force fitted."
    yield _family("level_bytes_per_second", text, plan.level_bytes_per_second)
    statuses = _states("status", AllocationStatus, allocation.status)
    yield _family("allocation_status", "1 marks the status of the allocation.", statuses)
    bound = sum(topic.depth_binding is Binding.MEMORY for topic in allocation.topics)
    yield _family("topics_bound_by_memory", "Topics whose depth memory limits.", bound)
    yield _family("plan_generation", "Generation of the plan in force; 0 before the first.", plan.generation)
    yield _family("publishers_managed", "Live publishers that the plan in force covers.", snapshot.managed)
    text = "Managed publishers that announce the plan in force, or refuse its QoS for good and announce its ceiling."
    yield _family("publishers_confirmed", text, snapshot.confirmed)
    yield _family(
        "publishers_refused",
        "Publishers that refuse the last request; middleware and transient_local refuse for good, but are paced.",
        _counts("reason", _LASTING, Counter(p.refusal_reason for p in observation.publishers)),
    )
    yield _family("endpoints_pending", "Publishers that the ROS graph does not show.", observation.pending)
    text = "Other arpd daemons in the ROS domain; only one of them drives the robot."
    yield _family("other_daemons", text, len(observation.other_daemons))
    text = "1 while another daemon drives the robot and this one stands by."
    yield _family("standing_by", text, bool(observation.active_daemon))
    kinds = product(MessageKind, MessageRefusal)
    yield _family(
        "messages_refused_total",
        "Messages from the network, or parts of them, that arpd refused.",
        [({"kind": kind, "reason": reason}, observation.refused.get((kind, reason), 0)) for kind, reason in kinds],
    )
    text = "Memory of the robot computer that new work could use."
    yield _family("memory_available_bytes", text, observation.memory.available_bytes)
    text = "0 while the last reload was refused and an older configuration is in force."
    yield _family("config_last_reload_successful", text, not snapshot.config_error)
    text = "Changed keys that take effect only after a restart."
    yield _family("config_keys_awaiting_restart", text, len(snapshot.keys_awaiting_restart))


def _of_interface(snapshot: Snapshot) -> Iterator[Metric]:
    """Yield what the interface does, under its name: another one begins new series."""
    labels, observation = {"interface": snapshot.interface}, snapshot.observation
    states = _states("state", InterfaceState, state_of(observation.counters), **labels)
    yield _family("link_interface_state", "1 marks the state of the link interface.", states)
    if (radio := observation.radio_bytes_per_second) is not None:
        text = "Bit rate at which the radio transmits; only a part of it is usable."
        yield _family("link_radio_bytes_per_second", text, [(labels, radio)])
    if (counters := observation.counters) is not None:
        for name, text, count in (
            ("receive_bytes", "Bytes that the link interface received.", counters.rx_bytes),
            ("transmit_bytes", "Bytes that the link interface sent.", counters.tx_bytes),
            ("transmit_packets", "Packets that the link interface sent.", counters.tx_packets),
            ("transmit_dropped_packets", "Packets dropped on the way out.", counters.tx_dropped),
        ):
            yield _family(f"interface_{name}_total", text, [(labels, count)])
    if observation.rmw:
        swaps = {"rmw": observation.rmw, "swaps": "no" if observation.rmw_refusal else "yes"}
        yield _family("rmw", "ROS middleware; if swaps is no, arpd only paces topics.", swaps)


def _totals(snapshot: Snapshot) -> Iterator[Metric]:
    totals = snapshot.totals
    text = "Ticks: each observes, estimates and sends the price; two a second also plan."
    yield _family("ticks_total", text, totals.ticks + totals.ticks_failed)
    text = "Ticks that raised an error; the plan in force stays and the journal has the error."
    yield _family("tick_failures_total", text, totals.ticks_failed)
    yield _family("ticks_late_total", "Ticks that began more than half a period late.", totals.ticks_late)
    yield _family("probe_bytes_total", "Wire bytes of the probes.", totals.probe_bytes)
    yield _family("peer_reports_total", "Reports of peers that arrived.", totals.reports)
    yield _family("events_total", "Lines of the decision log.", _counts("event", MESSAGE_IDS, totals.events_by_kind))
    yield _family("plans_total", "Plans made.", _counts("cause", _CAUSES, totals.plans_by_cause))
    failures = _counts("reason", ("refused", "timeout"), totals.applies_by_result)
    yield _family("apply_failures_total", "Plans that a node refused or did not answer; arpd repeats them.", failures)
    yield _family(
        "solve_failures_total",
        "Solves without an answer, or with one that missed the budget; the closed form answered instead.",
        sum(many for (_, outcome), many in totals.solves_by_outcome.items() if outcome in {"failed", "disagreed"}),
    )


def _of_relay(snapshot: Snapshot) -> Iterator[Metric]:
    """Yield nothing without two ends, and only the first while the end on the robot is silent."""
    relay = snapshot.observation.relay
    if relay is not None or snapshot.observation.is_relay_silent:
        text = "1 while the relay's end on the robot tells the daemon what it does."
        yield _family("relay_end_up", text, relay is not None)
    if relay is None:
        return
    is_up = relay.is_reachable and not relay.fault
    yield _family("relay_other_end_up", "1 while the relay's other end is heard and understood.", is_up)
    yield _family(
        "relay_topics",
        "Topics that one side offers, that the other one reads, and that an end refuses, with refused services.",
        [
            ({"direction": direction, "state": state}, many)
            for direction, each in (("to_base", relay.to_base), ("to_robot", relay.to_robot))
            for state, many in (("offered", each.offered), ("refused", len(each.refused)), ("wanted", each.wanted))
        ],
    )
    results = ("doubled", "incomplete", "outdated", "received", "unknown")
    yield _family(
        "relay_samples_total",
        "Samples at the robot's end: new, second copies, outdated in an outage, of unknown writers or half a group.",
        [({"result": result}, getattr(relay, result)) for result in results],
    )
    yield _family(
        "relay_calls_failed_total",
        "Calls from the robot's nodes across the link that had no answer.",
        _counts("reason", (each.value for each in FailureReason), relay.calls_failed),
    )


# What each publisher has; a family is a counter if its name ends in ``_total``.
_OF_TOPIC: Mapping[str, tuple[str, Callable[[Topic], float | None]]] = {
    "share_ratio": (
        "Share of link time that the program gives the topic.",
        lambda row: row.allocation.share if row.allocation else None,
    ),
    "planned_min_rate_hertz": (
        "Minimum rate of the plan; the price slows the topic below it only where not all minimum rates fit.",
        lambda row: row.planned.min_rate_hz if row.planned else None,
    ),
    "paced_rate_hertz": (
        "Rate that plan and price leave the publisher, as announced; +Inf is unpaced.",
        lambda row: row.confirmed.paced_rate_hz,
    ),
    "confirmed_depth_samples": ("DEPTH announced.", lambda row: row.confirmed.depth),
    "confirmed_deadline_seconds": (
        "DEADLINE period announced; +Inf is none.",
        lambda row: row.confirmed.deadline_ns / NANOSECONDS_PER_SECOND or math.inf,
    ),
    "source_rate_hertz": ("Rate at which the application publishes.", lambda row: row.confirmed.source_rate_hz),
    "published_rate_hertz": ("Rate at which messages leave for the link.", lambda row: row.confirmed.published_rate_hz),
    "payload_bytes": ("Mean serialized size of recent messages.", lambda row: row.confirmed.payload_bytes),
    "queued_messages": ("Messages waiting in the pacing queue.", lambda row: row.confirmed.queued),
    "remote_readers": ("Off-host participants that read the topic.", lambda row: row.confirmed.remote_readers),
    "offered_messages_total": ("Messages that the application published.", lambda row: row.confirmed.offered),
    "published_messages_total": ("Messages written to the link.", lambda row: row.confirmed.published),
    "publish_blocked_seconds_total": (
        "Time spent in the middleware's publish().",
        lambda row: row.confirmed.blocked_s,
    ),
    "deadlines_missed_total": (
        "Offered DEADLINE periods that passed without a message.",
        lambda row: row.confirmed.deadlines_missed,
    ),
    "swaps_total": (
        "Writer swaps begun; each replaces the writer by one with other DEPTH or DEADLINE.",
        lambda row: row.confirmed.swaps_begun,
    ),
    "swap_failures_total": (
        "Writer swaps that replaced no writer or may have lost messages.",
        lambda row: sum(n for result, n in row.confirmed.swaps_by_result.items() if result not in _NO_FAILURES),
    ),
}
_WITHHELD = "Messages not sent, by cause: ceiling (rate), price, writer that blocked or failed, publisher that closed."


def _of_topics(rows: tuple[Topic, ...]) -> Iterator[Metric]:
    labelled = [({"topic": r.topic, "node": r.node, "direction": str(r.confirmed.direction)}, r) for r in rows]
    for name, (text, value_of) in _OF_TOPIC.items():
        found = ((labels, value_of(row)) for labels, row in labelled)
        yield _family(f"topic_{name}", text, [(labels, value) for labels, value in found if value is not None])
    counts = (_counts("cause", WithheldCause, row.confirmed.withheld_by_cause, labels) for labels, row in labelled)
    yield _family("topic_withheld_messages_total", _WITHHELD, chain.from_iterable(counts))
