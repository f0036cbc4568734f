"""The frame of `arpd status` and `arpd top`, at any size and for any document."""

from __future__ import annotations

import copy
import re
import time
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.cli.frame import sparkline
from arpd.model.endpoints import RefusalReason
from arpd.model.relay import RelaySummary, RelayTopics
from tests.unit.drawn import on_screen, printed
from tests.unit.fake_daemon import HISTORY, busy, calm, demo_robot, document, event

AT = time.strftime("%H:%M:%S", time.localtime(1e9))
BLOCKS = frozenset("▁▂▃▄▅▆▇█")


def test_a_frame_has_everything():
    """It has verdict, link with its ten minutes, plan, program and every publisher and reader, and the last events."""
    answered = document(config_error="arpd.yaml:1:1: x: y; z", lease_s=30.0, rmw_refusal="rmw_x is only paced")
    answered["link"] |= {"loss_ratio": 0.00412, "return_delay_seconds": 0.0123, "foreign_bytes_per_second": 1e5}
    answered["daemons"]["others"] = ["spare"]
    answered["topics"][0] |= {
        "published_rate_hz": 11.6,
        "withheld_by_cause": {"price": 38, "rate": 12, "blocked": 0},
        "deadlines_missed": 3,
    }
    reader = {"topic": "/a", "node": "/n", "planned": None, "confirmed": {"depth": 10}, "refusal": ""}
    answered["readers"] = [
        reader | {"topic": "/b", "planned": {"depth": 5, "deadline_ns": 10**8}},
        reader | {"refusal": "no match", "deadlines_missed": 2},
        reader,
    ]
    answered["verdict"]["text"] = "Not everything fits: so."
    answered["events"] = [event(number, f"event {number} [bold]:boom:") for number in range(9)]
    lines = printed(answered, HISTORY, width=120, url="http://robot:9464")
    link, queue, admitted = (line for line in lines if BLOCKS & set(line))
    assert re.fullmatch(r"link     5 Mbit/s \(peer, congested\) +[▁▂▃▄▅▆▇█ ]{50,} ≤ 20 Mbit/s", link)
    assert re.fullmatch(r"queue    120 ms, loss 0.41 %, return delay 12.3 ms +▁+█▁+ ≤ 350 ms", queue)
    assert re.fullmatch(r"admitted 50 % above the floors +█+▅█+ ≥ 50 %", admitted)
    assert [line for line in lines if not BLOCKS & set(line)] == [
        f"arpd 1.2.3 on wlan0, {AT} (50 ms ago), http://robot:9464",
        "wrong: Not everything fits: so.",
        "wrong: Reload refused: arpd.yaml:1:1: x: y; z (the configuration in force stays).",
        "",
        "traffic  delivering 4.8 Mbit/s, budget 4 Mbit/s, 800 kbit/s of cross traffic, 5 Mbit/s left",
        "evidence down: the queue grew",
        "plan     3 for 4.25 Mbit/s: 0 of 1 publishers confirmed",
        "         held: dwell; refused up: dwell",
        "program  degraded, bound by link (osqp, 400 us); 512 MiB of 1 GiB memory available",
        "withheld 50 of 200 messages (25 %): price 38, rate 12",
        "lease    after 30 s without this daemon, publishers and readers return to their own QoS",
        "rmw      rmw_x is only paced",
        "daemons  in charge; another one stands by on spare",
        "",
        "TOPIC   ALLOWED  SENT  SOURCE  DEPTH  DEADLINE  WITHHELD            CAUSES  LATE  BOUND BY",
        "/image     12.5  11.6      30    7→8    100 ms      25 %  price:38 rate:12     3  link",
        "",
        "READER OF  DEPTH     DEADLINE  LATE  NODE",
        "/b          10→5  none→100 ms     -  /n",
        "/a            10         none     2  /n: no match",
        "readers that no plan touches: 1",
        "",
        *(f"{AT}  event {number} [bold]:boom:" for number in range(4, 9)),
    ]


def test_the_topics_that_need_a_look_come_first():
    """First refusals, then those that the link slows most."""
    names = [line.split()[0] for line in printed(busy()) if line.startswith("/")]
    assert names[:3] == ["/link/odom", "/link/camera/image/compressed", "/link/points"]
    assert len(names) == 12


@pytest.mark.parametrize("width", [60, 80, 132, 250])
@pytest.mark.parametrize("height", [10, 12, 13, 24, 60])
def test_a_frame_fits_its_screen(width, height):
    """No line is too many or too long; the verdict is always there, and the newest event with any."""
    lines = on_screen(busy(), HISTORY, width=width, height=height)
    assert len(lines) <= max(height, 11)
    assert max(map(len, lines)) <= width
    assert "The link is the limit" in lines[1]
    assert any("event 29" in line for line in lines) == any("event" in line for line in lines) == (height >= 12)


