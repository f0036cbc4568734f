"""A snapshot with managed topics both ways, one of them unpaced and one refused, and a local publisher."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import MappingProxyType

from arpd.model.allocation import Allocation, AllocationStatus, Binding, Decision, TopicAllocation
from arpd.model.endpoints import Direction, RefusalReason, SwapRecord
from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.link import CapacityKind, LinkEstimate, LinkState
from arpd.model.observation import MemoryState, MessageKind, MessageRefusal, Observation
from arpd.model.plan import QosPlan, TopicPlan
from arpd.model.price import Price
from arpd.model.probing import ClockOffset, PeerReport
from arpd.model.relay import RelaySummary, RelayTopics
from arpd.report.conditions import Event, Happening, Severity
from arpd.report.situation import find
from arpd.report.snapshot import Snapshot, Totals
from arpd.web.api import status_json
from tests.sample_publishers import publisher

FINISHED_AT_S = 1000.0
EVENT = Event(
    number=7,
    at_s=1000.0,
    unix_time_s=1.7e9,
    kind=Happening.PLAN,
    severity=Severity.WARNING,
    text="link fell to 4.8 Mbit/s: /camera/image 30 → 2.1 Hz",
    details={"generation": "3"},
)

_IMAGE = publisher(
    "/camera",
    "/camera/image",
    type_name="sensor_msgs/msg/CompressedImage",
    payload_bytes=20000.0,
    source_rate_hz=30.0,
    offered=3000,
    published=1200,
    withheld=1799,
    queued=1,
    blocked_s=0.25,
    rate_hz=37.5,
    paced_rate_hz=12.5,
    deadline_ns=100_000_000,
    generation=3,
    published_rate_hz=11.5,
    withheld_by_cause=MappingProxyType({"rate": 99, "price": 1700}),
    deadlines_missed=4,
    swaps_begun=4,
    swaps_by_result=MappingProxyType({"ok": 2, "reorder_possible": 1}),
    last_swap=SwapRecord(
        number=3,
        result="reorder_possible",
        depth=10,
        deadline_ns=100_000_000,
        seconds_by_phase=MappingProxyType({"matching": 3.0625, "watching": 0.25, "proving": 0.0625}),
    ),
    remote_readers=1,
    requested_deadline_ns=200_000_000,
    announced_at_s=999.25,
)
_IMU = publisher(
    "/imu_driver",
    "/imu",
    type_name="sensor_msgs/msg/Imu",
    payload_bytes=328.0,
    source_rate_hz=100.0,
    published_rate_hz=100.0,
    offered=10000,
    published=10000,
    blocked_s=0.0625,
    depth=100,
    baseline_depth=100,
    generation=3,
    remote_readers=2,
    announced_at_s=999,
)
_COMMAND = publisher(
    "/planner",
    "/cmd_vel",
    type_name="geometry_msgs/msg/Twist",
    direction=Direction.ACTUATION,
    payload_bytes=52.0,
    offered=2000,
    published=2000,
    depth=1,
    baseline_depth=1,
    swaps_begun=1,
    swaps_by_result=MappingProxyType({"unmatched": 1}),
    refusal="depth 16: /robot/base did not match the new writer in 5 s",
    refusal_reason=RefusalReason.UNMATCHED,
    remote_readers=1,
    announced_at_s=999.625,
)
_DIAGNOSTICS = publisher(
    "/camera",
    "/diagnostics",
    type_name="diagnostic_msgs/msg/DiagnosticArray",
    direction=Direction.LOCAL,
    payload_bytes=1024.0,
    source_rate_hz=1.0,
    offered=100,
    published=100,
    announced_at_s=999.5,
)

_ALLOCATION = Allocation(
    topics=(
        TopicAllocation(
            name="/camera/image",
            share=0.5,
            max_rate_hz=25.0,
            rate_hz=12.5,
            depth=12.5,
            deadline_ns=80_000_000,
            depth_applied=10,
            binding=Binding.LINK,
            depth_binding=Binding.LATENCY_BUDGET,
        ),
        TopicAllocation(
            name="/imu",
            share=0.125,
            max_rate_hz=800.0,
            rate_hz=100.0,
            depth=100.0,
            deadline_ns=10_000_000,
            depth_applied=100,
            binding=Binding.DESIRED_RATE,
            depth_binding=Binding.MEMORY,
        ),
        TopicAllocation(
            name="/cmd_vel",
            share=0.0625,
            max_rate_hz=320.0,
            rate_hz=20.0,
            depth=16.0,
            deadline_ns=50_000_000,
            depth_applied=16,
            binding=Binding.DESIRED_RATE,
            depth_binding=Binding.LATENCY_BUDGET,
        ),
    ),
    status=AllocationStatus.OPTIMAL,
    binding=Binding.LINK,
    budget_bytes_per_second=425000.0,
    price=Price(share_per_weight=0.5, capacity_bytes_per_second=437500.0, packet_overhead_s=0.00025),
    backend="osqp",
    solve_s=0.000125,
)
_PLAN = QosPlan(
    generation=3,
    topics=MappingProxyType(
        {
            "/camera/image": TopicPlan(
                rate_hz=37.5,
                min_rate_hz=2.0,
                deadline_ns=100_000_000,
                depth=10,
                weight=1.0,
                wire_bytes=24000.0,
                packets=17,
            ),
            "/imu": TopicPlan(rate_hz=math.inf, min_rate_hz=10.0, deadline_ns=0, depth=100),
            "/cmd_vel": TopicPlan(
                rate_hz=25.0,
                min_rate_hz=20.0,
                deadline_ns=62_500_000,
                depth=16,
                weight=10.0,
                wire_bytes=562.0,
                packets=1,
            ),
        }
    ),
    level_bytes_per_second=437500.0,
)


def make_snapshot() -> Snapshot:
    """Return the snapshot, the same at every call; its publishers are out of order on purpose."""
    return Snapshot(
        version="1.2.3",
        interface="wlan0",
        finished_at_s=FINISHED_AT_S,
        unix_time_s=1_700_000_000.0,
        tick_s=0.0078125,
        observation=Observation(
            now_s=999.75,
            counters=LinkCounters(
                interface="wlan0",
                rx_bytes=1_000_000,
                tx_bytes=50_000_000,
                rx_packets=10_000,
                tx_packets=60_000,
                tx_dropped=7,
                backlog_bytes=12_000,
                state=InterfaceState.UP,
            ),
            reports=(PeerReport(peer="base", received_at_s=999.5, interval_s=0.1, rx_bytes=48_000, rx_packets=40),),
            publishers=(_IMU, _DIAGNOSTICS, _COMMAND, _IMAGE),
            memory=MemoryState(total_bytes=4 * 2**30, available_bytes=3 * 2**30),
            sensing_topics=11,
            actuation_topics=1,
            rmw="rmw_fastrtps_cpp",
            radio_bytes_per_second=8_125_000.0,
            peer_ages_s=MappingProxyType({"base-3f2a": 0.0625, "edge-c001": 12.5}),
            peer_clocks=MappingProxyType({"base-3f2a": ClockOffset(offset_s=-0.75, uncertainty_s=0.00390625)}),
            refused={
                (MessageKind.REPORTS, MessageRefusal.UNANSWERED): 7,
                (MessageKind.PUBLISHERS, MessageRefusal.RATE): 2,
            },
            pending=3,
            relay=RelaySummary(
                other_host="base",
                is_reachable=True,
                to_base=RelayTopics(offered=14, wanted=4),
                to_robot=RelayTopics(offered=3, wanted=1),
                received=5000,
                doubled=2,
                unknown=1,
                outdated=7,
                incomplete=40,
                calls_failed={"timeout": 3},
            ),
        ),
        link=LinkEstimate(
            capacity_bytes_per_second=500_000.0,
            kind=CapacityKind.PEER,
            state=LinkState.STEADY,
            queue_delay_s=0.0125,
            delivery_rate_bytes_per_second=300_000.0,
            age_s=1.5,
            evidence="3 trains, median 500 kB/s",
            cross_traffic_bytes_per_second=62_500.0,
            packet_overhead_s=0.00025,
            loss_ratio=0.015625,
            return_delay_s=0.0078125,
        ),
        allocation=_ALLOCATION,
        decision=Decision(allowed=0.75, plan=_PLAN, is_postponed=True),
        totals=Totals(
            ticks=9000,
            ticks_failed=1,
            ticks_late=12,
            solves_by_outcome=MappingProxyType(
                {("osqp", "solved"): 8990, ("closed_form", "solved"): 10, ("osqp", "failed"): 9}
            ),
            plans_by_cause=MappingProxyType({"start": 1, "down": 1, "up": 1}),
            applies_by_result=MappingProxyType({"ok": 6, "refused": 1}),
            probes=120,
            probe_bytes=1_440_000,
            reports=8900,
            events_by_kind=MappingProxyType({"started": 1, "plan": 3}),
        ),
        config_path="/etc/arpd/arpd.yaml",
        confirmed=2,
    )


def held(snapshot, *, for_s=60.0):
    """Return the snapshot as it is when all that holds has held for so long (s)."""
    return looked(snapshot, found=tuple(replace(each, since_s=FINISHED_AT_S - for_s) for each in find(snapshot)))


def looked(snapshot, **fields):
    """Return the snapshot with other fields, as it is when its conditions have been looked for."""
    snapshot = replace(snapshot, **fields)
    return replace(snapshot, found=find(snapshot))


def status_of(snapshot, **options):
    """Return the status document of a snapshot."""
    return json.loads(b"".join(status_json(snapshot, **options)))


def changed(**parts):
    """Return the sample with other values in its parts: link={…}, observation={…} by field, the rest whole."""
    snapshot = make_snapshot()
    whole = {
        name: replace(getattr(snapshot, name), **part) if isinstance(part, dict) else part
        for name, part in parts.items()
    }
    return looked(snapshot, **whole)
