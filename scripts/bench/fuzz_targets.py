"""Every reader of outside input that `fuzz.py` feeds, and the promises of the code under test.

A target's `load` imports the code under test, so that a fuzzer can instrument it first. An exception of its function is
a crash, except for the refusals that it catches; a broken promise is a crash too.
"""

from __future__ import annotations

import json
import math
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scripts.bench.report import REPO

if TYPE_CHECKING:
    from collections.abc import Callable

FAULT = re.compile(r"[^\n]+?:[1-9]\d*:[1-9]\d*: [^ \n][^\n]*?: [^\n]+; [^\n]+")
_NUMBERS = ("null", "NaN", "Infinity", "1e999", "true", "-1", "9223372036854775808", "/a/b")


class BrokenPromiseError(Exception):
    """The code under test returned a value that it promises never to return."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Fuzzable:
    """Code under test, imported.

    Parameters
    ----------
    feed : takes any bytes; an exception is a crash
    seeds : inputs to start from
    words : likely pieces of inputs
    """

    feed: Callable[[bytes], None]
    seeds: tuple[bytes, ...]
    words: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Target:
    """One reader of outside input.

    Parameters
    ----------
    load : imports the code under test
    most_bytes : longest input
    """

    load: Callable[[], Fuzzable]
    most_bytes: int = 4096


def memory_file() -> Path:
    """Return the path of a file in memory that lives as long as the process."""
    folder = "/dev/shm" if Path("/dev/shm").is_dir() else None  # a disk would take most of the time
    return Path(tempfile.mkdtemp(prefix="arpd-fuzz-", dir=folder)) / "input"


def insist(holds: bool, promise: str) -> None:  # noqa: FBT001 - the promise names it
    if not holds:
        raise BrokenPromiseError(promise)


def config() -> Fuzzable:
    """Feed a configuration: arpd makes settings of it, or names each fault in one clear line."""
    import yaml

    from arpd.host.config.keys import SECTIONS, keys_of
    from arpd.host.config.load import load_settings

    keys = {key for section in SECTIONS.values() for key in keys_of(section)}
    shipped = yaml.safe_load((REPO / "etc/arpd/arpd.yaml").read_bytes())
    seeds = [
        yaml.safe_dump(shipped).encode(),  # without comments: the fuzzer runs more short inputs than long ones
        b"link: {interface: wlan0, capacity: 8mbit}\nrelay: {topics: [{name: /camera, overflow: queue}]}\n",
        b"relay: {link_domain: 7, robot: a, deny: [/x/**], groups: [{topics: [/a, /b]}], services: ['/*/s']}\n",
        b"a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n",
        b"- " * 100,
        b"topics: [" + b"{name: /a}, " * 10 + b"]",
    ]
    words = (
        ": ",
        "- ",
        "\n  ",
        "!!python/object:",
        "&a",
        "*a",
        "<<",
        "20mbit",
        "200ms",
        "1MiB",
        ".inf",
        ".nan",
        "none",
    )
    feed = _feed_config(lambda path: load_settings(path, interfaces=lambda: ("wlan0",)))
    return Fuzzable(feed=feed, seeds=tuple(seeds), words=(*sorted(keys), *words))


def status_file() -> Fuzzable:
    """Feed a saved status: arpd makes publishers of it, or refuses it in one line."""
    from arpd.cli.status_file import read_status
    from arpd.model.errors import ArpdError

    path = memory_file()

    def feed(data: bytes) -> None:
        path.write_bytes(data)
        try:
            publishers = read_status(path).publishers
        except ArpdError as error:
            insist("\n" not in str(error), f"one line: {error}")
            return
        insist(all(math.isfinite(p.payload_bytes + p.source_rate_hz) for p in publishers), "finite numbers")

    row = {
        "node": "/lidar",
        "topic": "/scan",
        "direction": "sensing",
        "payload_bytes": 5828.0,
        "source_rate_hz": 20.0,
        "remote_readers": 1,
        "requested_deadline_ns": None,
    }
    seed = json.dumps({"api_version": 1, "topics": [row]}).encode()
    words = (*row, "api_version", "topics", "1e999", "NaN", "-Infinity", "actuation", "local", "null", "[[[[")
    return Fuzzable(feed=feed, seeds=(seed,), words=words)


def trace() -> Fuzzable:
    """Feed a link trace: arpd makes rates and losses of it, or refuses it in one line."""
    from arpd.model.errors import TraceError
    from arpd.sim.trace import read_trace

    path = memory_file()

    def feed(data: bytes) -> None:
        path.write_bytes(data)
        try:
            found = read_trace(path)
        except TraceError as error:
            insist("\n" not in str(error), f"one line: {error}")
            return
        rates = [step.rate_bytes_per_second for step in found.rates.steps]
        insist(all(0.0 <= rate < math.inf for rate in rates), f"finite rates: {rates}")
        insist(all(0.0 <= step.loss <= 1.0 for step in found.losses), f"probabilities: {found.losses}")

    seeds = (
        b"time_s,rate_bit_per_s,loss\n0,2e7,0\n10,5000000,0.02\n20,2e7,0\n",
        b"# recorded\ntime_s,rate_bit_per_s\n0,1\n",
        b"0\n1\n1\n5\n20\n400\n",
    )
    return Fuzzable(feed=feed, seeds=seeds, words=("time_s,", "rate_bit_per_s", ",loss", "\n", "#", "1e300", "nan"))


def web_config() -> Fuzzable:
    """Feed a web-config: arpd makes a protection of it, or names each fault in one clear line."""
    from arpd.web.web_config import load_protection

    seeds = (
        b"tls_server_config: {cert_file: a.pem, key_file: a.key}\n",
        b"basic_auth_users:\n  ops: $2b$12$CwTycUXWue0Thq9StjUM0uJ8vDqYPBlRgYFRQ0qVdCkXo6B6xkz5e\n",
    )
    words = (
        *("client_ca_file: ", "client_auth_type: ", "RequireAndVerifyClientCert", "client_allowed_sans: ["),
        "cipher_suites",
    )
    return Fuzzable(feed=_feed_config(load_protection), seeds=seeds, words=words)


def _feed_config(load: Callable[[Path], object]) -> Callable[[bytes], None]:
    from arpd.model.errors import ConfigError

    path = memory_file()

    def feed(data: bytes) -> None:
        path.write_bytes(data)
        try:
            load(path)
        except ConfigError as error:
            insist(bool(error.faults) and all(map(FAULT.fullmatch, error.faults)), f"a clear fault: {error.faults}")

    return feed


def report() -> Fuzzable:
    """Feed a peer's report: arpd refuses it, or its values are possible and survive another encoding."""
    from arpd.model.probing import PeerReport, Train
    from arpd.ros.probe_messages import decode_report, encode_report

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
        peer="base",
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
    from arpd.ros.probe_messages import ProbeHeader, decode_probe, encode_probe

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
    from arpd.model.endpoints import PublisherState
    from arpd.model.plan import PlanAnswer
    from arpd.model.relay import RelaySummary
    from arpd.ros.documents import expand
    from arpd.ros.node_snapshot import LIKELY, MOST_BYTES, encode_snapshot
    from arpd.ros.snapshot_decoder import decode_snapshot

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
    plain = expand(packed, most_bytes=MOST_BYTES, likely=LIKELY)
    return Fuzzable(feed=feed, seeds=(packed, plain), words=_NUMBERS)


def plan() -> Fuzzable:
    """Feed a plan: a node refuses it, or makes valid rows of it."""
    from arpd.model.endpoints import WriterQos
    from arpd.model.plan import TopicPlan
    from arpd.ros.bounds import checked_row
    from arpd.ros.documents import unpack
    from arpd.ros.plan_message import decode_plan, encode_plan

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
        terms = [term for row in rows for term in (row.min_rate_hz, row.weight, row.wire_bytes, row.packets)]
        insist(all(0.0 <= term < math.inf for term in terms), f"finite terms: {rows}")

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


TARGETS = {
    "config": Target(load=config),
    "status-file": Target(load=status_file, most_bytes=2**14),
    "trace": Target(load=trace, most_bytes=2**14),
    "report": Target(load=report),
    "probe": Target(load=probe, most_bytes=256),
    "snapshot": Target(load=snapshot),
    "plan": Target(load=plan),
    "web-config": Target(load=web_config),
}