@pytest.mark.parametrize("width", [60, 80, 132])
def test_a_printed_frame_has_every_topic_and_no_line_that_wraps(width):
    """Names keep their end, and columns go before rate and reason do."""
    lines = printed(busy(), HISTORY, width=width)
    assert max(map(len, lines)) <= width
    assert len([line for line in lines if line.startswith(("/", "…"))]) == 12
    heading = next(line for line in lines if line.startswith("TOPIC"))
    assert all(title in heading for title in ("ALLOWED", "SENT", "BOUND BY"))


@pytest.mark.parametrize("height", [24, 30, 36, 50])
@pytest.mark.parametrize("readers", [0, 11])
def test_a_screen_is_filled_with_events(height, readers):
    """The log takes the lines that the rest leaves; readers make way for topics."""
    reader = {"topic": "/a", "node": "/n", "planned": {"depth": 5}, "confirmed": {"depth": 10}, "refusal": ""}
    answered = busy() | {"readers": [reader] * readers}
    lines = on_screen(answered, height=height)
    assert lines[-1].endswith("event 29")
    assert len([line for line in lines if line.startswith("/link")]) >= (11 if height >= 30 else 5)
    assert any("READER OF" in line for line in lines) == (readers > 0 and height == 50)


def test_topics_that_do_not_fit_are_summed_up():
    """A line has their number, and the number of those that the link slows."""
    answered = calm(publishers=demo_robot())
    for topic in answered["topics"]:
        topic["kept_ratio"] = 0.01
    lines = on_screen(answered, width=80, height=18)
    shown = [line for line in lines if line.startswith(("/", "…")) and "more" not in line]
    assert 0 < len(shown) < 12
    rest = 12 - len(shown)
    assert f"… and {rest} more topics, {rest} of them slowed" in lines


def test_a_daemon_without_history_has_no_sparklines():
    """An older daemon without history has numbers only."""
    lines = printed(busy())
    assert not BLOCKS & set("".join(lines))
    assert "queue    120 ms" in lines


def test_a_silent_daemon_is_said_to_be_silent():
    """The frame says for how long, and from when its contents are."""
    lines = on_screen(busy(), why_silent="no daemon answers", silent_s=12.4)
    assert lines[1] == f"no answer for 12 s, this is from {AT}: no daemon answers"


def test_a_daemon_before_its_first_tick_has_a_frame():
    """The frame says that it is not ready."""
    assert "Not ready" in printed({"api_version": "v1", "ready": False})[1]


def test_a_hundred_topics_keep_the_end_of_their_names():
    """Names that differ at the end only stay apart in 80 columns."""
    publishers = [replace(demo_robot()[0], topic=f"/robot/{'sensors/' * 5}{number:03d}") for number in range(100)]
    lines = printed(calm(publishers=tuple(publishers)), width=80)
    assert len({line.split()[0][-3:] for line in lines if line.startswith("…")}) == 100


RELAY = RelaySummary(
    other_host="ceddp",
    is_reachable=True,
    to_ceddp=RelayTopics(offered=14, wanted=4),
    to_robot=RelayTopics(offered=3, wanted=1),
)


def test_a_relay_with_two_ends_has_a_line():
    """It says what crosses, and what went wrong where something did."""
    assert "relay    4 of 14 topics cross to the CEDDP (ceddp), 1 of 3 to the robot" in printed(calm(relay=RELAY))
    waits = "relay    0 of 0 topics wait to cross to the CEDDP, 0 of 0 to the robot"
    assert waits in printed(calm(relay=RelaySummary()))
    troubled = replace(
        RELAY, incomplete=40, calls_failed={"timeout": 2, "type": 1}, strangers=("rviz",), types_differ={"/a": "A, B"}
    )
    line = next(line for line in printed(calm(relay=troubled)) if line.startswith("relay"))
    assert line.split("; ")[1:] == [
        "40 samples of incomplete groups dropped",
        "3 calls failed",
        "1 topics with two types",
        "1 nodes in the link domain that are not arpd's",
    ]


def test_what_is_as_it_should_be_has_no_line():
    """Relay, withheld messages, lease, middleware and other daemons show where there is something to say."""
    labels = {line.split()[0] for line in printed(calm(publishers=())) if line}
    assert not labels & {"relay", "withheld", "lease", "rmw", "daemons", "TOPIC", "READER"}


