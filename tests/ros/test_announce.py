"""Announcements to and from diagnostic_msgs."""

from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import KeyValue
from rclpy.serialization import serialize_message

from arpd.adapters.ros.announcement import from_status, reader_from_status, reader_to_status, to_status
from arpd.model.endpoints import Direction, RefusalReason, SwapPhase, SwapRecord, SwapResult, WithheldCause
from tests.sample_publishers import publisher, reader

pytestmark = pytest.mark.ros
PLAIN = publisher("/n", "/t", direction=Direction.LOCAL)
LATCHED = publisher(
    "/n",
    "/t",
    direction=Direction.LOCAL,
    refusal="it is TRANSIENT_LOCAL",
    refusal_reason=RefusalReason.TRANSIENT_LOCAL,
    keeps_all=True,
)
REPLACED = publisher(
    "/n",
    "/t",
    direction=Direction.LOCAL,
    lacks_profile=True,
    published_rate_hz=7.25,
    rate_hz=12.5,
    paced_rate_hz=7.5,
    withheld=1300,
    withheld_by_cause={cause.value: 100 * number for number, cause in enumerate(WithheldCause, start=1)},
    deadlines_missed=4,
    swaps_begun=3,
    swaps_by_result={"ok": 2},
    swap_seconds_by_phase={phase.value: 12.5 for phase in SwapPhase},
    last_swap=SwapRecord(
        number=2,
        result=SwapResult.OK,
        depth=365,
        deadline_ns=178_571_429,
        seconds_by_phase={SwapPhase.MATCHING: 3.00125, SwapPhase.PROVING: 0.0325},
    ),
)
NEW_KEYS = (
    *("paced_rate_hz", "published_rate_hz", "withheld_", "deadlines_missed"),
    *("begun_swaps", "swap_seconds", "last_swap"),
)


DRIVEN = reader(
    "/n",
    "/t",
    deadline_ns=50_000,
    baseline_deadline_ns=70_000,
    generation=3,
    lease_s=30.0,
    swaps_by_result={"ok": 2},
)
REFUSING = replace(
    DRIVEN,
    refusal="not in time",
    refusal_reason=RefusalReason.UNMATCHED,
    keeps_all=True,
    swaps_by_result={},
    deadlines_missed=12,
)


@pytest.fixture(params=[DRIVEN, REFUSING], ids=["driven", "refused"])
def ros_reader(request):
    return request.param


@pytest.mark.parametrize("state", [PLAIN, LATCHED, REPLACED], ids=["plain", "refused", "swapped"])
def test_a_publisher_is_read_as_it_was_announced(state):
    """Encoding and decoding an announcement changes nothing."""
    assert from_status(to_status(state)) == state


def test_a_reader_is_read_as_it_was_announced(ros_reader):
    """Encoding and decoding a reader's announcement changes nothing."""
    assert reader_from_status(reader_to_status(ros_reader)) == ros_reader


def test_a_readers_announcement_is_small():
    """A reader's announcement is a few hundred bytes."""
    assert len(serialize_message(reader_to_status(DRIVEN))) < 600


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("node", "no name"),
        ("topic", "/" + "a" * 300),
        ("depth", "0"),
        ("deadline_ns", "-1"),
        ("lease_s", "nan"),
        ("lease_s", "inf"),
        ("generation", "many"),
        ("baseline_depth", None),
        ("deadlines_missed", "-1"),
    ],
)
def test_nonsense_about_a_reader_is_refused(key, value):
    """A reader's announcement with a missing, malformed or impossible field is refused."""
    status = reader_to_status(DRIVEN)
    status.values = [pair for pair in status.values if pair.key != key]
    status.values += [KeyValue(key=key, value=value)] if value is not None else []
    with pytest.raises(ValueError, match=r"."):
        reader_from_status(status)


def test_an_announcer_cannot_make_labels_without_end():
    """The number and length of invented swap results are bounded."""
    status = to_status(PLAIN)
    status.values += [KeyValue(key=f"swaps_{i}{'x' * 100}", value="1") for i in range(60)]
    swaps = from_status(status).swaps_by_result
    assert len(swaps) <= 32
    assert max(map(len, swaps)) <= 40


def test_an_older_announcer_is_understood():
    """Without a reason a refusal may pass, and without a history there is a depth."""
    status = to_status(LATCHED)
    status.values = [pair for pair in status.values if pair.key not in {"refusal_reason", "history"}]
    state = from_status(status)
    assert (state.refusal, state.refusal_reason) == ("it is TRANSIENT_LOCAL", RefusalReason.OTHER)
    assert not state.keeps_all


