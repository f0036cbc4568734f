"""What a node tells of its publishers and its relay: it arrives unchanged, stays small, and nothing else is taken."""

import json
import random
import string
import zlib
from dataclasses import fields, replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from hypothesis import example, given
from hypothesis import strategies as st

from arpd.model.endpoints import (
    MOST_PUBLISHERS,
    Direction,
    PublisherState,
    RefusalReason,
    SwapRecord,
    WithheldCause,
)
from arpd.model.names import LONGEST_NAME
from arpd.model.plan import PlanAnswer
from arpd.model.relay import RelaySummary, RelayTopics
from arpd.ros.documents import expand
from arpd.ros.node_snapshot import JOINED, LIKELY, LONGEST_SNAPSHOT, MOST_BYTES, MOST_WORDS, encode_snapshot
from arpd.ros.snapshot_decoder import decode_snapshot
from tests.examples import examples
from tests.sample_publishers import publisher

PLAIN = publisher("/n", "/t", direction=Direction.LOCAL)
REPLACED = publisher(
    "/n",
    "/t",
    direction=Direction.LOCAL,
    lacks_profile=True,
    generation=3,
    lease_s=30.0,
    refusal="it is TRANSIENT_LOCAL",
    refusal_reason=RefusalReason.TRANSIENT_LOCAL,
    keeps_all=True,
    published_rate_hz=7.25,
    rate_hz=12.5,
    paced_rate_hz=7.5,
    withheld=1500,
    withheld_by_cause={cause.value: 100 * number for number, cause in enumerate(WithheldCause, start=1)},
    deadlines_missed=4,
    swaps_begun=3,
    swaps_by_result={"ok": 2},
    last_swap=SwapRecord(
        number=2,
        result="ok",
        depth=365,
        deadline_ns=178_571_429,
        seconds_by_phase={"matching": 3.00125, "proving": 0.0325},
    ),
)
ANSWER = PlanAnswer(3, 30.0, 4, "/t: depth = 0")
RELAY = RelaySummary(
    other_host="base",
    is_reachable=True,
    fault="it speaks version 2",
    to_base=RelayTopics(offered=4, wanted=2, refused={"/odd": "no such type"}),
    to_robot=RelayTopics(offered=2, wanted=1),
    received=1000,
    doubled=3,
    unknown=2,
    incomplete=7,
    calls_failed={"timeout": 5},
    strangers=("rviz",),
)
FULL = encode_snapshot("/n", [REPLACED], left_out=2, answer=ANSWER, lacks_profile=True, relay=RELAY)
COLUMNS = {
    "topic": ["/t"],
    "type_name": ["t"],
    "payload_bytes": [1.0],
    "source_rate_hz": [1.0],
    "depth": [1],
    "baseline_depth": [1],
}
texts = st.text(max_size=2000)


def states(snapshot):
    return [PublisherState(**row) for row in snapshot.publishers]


@pytest.mark.parametrize(
    ("state", "relay"), [(PLAIN, None), (PLAIN, RelaySummary()), (REPLACED, RELAY)], ids=["plain", "empty", "full"]
)
def test_a_publisher_the_answer_and_the_relay_arrive_as_they_were(state, relay):
    """Encoding and decoding changes nothing; plan, lease and profile of a publisher are those of its node."""
    answer = replace(ANSWER, generation=state.generation, lease_s=state.lease_s)
    data = encode_snapshot("/n", [state], answer=answer, lacks_profile=state.lacks_profile, relay=relay, host="here")
    found = decode_snapshot(data)
    assert states(found) == [state]
    assert (found.node, found.answer, found.relay, found.host) == ("/n", answer, relay, "here")


def test_twenty_busy_publishers_take_less_than_two_kilobytes():
    """A snapshot of 20 publishers whose numbers all differ fits into two packets."""
    draw = random.Random(1)
    counts, rates = ("offered", "published"), ("source_rate_hz", "published_rate_hz", "paced_rate_hz", "blocked_s")
    busy = [
        replace(
            REPLACED,
            topic=f"/robot/{draw.randrange(10**6)}/command",
            **{name: draw.randrange(10**7) for name in counts},
            **{name: 100 * draw.random() for name in rates},
        )
        for _ in range(20)
    ]
    assert len(encode_snapshot("/planner", busy, answer=ANSWER)) < 2000