def test_it_tells_a_refusal_for_good_from_one_that_may_pass():
    """A publisher that never swaps is marked; a refusal that may pass is as it came."""
    for reason, shown, counted in (
        (RefusalReason.TRANSIENT_LOCAL, "rate only: latched", " (1 by rate only) confirmed\n"),
        (RefusalReason.UNMATCHED, "  latched", "publishers confirmed\n"),
    ):
        lines = "\n".join(printed(calm(refusal="latched", refusal_reason=reason)))
        assert shown in lines
        assert counted in lines


def test_it_understands_an_older_daemon():
    """What an older daemon does not say is missing."""
    older = calm()
    newer = {
        "": "lease readers rmw verdict faults events memory",
        "plan": "readers readers_confirmed paced_only",
        "link": "loss_ratio return_delay_seconds",
        "topics": "refusal_lasts refusal_reason published_rate_hz withheld_by_cause deadlines_missed kept_ratio",
    }
    for place, keys in newer.items():
        for key in keys.split():
            del {"": older, "topics": older["topics"][0]}.get(place, older.get(place))[key]
    del older["topics"][0]["confirmed"]["paced_rate_hz"]
    shown = "\n".join(printed(older))
    assert "1 of 1 publishers confirmed\n" in shown
    assert not [word for word in ("lease", "loss", "memory", "SENT", "LATE", "CAUSES") if word in shown]


HOSTILE = ("\x1b[2J", "\r\n\x07", "\u202e", "\x9b31m", "\ud800", "A" * 5000, "\u0301", "日本", "[bold]", ":boom:")


def leaves(document, path=()):
    """Return the path to every value of a document."""
    items = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in items:
        yield (*path, key)
        if isinstance(value, (dict, list)):
            yield from leaves(value, (*path, key))


def rich_document():
    """Return a document with something everywhere."""
    answered = calm(lease_s=3.0, refusal="it refuses", refusal_reason=RefusalReason.UNMATCHED)
    answered["readers"] = [
        {
            "topic": "/a",
            "node": "/n",
            "planned": {"depth": 1, "deadline_ns": 1},
            "confirmed": {"depth": 1},
            "refusal": "",
        }
    ]
    answered["events"] = [event(1, "text")]
    answered["faults"] = [{"text": "Reload refused: so.", "severity": "error", "wrong": True}]
    answered["topics"][0]["withheld_by_cause"] = {"rate": 3}
    return answered


RICH = rich_document()
JUNK = st.one_of(
    st.none(), st.booleans(), st.floats(), st.integers(), st.sampled_from(HOSTILE), st.just([]), st.just({})
)


@st.composite
def broken_documents(draw):
    """Return the document with values anywhere gone, or replaced by something else."""
    answered = copy.deepcopy(RICH)
    for path in draw(st.lists(st.sampled_from(list(leaves(RICH))), max_size=6)):
        holder = answered
        for key in path[:-1]:
            holder = holder[key] if isinstance(holder, dict) and key in holder else None
            if not isinstance(holder, (dict, list)):
                break
        if isinstance(holder, dict):
            if draw(st.booleans()):
                holder.pop(path[-1], None)
            else:
                holder[path[-1]] = draw(JUNK)
    return answered


@settings(max_examples=60, deadline=None)  # other tests load the cores
@given(
    broken_documents(),
    st.sampled_from([None, HISTORY, {"link": 3}, {"gate": [HOSTILE[0], None, 1e999]}]),
    st.integers(1, 200),
)
def test_whatever_answers_neither_breaks_a_frame_nor_steers_the_terminal(answered, history, width):
    """Keys that are missing or hold something else leave a gap; control characters are shown, not sent."""
    drawn = on_screen(answered, history, width=width, height=20, url=HOSTILE[0], why_silent=HOSTILE[1])
    for line in (*drawn, *printed(answered, history, width=width)):
        assert all(character.isprintable() for character in line)


@pytest.mark.parametrize(
    ("samples", "columns", "shown"),
    [
        ([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], 8, "▁▂▃▄▅▆▇█"),
        ([1.0, 7.0, 1.0, 1.0], 2, "█▂"),
        ([None, None, 3.5, 9.0], 2, " █"),
        ([7.0], 40, "█"),
        ([], 5, ""),
    ],
)
def test_a_sparkline_keeps_the_worst_of_what_shares_a_column(samples, columns, shown):
    """A queue of one second in ten minutes is visible."""
    assert sparkline(samples, columns, max, 7.0) == shown
    assert not set(sparkline(samples, columns, max, 0.0)) - {" ", "▁"}
