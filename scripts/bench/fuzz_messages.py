"""Fuzz targets for input over ROS: reports, probes, snapshots of nodes, plans."""

from __future__ import annotations

import json
import math
from typing import Any

from scripts.bench.fuzz_target import Fuzzable, insist

_NUMBERS = ("null", "NaN", "Infinity", "1e999", "true", "-1", "9223372036854775808", "/a/b")


def report() -> Fuzzable:
    """Feed a peer's report: arpd refuses it, or its values are possible and survive another encoding."""
    from arpd.adapters.ros.probe_messages import decode_report, encode_report
    from arpd.model.probing import PeerReport, Train

    def feed(data: bytes) -> None:
        try:
            found = decode_report(data, received_at_s=1.0)
        except ValueError:
            return
        numbers = [found.interval_s, *found.delays_s]
        numbers += [span for train in found.trains for span in (train.duration_s, train.sent_s)]
        insist(all(map(math.isfinite, numbers)), f"finite numbers: {found}")
        insist(found.interval_s > 0, f"an interval: {found}")
        insist(all(train.duration_s > 0 and train.packets > 0 for train in found.trains), f"trains: {found}")
        if len(found.delays_s) <= 32 and len(found.trains) <= 32:
            again = decode_report(bytes(encode_report(found).data), received_at_s=1.0)
            insist(again.trains == found.trains and again.delays_s == found.delays_s, f"the same again: {again}")

    some = PeerReport(
        peer="ceddp",
        received_at_s=1.0,
        interval_s=0.1,
        rx_bytes=1000,
        rx_packets=9,
        last_probe=7,
        delays_s=(0.01, 0.02),
        trains=(Train(payload_bytes=12000, duration_s=0.01, sent_s=0.001, packets=10),),
    )
    return Fuzzable(feed=feed, seeds=(bytes(encode_report(some).data),))


def probe() -> Fuzzable:
    """Feed a probe packet: arpd refuses it, or it has a valid index in its train."""
    from arpd.adapters.ros.probe_messages import ProbeHeader, decode_probe, encode_probe

    def feed(data: bytes) -> None:
        try:
            header = decode_probe(data)
        except ValueError:
            return
        insist(0 <= header.index < header.packets and header.quiet_s >= 0, f"an index in a train: {header}")
        insist(decode_probe(bytes(encode_probe(header, payload_bytes=len(data)).data)) == header, "the same again")

    seed = encode_probe(ProbeHeader(train=7, index=2, packets=9, quiet_s=0.5), payload_bytes=64)
    return Fuzzable(feed=feed, seeds=(bytes(seed.data),))


def snapshot() -> Fuzzable:
    """Feed what a node tells: arpd refuses it, or makes possible states of it that the node can tell again."""
    from arpd.adapters.ros.documents import unpack
    from arpd.adapters.ros.node_snapshot import MOST_BYTES, decode_snapshot, encode_snapshot
    from arpd.model.endpoints import PublisherState
    from arpd.model.plan import PlanAnswer
    from arpd.model.relay import RelaySummary

    def feed(data: bytes) -> None:
        try:
            found = decode_snapshot(data)
        except ValueError:
            return
        states = [PublisherState(**row) for row in found.publishers]
        insist(found.node.isprintable() and found.answer.refusal.isprintable(), f"a name and words: {found}")
        insist(0.0 <= found.answer.lease_s < math.inf, f"a lease: {found.answer}")
        for state in states:
            insist(0 <= state.payload_bytes < math.inf and state.depth >= 1, f"possible numbers: {state}")
            insist(state.topic.isprintable() and state.refusal.isprintable(), f"texts: {state}")
        decode_snapshot(encode_snapshot(found.node, states, answer=found.answer, relay=found.relay))

    answer = PlanAnswer(generation=3, lease_s=30.0, refused=4, refusal="too old")
    packed = encode_snapshot("/lidar", [_publisher()] * 20, answer=answer, lacks_profile=True, relay=RelaySummary())
    plain = json.dumps(unpack(packed, most_bytes=MOST_BYTES)).encode()
    return Fuzzable(feed=feed, seeds=(packed, plain), words=_NUMBERS)


def plan() -> Fuzzable:
    """Feed a plan: a node refuses it, or makes valid rows of it."""
    from arpd.adapters.ros.bounds import checked_row
    from arpd.adapters.ros.documents import unpack
    from arpd.adapters.ros.plan_message import decode_plan, encode_plan
    from arpd.model.endpoints import WriterQos
    from arpd.model.plan import TopicPlan

    own = WriterQos(depth=10, deadline_ns=0)

    def feed(data: bytes) -> None:
        try:
            found = decode_plan(data)
            rows = [checked_row(topic, row, own) for topic, row in found.rows.items()]
        except ValueError as refusal:
            insist(bool(str(refusal)), "a refusal with a reason")
            return
        insist(found.generation >= 0 and 0.0 <= found.lease_s < math.inf, f"a number and a time: {found}")
        insist(all(row.depth >= 1 and row.rate_hz >= 0 and row.deadline_ns >= 0 for row in rows), f"rows: {rows}")
        insist(all(0.0 <= term < math.inf for row in rows for term in row.terms), f"finite terms: {rows}")

    row = TopicPlan(
        rate_hz=math.inf, min_rate_hz=1.0, deadline_ns=10**9, depth=40, weight=1.5, wire_bytes=9.5, packets=1
    )
    packed = encode_plan(generation=3, lease_s=30.0, topics={f"/t{number}": row for number in range(20)})
    plain = json.dumps(unpack(packed, most_bytes=10**6)).encode()
    return Fuzzable(feed=feed, seeds=(packed, plain), words=_NUMBERS)


def _publisher() -> Any:
    from arpd.model.endpoints import Direction, PublisherState

    return PublisherState(
        node="/lidar",
        topic="/scan",
        type_name="sensor_msgs/msg/LaserScan",
        direction=Direction.SENSING,
        payload_bytes=5828.0,
        source_rate_hz=20.0,
        depth=10,
        baseline_depth=10,
        swaps_by_result={"ok": 3, "undelivered": 1},
        refusal="",
    )
