"""The status document of ``/api/v1/status``: the last snapshot as JSON.

Every key carries its unit; measured values have five digits. ``null`` stands for what JSON cannot say:

- in ``rate_hz`` and ``paced_rate_hz`` an unpaced publisher (infinite), in ``deadline_ns`` an infinite DEADLINE,
- in ``price`` a tick without topics to divide the link among, in its ``share_per_weight`` no limit,
- in ``planned`` and the program's keys a publisher that no plan covers,
- in ``uniform`` another policy, or no topic to plan for,
- in ``interface_counters`` an interface that is gone, in ``backlog_bytes`` one without a queue,
- in ``radio_bytes_per_second`` an interface without a radio, or a radio that does not tell,
- in ``rmw`` a world without ROS,
- in ``relay`` a robot without a relay of two ends, or one whose end is silent,
- in ``clock_offset_seconds`` and ``clock_uncertainty_seconds`` a peer that answered no probe in the last 30 s,
- in ``after_seconds`` of ``lease`` a plan that outlives its daemon,
- in ``loss_ratio`` and ``return_delay_seconds`` what nobody measures.

Within ``v1`` keys are only added; `arpd.web.api.status` describes each.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

from arpd.model.interface import LinkCounters, state_of
from arpd.model.quantities import shortened
from arpd.model.settings import OnLost
from arpd.report.situation import judge, kept_ratio
from arpd.report.topic_rows import TopicRow, topic_rows

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from arpd.model.endpoints import SwapRecord
    from arpd.model.observation import Observation
    from arpd.model.price import Price
    from arpd.model.relay import RelaySummary
    from arpd.report.events import Event
    from arpd.report.situation import Finding
    from arpd.report.snapshot import Snapshot, Totals

_T = TypeVar("_T")
API_VERSION = "v1"
MOST_EVENTS = 50


def status_document(snapshot: Snapshot, *, is_ready: bool = True, now_s: float | None = None) -> dict[str, Any]:
    """Return the whole snapshot as a JSON-safe document; the parameters are those of `status_head`."""
    return {**status_head(snapshot, is_ready=is_ready, now_s=now_s), "topics": list(status_topics(snapshot))}


def status_topics(snapshot: Snapshot) -> Iterator[dict[str, Any]]:
    """Yield the topics of the document one by one."""
    return (_topic(row, snapshot.observation.now_s) for row in topic_rows(snapshot))


def status_head(snapshot: Snapshot, *, is_ready: bool = True, now_s: float | None = None) -> dict[str, Any]:
    """Return the document, but for its topics.

    Parameters
    ----------
    is_ready : True while the daemon governs
    now_s : monotonic clock (s), for the age of the snapshot; with None the age is null
    """
    decision, allocation, rows = snapshot.decision, snapshot.allocation, topic_rows(snapshot)
    situation = judge(snapshot, rows=rows, now_s=now_s)
    return {
        "api_version": API_VERSION,
        "version": snapshot.version,
        "ready": is_ready,
        "unix_time_seconds": _rounded(snapshot.unix_time_s, 3),
        "age_seconds": None if now_s is None else _rounded(max(0.0, now_s - snapshot.finished_at_s), 2),
        "tick_seconds": _finite(snapshot.tick_s),
        "verdict": _finding(situation.verdict),
        "faults": [_finding(fault) for fault in situation.faults],
        "interface": snapshot.interface,
        "interface_state": str(state_of(snapshot.observation.counters)),
        "interface_counters": _counters(snapshot.observation.counters),
        "link": _link(snapshot),
        "peers": _peers(snapshot.observation),
        "memory": {
            "total_bytes": snapshot.observation.memory.total_bytes,
            "available_bytes": snapshot.observation.memory.available_bytes,
        },
        "graph": {
            "sensing_topics": snapshot.observation.sensing_topics,
            "actuation_topics": snapshot.observation.actuation_topics,
        },
        "rmw": _rmw(snapshot.observation),
        "daemons": {
            "others": list(snapshot.observation.other_daemons),
            "standing_by_for": snapshot.observation.active_daemon,
        },
        "relay": None if (relay := snapshot.observation.relay) is None else _relay(relay),
        "gate": _finite(decision.gate),
        "price": decision.price and _price(decision.price),
        "level_bytes_per_second": _finite(decision.plan.level_bytes_per_second),
        "plan": {
            "generation": decision.plan.generation,
            "reason": decision.reason,
            "refusals": list(decision.refusals),
            "topics": len(decision.plan.topics),
            "publishers": sum(row.planned is not None for row in rows),
            "confirmed": snapshot.confirmed,
            "paced_only": sum(row.planned is not None and row.publisher.refusal_reason.is_lasting for row in rows),
        },
        "allocation": {
            "status": str(allocation.status),
            "binding": str(allocation.binding),
            "capacity_bytes_per_second": _finite(allocation.capacity_bytes_per_second),
            "degradation": allocation.degradation,
            "backend": allocation.backend,
            "solve_seconds": _finite(allocation.solve_s),
            "uniform": allocation.uniform and asdict(allocation.uniform),
        },
        "lease": _lease(snapshot),
        "totals": _totals(snapshot.totals),
        "events": event_documents(snapshot.events[-MOST_EVENTS:]),
        "config": {"path": snapshot.config_path, "error": snapshot.config_error},
    }


def _finding(finding: Finding) -> dict[str, Any]:
    condition = finding.condition
    return {
        "condition": str(condition),
        "severity": str(condition.severity),
        "headline": condition.headline,
        "text": finding.text,
        "wrong": condition.is_wrong,
    }


def event_documents(events: Iterable[Event]) -> list[dict[str, Any]]:
    """Return lines of the decision log as JSON-safe documents, in the same order."""
    return [
        {
            "number": event.number,
            "unix_time_seconds": _rounded(event.unix_time_s, 3),
            "event": str(event.kind),
            "severity": str(event.severity),
            "text": event.text,
            "topic": event.topic,
            "node": event.node,
            "details": _sorted(event.details),
        }
        for event in events
    ]


def _link(snapshot: Snapshot) -> dict[str, Any]:
    link, radio = snapshot.link, snapshot.observation.radio_bytes_per_second
    return {
        "capacity_bytes_per_second": _finite(link.capacity_bytes_per_second),
        "foreign_bytes_per_second": _finite(link.cross_traffic_bytes_per_second),
        "available_bytes_per_second": _finite(link.available_bytes_per_second),
        "kind": str(link.kind),
        "state": str(link.state),
        "app_limited": link.is_app_limited,
        "queue_delay_seconds": _finite(link.queue_delay_s),
        "delivery_rate_bytes_per_second": _finite(link.delivery_rate_bytes_per_second),
        "packet_overhead_seconds": _finite(link.packet_overhead_s),
        "loss_ratio": _finite(link.loss_ratio),
        "return_delay_seconds": _finite(link.return_delay_s),
        "radio_bytes_per_second": _finite(radio),
        "age_seconds": _rounded(link.age_s, 2),
        "evidence": link.evidence,
        "events": _sorted(link.events_by_kind),
    }


def _counters(counters: LinkCounters | None) -> dict[str, Any] | None:
    if counters is None:
        return None
    return {
        "interface": counters.interface,
        "up": counters.is_up,
        "receive_bytes": counters.rx_bytes,
        "transmit_bytes": counters.tx_bytes,
        "receive_packets": counters.rx_packets,
        "transmit_packets": counters.tx_packets,
        "transmit_dropped_packets": counters.tx_dropped,
        "backlog_bytes": counters.backlog_bytes,
    }


def _peers(observation: Observation) -> list[dict[str, Any]]:
    rows = []
    for peer, age_s in sorted(observation.peer_ages_s.items()):
        clock = observation.peer_clocks.get(peer)
        rows.append(
            {
                "peer": peer,
                "report_age_seconds": _rounded(age_s, 2),
                "clock_offset_seconds": clock and _rounded(clock.offset_s, 6),
                "clock_uncertainty_seconds": clock and _finite(clock.uncertainty_s),
            }
        )
    return rows


def _rmw(observation: Observation) -> dict[str, Any] | None:
    if not observation.rmw:
        return None
    return {"name": observation.rmw, "swaps": not observation.rmw_refusal, "refusal": observation.rmw_refusal}


def _relay(relay: RelaySummary) -> dict[str, Any]:
    document = {**asdict(relay), "reachable": relay.is_reachable, "strangers": list(relay.strangers)}
    del document["is_reachable"]
    return document


def _price(price: Price) -> dict[str, Any]:
    return {
        "share_per_weight": _finite(price.share_per_weight),
        "capacity_bytes_per_second": _finite(price.capacity_bytes_per_second),
        "packet_overhead_seconds": _finite(price.packet_overhead_s),
        "yielding_weight": price.yielding_weight,
        "kept_floor": _finite(price.kept_floor),
    }


def _lease(snapshot: Snapshot) -> dict[str, Any]:
    on_lost = OnLost.BASELINE if snapshot.lease_s else OnLost.KEEP
    return {"on_lost": str(on_lost), "after_seconds": snapshot.lease_s or None}


def _topic(row: TopicRow, now_s: float) -> dict[str, Any]:
    publisher, planned, allocation = row.publisher, row.planned, row.allocation
    return {
        "topic": publisher.topic,
        "node": publisher.node,
        "type": publisher.type_name,
        "direction": str(publisher.direction),
        "planned": planned
        and {
            "rate_hz": _finite(planned.rate_hz),
            "min_rate_hz": _finite(planned.min_rate_hz),
            "depth": planned.depth,
            "deadline_ns": planned.deadline_ns or None,
            "weight": planned.weight,
            "wire_bytes": planned.wire_bytes,
            "packets": planned.packets,
        },
        "confirmed": {
            "rate_hz": _finite(publisher.rate_hz),
            "paced_rate_hz": _finite(publisher.paced_rate_hz),
            "depth": publisher.depth,
            "deadline_ns": publisher.deadline_ns or None,
            "generation": publisher.generation,
        },
        "baseline": {"depth": publisher.baseline_depth, "deadline_ns": publisher.baseline_deadline_ns or None},
        "max_rate_hz": allocation and _finite(allocation.max_rate_hz),
        "optimal_rate_hz": allocation and _finite(allocation.rate_hz),
        "optimal_depth": allocation and _finite(allocation.depth),
        "share": allocation and _finite(allocation.share),
        "kept_ratio": _finite(kept_ratio(row)),
        "binding": allocation and str(allocation.binding),
        "depth_binding": allocation and str(allocation.depth_binding),
        "source_rate_hz": _finite(publisher.source_rate_hz),
        "published_rate_hz": _finite(publisher.published_rate_hz),
        "payload_bytes": _finite(publisher.payload_bytes),
        "offered": publisher.offered,
        "published": publisher.published,
        "withheld": publisher.withheld,
        "withheld_by_cause": _sorted(publisher.withheld_by_cause),
        "queued": publisher.queued,
        "blocked_seconds": _finite(publisher.blocked_s),
        "remote_readers": publisher.remote_readers,
        "requested_deadline_ns": publisher.requested_deadline_ns or None,
        "deadlines_missed": publisher.deadlines_missed,
        "swaps": _sorted(publisher.swaps_by_result),
        "swaps_begun": publisher.swaps_begun,
        "swap_seconds_by_phase": _sorted(publisher.swap_seconds_by_phase),
        "last_swap": publisher.last_swap and _swap(publisher.last_swap),
        "lacks_profile": publisher.lacks_profile,
        "refusal": publisher.refusal,
        "refusal_reason": str(publisher.refusal_reason),
        "refusal_lasts": publisher.refusal_reason.is_lasting,
        "age_seconds": _rounded(publisher.age_s(now_s), 2),
    }


def _swap(swap: SwapRecord) -> dict[str, Any]:
    return {
        "number": swap.number,
        "result": swap.result,
        "depth": swap.depth,
        "deadline_ns": swap.deadline_ns or None,
        "seconds_by_phase": _sorted(swap.seconds_by_phase),
    }


def _totals(totals: Totals) -> dict[str, Any]:
    solves: dict[str, dict[str, int]] = {}
    for (backend, outcome), count in sorted(totals.solves_by_outcome.items()):
        solves.setdefault(backend, {})[outcome] = count
    return {
        "ticks": totals.ticks,
        "ticks_failed": totals.ticks_failed,
        "ticks_late": totals.ticks_late,
        "solves": solves,
        "cross_check_disagreements": totals.cross_check_disagreements,
        "levels": _sorted(totals.plans_by_cause),
        "refusals": _sorted(totals.refusals_by_reason),
        "applies": _sorted(totals.applies_by_result),
        "probes": totals.probes,
        "probe_bytes": totals.probe_bytes,
        "reports": totals.reports,
        "reloads": _sorted(totals.reloads_by_result),
        "events": _sorted(totals.events_by_kind),
    }


def _sorted(values: Mapping[str, _T]) -> dict[str, _T]:
    return dict(sorted(values.items()))


def _finite(value: float | None) -> float | None:
    """Return a value in five digits, None for what JSON cannot say; the module's docstring has the meanings."""
    return None if value is None or not math.isfinite(value) else shortened(value)


def _rounded(value: float, decimals: int) -> float | None:
    """Return a time or an age, whose digits before the point count, too."""
    return round(value, decimals) if math.isfinite(value) else None
