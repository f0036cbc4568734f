"""Announcements to and from diagnostic_msgs."""

from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import KeyValue

from arpd.adapters.ros.announcement import from_status, to_status
from arpd.model.endpoints import Direction, RefusalReason, SwapPhase, SwapRecord, SwapResult, WithheldCause
from tests.sample_publishers import publisher

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


@pytest.mark.parametrize("state", [PLAIN, LATCHED, REPLACED], ids=["plain", "refused", "swapped"])
def test_a_publisher_is_read_as_it_was_announced(state):
    """Encoding and decoding an announcement changes nothing."""
    assert from_status(to_status(state)) == state


def test_an_announcer_cannot_make_labels_without_end():
    """The number and length of invented swap results are bounded."""
    status = to_status(PLAIN)
    status.values += [KeyValue(key=f"swaps_{i}{'x' * 100}", value="1") for i in range(60)]
    swaps = from_status(status).swaps_by_result
    assert len(swaps) <= 32
    assert max(map(len, swaps)) <= 40


def test_words_of_others_do_nothing_to_a_terminal():
    """Every text of an announcement is printable."""
    lurid = SwapRecord(number=1, result="\x1b[2J", depth=1, deadline_ns=0, seconds_by_phase={})
    status = to_status(
        replace(LATCHED, refusal="\x1b[2J\nno", type_name="a\x07", swaps_by_result={"\x1b": 1}, last_swap=lurid)
    )
    state = from_status(status)
    assert state.last_swap == replace(lurid, result="?[2J")
    assert (state.refusal, state.type_name, dict(state.swaps_by_result)) == ("?[2J?no", "a?", {"?": 1})


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
        ("paced_rate_hz", "nan"),
        ("withheld_by_cause", "rate=1 price=-1"),
        ("withheld_by_cause", "price"),
        ("deadlines_missed", "some"),
        ("begun_swaps", "1.5"),
        ("swap_seconds_by_phase", "holding=inf"),
        ("last_swap", ""),
        ("last_swap", "1 ok -3 0"),
        ("last_swap", "1 ok 3 0 holding=nan"),
    ],
)
def test_what_no_publisher_is_like_is_refused(key, value):
    """A publisher's announcement with absurd values is refused."""
    status = to_status(REPLACED)
    status.values = [pair for pair in status.values if pair.key != key] + [KeyValue(key=key, value=value)]
    with pytest.raises(ValueError, match=f"announcement.*{key if value.isascii() else 'name'}"):
        from_status(status)