def test_as_many_publishers_as_a_daemon_manages_are_told_with_the_longest_names():
    """All arrive, and twice as much would: of names that nobody can compress, and the longest of all other texts."""
    draw = random.Random(1)
    types, words = (f"{begin}{'x' * (MOST_WORDS - len(begin))}" for begin in ("package/msg/", "a reader refuses"))
    many = [
        replace(
            REPLACED,
            topic="/" + "".join(draw.choices(string.ascii_letters, k=LONGEST_NAME - 1)),
            type_name=types,
            refusal=words,
            offered=draw.randrange(10**6),
            published_rate_hz=round(draw.random(), 6),
        )
        for _ in range(MOST_PUBLISHERS)
    ]
    data = encode_snapshot("/n", many, left_out=7, answer=ANSWER, lacks_profile=True)
    found = decode_snapshot(data)
    assert (states(found), found.left_out) == (many, 7)
    assert 2 * len(data) <= LONGEST_SNAPSHOT
    assert 2 * len(expand(data, most_bytes=MOST_BYTES, likely=LIKELY)) <= MOST_BYTES


def test_numbers_beyond_all_bounds_do_not_silence_a_node():
    """What the daemon would refuse is cut to what it takes."""
    last = SwapRecord(number=1, result="ok", depth=10**7, deadline_ns=0, seconds_by_phase={})
    absurd = replace(PLAIN, depth=10**7, payload_bytes=1e300, source_rate_hz=1e9, offered=2**70, last_swap=last)
    (found,) = states(decode_snapshot(encode_snapshot("/n", [absurd])))
    assert (found.depth, found.source_rate_hz, found.offered) == (10**5, 1e5, 2**63 - 1)
    assert found.payload_bytes == pytest.approx(2.0**30, rel=1e-5)


def spoilt(name, value):
    """Return a snapshot whose publisher, or head, has another value."""
    document = json.loads(expand(FULL, most_bytes=MOST_BYTES, likely=LIKELY))
    if name in {field.name for field in fields(PublisherState)} - JOINED:
        document["publishers"][name] = [value]
    else:
        document[name] = value
    return json.dumps(document).encode()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("source_rate_hz", 1e9),
        ("paced_rate_hz", True),
        ("queued", 2**63),
        ("topic", "/n/é"),
        ("withheld_by_cause", {"invented": 1}),
        ("swaps_by_result", {"x" * 1000: 1}),
        ("last_swap", {"number": 1, "result": "ok", "depth": -3, "deadline_ns": 0, "seconds_by_phase": {}}),
        ("last_swap", {"number": 1, "result": "invented", "depth": 3, "deadline_ns": 0, "seconds_by_phase": {}}),
        ("node", "no name"),
        ("answer", {"generation": 2**60}),
        ("publishers", {**COLUMNS, "depth": [1, 2]}),
        ("publishers", {name: values * (MOST_PUBLISHERS + 1) for name, values in COLUMNS.items()}),
        ("lacks_profile", 1),
        ("left_out", -1),
        ("relay", {"other_host": 7}),
    ],
)
def test_what_no_node_tells_is_refused(name, value):
    """A snapshot with one absurd value is refused as a whole."""
    with pytest.raises(ValueError, match=r"."):
        decode_snapshot(spoilt(name, value))


@given(st.binary(max_size=100), st.lists(st.tuples(st.integers(0, 10**4), st.integers(0, 255)), max_size=6))
@examples(60)
def test_any_bytes_are_a_snapshot_or_refused(noise, spoils):
    """Whatever arrives, only ValueError is raised."""
    plain = expand(FULL, most_bytes=MOST_BYTES, likely=LIKELY)
    for data in (bytearray(FULL), bytearray(plain)):
        for index, value in spoils:
            data[index % len(data)] = value
        for each in (noise, bytes(data)):
            try:
                found = states(decode_snapshot(each))
            except ValueError:
                continue
            assert all(state.depth >= 1 for state in found)


def packed(text):
    packer = zlib.compressobj(wbits=-15)
    return packer.compress(text) + packer.flush()


BOMBS = {
    "long": packed(b" " * 10**7),
    "deep": packed(b'{"a":' * 10**5),
    "number": packed(b'{"node":' + b"1" * 10**6 + b"}"),
    "list": b"[1]",
}


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS)
def test_what_grows_when_it_is_read_is_refused(bomb):
    """Neither a text that is long when it is unpacked, nor one that is deep, takes memory or time."""
    with pytest.raises(ValueError, match=r"."):
        decode_snapshot(bomb)


MANY = [f"/{number}" for number in range(1000)]


@given(st.dictionaries(texts, texts, max_size=30), st.lists(texts, max_size=30), texts)
@example(dict.fromkeys(MANY, "no such type"), MANY, "")
@examples(40)
def test_whatever_names_a_relay_has_its_summary_is_understood(named, strangers, fault):
    """Long, many and unprintable names are cut and shown, and words do nothing to a terminal."""
    topics = RelayTopics(offered=500, refused=named)
    told = RelaySummary(fault=fault, to_base=topics, to_robot=topics, strangers=tuple(strangers), other_host=fault)
    relay = decode_snapshot(encode_snapshot("/n", [], relay=told)).relay
    assert relay is not None
    assert relay.to_base.offered == 500
    assert bool(relay.to_base.refused) is bool(named)
    assert relay.fault.isprintable()