def test_an_announcer_of_before_the_accounts_is_understood():
    """Missing counters are zero, and the paced rate is that of the plan."""
    status = to_status(REPLACED)
    status.values = [pair for pair in status.values if not pair.key.startswith(NEW_KEYS)]
    state = from_status(status)
    assert (state.withheld, dict(state.withheld_by_cause), state.deadlines_missed) == (1300, {}, 0)
    assert (state.published_rate_hz, state.swaps_begun, state.last_swap) == (0.0, 0, None)
    assert state.paced_rate_hz == state.rate_hz == 12.5
    assert not state.swap_seconds_by_phase


def test_what_never_happened_is_not_announced():
    """A publisher that was never re-tuned announces no swap and no cause."""
    assert not [pair.key for pair in to_status(PLAIN).values if pair.key.startswith(NEW_KEYS)]
    idle_reader = reader_to_status(DRIVEN)
    assert "deadlines_missed" not in [pair.key for pair in idle_reader.values]


def test_unknown_causes_and_phases_make_no_labels():
    """Only known causes and phases of an announcement are kept."""
    status = to_status(REPLACED)
    invented = {
        "withheld_by_cause": "moon=1 price=2 =3 x",
        "swap_seconds_by_phase": "moon=1 holding=0.5",
        "last_swap": "7 moon 1 0 moon=1 proving=2 =3 x",
    }
    status.values = [pair for pair in status.values if pair.key not in invented]
    status.values += [KeyValue(key=key, value=value) for key, value in invented.items()]
    state = from_status(status)
    assert state.withheld_by_cause == {WithheldCause.PRICE: 2}
    assert state.swap_seconds_by_phase == {SwapPhase.HOLDING: 0.5}
    assert state.last_swap == SwapRecord(
        number=7, result="moon", depth=1, deadline_ns=0, seconds_by_phase={SwapPhase.PROVING: 2.0}
    )


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("payload_bytes", "1e12"),
        ("source_rate_hz", "1e9"),
        ("source_rate_hz", "nan"),
        ("blocked_s", "1e300"),
        ("lease_s", "1e10"),
        ("rate_hz", "-1"),
        ("depth", "1000000"),
        ("generation", str(2**63 - 1)),
        ("queued", "9" * 5000),
        ("node", "/n/" + "é"),
        ("published_rate_hz", "1e9"),
        ("paced_rate_hz", "nan"),
        ("paced_rate_hz", "-1"),
        ("withheld_by_cause", "rate=1 price=-1"),
        ("withheld_by_cause", "price"),
        ("deadlines_missed", "some"),
        ("begun_swaps", "1.5"),
        ("swap_seconds_by_phase", "holding=inf"),
        ("swap_seconds_by_phase", "holding=long"),
        ("last_swap", ""),
        ("last_swap", "1 ok"),
        ("last_swap", "1 ok -3 0"),
        ("last_swap", "1 ok 3 0 holding=nan"),
        ("last_swap", "1 ok 3 0 holding"),
    ],
)
def test_what_no_publisher_is_like_is_refused(key, value):
    """A publisher's announcement with absurd values is refused."""
    status = to_status(REPLACED)
    status.values = [pair for pair in status.values if pair.key != key] + [KeyValue(key=key, value=value)]
    with pytest.raises(ValueError, match=f"announcement.*{key if value.isascii() else 'name'}"):
        from_status(status)


def test_a_reader_cannot_ask_a_writer_for_a_nanosecond():
    """A reader's deadline that no writer can keep is refused."""
    with pytest.raises(ValueError, match="shorter than 10000 ns"):
        reader_from_status(reader_to_status(replace(DRIVEN, deadline_ns=1)))


def test_words_of_others_do_nothing_to_a_terminal():
    """Every text of an announcement is printable."""
    lurid = replace(REPLACED.last_swap, result="\x1b[2J")
    status = to_status(
        replace(LATCHED, refusal="\x1b[2J\nno", type_name="a\x07", swaps_by_result={"\x1b": 1}, last_swap=lurid)
    )
    state = from_status(status)
    assert state.last_swap.result == "?[2J"
    assert (state.refusal, state.type_name, dict(state.swaps_by_result)) == ("?[2J?no", "a?", {"?": 1})
