"""Fuzz targets for input over ROS: reports, probes, announcements, plans, heartbeats."""

from __future__ import annotations

import math
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

from scripts.bench.fuzz_target import Fuzzable, insist

_CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


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


def publisher() -> Fuzzable:
    """Feed a publisher's announcement: arpd refuses it, or makes a state of it that it can announce again."""
    from arpd.adapters.ros.announcement import from_status, to_status

    def feed(data: bytes) -> None:
        try:
            state = from_status(SimpleNamespace(values=_pairs(data)))
        except ValueError:
            return
        insist(state.payload_bytes < math.inf and state.depth >= 1, f"possible numbers: {state}")
        insist(len(state.node) <= 256 and state.node.isprintable(), f"a name: {state.node!r}")
        if _is_text(state.type_name, state.refusal, *state.swaps_by_result):
            from_status(to_status(state))

    state = _publisher()
    return Fuzzable(feed=feed, seeds=(_lines(to_status(state)),), words=_numbers())


def counters() -> Fuzzable:
    """Feed the numbers of a node: arpd refuses them, or makes possible states of them."""
    from dataclasses import fields, replace

    from arpd.adapters.ros.counters import decode_counters, encode_counters, row_of
    from arpd.adapters.ros.plan_message import PlanAnswer

    state = _publisher()
    told = {field.name: getattr(state, field.name) for field in fields(state)}
    later = replace(state, offered=9, published=5, withheld=4, withheld_by_cause={"price": 4}, paced_rate_hz=3.0)

    def feed(data: bytes) -> None:
        try:
            found = decode_counters(data)
        except ValueError:
            return
        insist(found.node.isprintable() and found.answer.refusal.isprintable(), f"a name and words: {found}")
        insist(0.0 <= found.lease_s < math.inf, f"a lease: {found.lease_s}")
        for row in found.rows:
            now = replace(state, **row.changes(told))
            insist(0 <= now.payload_bytes < math.inf and now.paced_rate_hz >= 0, f"possible numbers: {now}")
            insist(now.withheld >= state.withheld and now.offered >= state.offered, f"sums that grow: {now}")

    rows = [row_of(1, 0, told=state, now=state), row_of(2, 255, told=state, now=later)]
    answers = (PlanAnswer(generation=4, crc=7), PlanAnswer(generation=3, crc=9, refusal="too old"))
    seeds = tuple(encode_counters("/lidar", rows, incarnation=5, answer=answer, lease_s=30.0) for answer in answers)
    return Fuzzable(feed=feed, seeds=seeds)


def plan() -> Fuzzable:
    """Feed the plan of a node: the node refuses it, or makes valid rows of it."""
    from arpd.adapters.ros.bounds import check_grant, checked_row
    from arpd.adapters.ros.plan_message import decode_plan, encode_plan
    from arpd.model.endpoints import WriterQos
    from arpd.model.plan import TopicPlan

    own = WriterQos(depth=10, deadline_ns=0)

    def feed(data: bytes) -> None:
        try:
            found = decode_plan(data.decode("utf-8", "replace"))
            check_grant(generation=found.generation, lease_s=found.lease_s, in_force=2)
            rows = [checked_row(topic, row, own) for topic, row in found.publishers.items()]
        except ValueError as refusal:
            insist(bool(str(refusal)), "a refusal with a reason")
            return
        insist(found.generation >= 2 and 0.0 <= found.lease_s < math.inf, f"a number and a time: {found}")
        insist(all(row.depth >= 1 and row.rate_hz >= 0 and row.deadline_ns >= 0 for row in rows), f"rows: {rows}")
        insist(all(0.0 <= term < math.inf for row in rows for term in row.terms), f"finite terms: {rows}")

    row = TopicPlan(
        rate_hz=math.inf, min_rate_hz=1.0, deadline_ns=10**9, depth=40, weight=1.5, wire_bytes=9.5, packets=1
    )
    text = encode_plan(generation=3, lease_s=30.0, publishers={"/a": row})
    return Fuzzable(feed=feed, seeds=(text.encode(),), words=("null", "NaN", "Infinity", "1e999", "true", "-1"))


def wire() -> Fuzzable:
    """Feed serialized announcements, as from the network: the middleware or arpd accepts or refuses them."""
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.serialization import deserialize_message, serialize_message

    from arpd.adapters.ros.announcement import from_status, to_status
    from arpd.adapters.ros.daemons import from_status as heartbeat_from_status

    def feed(data: bytes) -> None:
        try:
            message = deserialize_message(_CDR_LITTLE_ENDIAN + data, DiagnosticArray)
        except Exception as error:
            if type(error).__name__ in {"RCLError", "RMWError", "UnicodeDecodeError"}:
                return  # the middleware refuses it before arpd sees it
            raise
        for status in message.status:
            for read in (from_status, heartbeat_from_status):
                with suppress(ValueError):
                    read(status)

    message = DiagnosticArray(status=[to_status(_publisher())] * 2)
    return Fuzzable(feed=feed, seeds=(bytes(serialize_message(message))[4:],), words=_numbers())


def heartbeat() -> Fuzzable:
    """Feed a daemon's heartbeat: arpd refuses it, or can compare it with its own and send it again."""
    from arpd.adapters.ros.daemons import from_status, to_status
    from arpd.observe.leader import DaemonHeartbeat, Leader

    own = DaemonHeartbeat(started_ns=5, token="0" * 32, host="robot")

    def feed(data: bytes) -> None:
        head, _, rest = data.partition(b"\n\n")
        name, _, token = head.decode("utf-8", "surrogateescape").partition("\n")
        try:
            found = from_status(SimpleNamespace(name=name, hardware_id=token, values=_pairs(rest)))
        except ValueError:
            return
        insist(found.host.isprintable() and found.started_ns >= 0, f"a possible heartbeat: {found}")
        leader = Leader(own)
        for now_s in (1.0, 1.5):  # one heartbeat alone does not count
            leader.note(found, now_s)
        insist(len(leader.others(1.5)) <= 1, "one heartbeat is one daemon")
        insist(from_status(to_status(found)) == found, "the same again")

    return Fuzzable(
        feed=feed,
        seeds=(b"arpd on robot2\n" + b"1" * 32 + b"\n\nstarted_ns=1700000000000000000",),
        words=("started_ns=", "arpd on "),
    )


def _pairs(data: bytes) -> list[Any]:
    """Read lines as key and value, so that mutations change text and not lengths."""
    lines = data.decode("utf-8", "surrogateescape").split("\n")
    return [SimpleNamespace(key=key, value=value) for key, _, value in (line.partition("=") for line in lines)]


def _lines(status: Any) -> bytes:
    return "\n".join(f"{pair.key}={pair.value}" for pair in status.values).encode()


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
        swaps_by_result={"done": 3, "undelivered": 1},
        refusal="",
    )


def _is_text(*texts: str) -> bool:
    """Return whether no text has a lone surrogate: the middleware passes only valid UTF-8."""
    return not any("\ud800" <= character <= "\udfff" for text in texts for character in text)


def _numbers() -> tuple[str, ...]:
    words = ("inf", "nan", "-1", "1e308", "9223372036854775807", "9223372036854775808", "swaps_", "/a/b")
    return (*words, "keep_all", "refusal=", "refusal_reason=", "lease_s=", "generation=")
