"""The frame of `arpd status` and `arpd top`, at any size and for any document."""

from __future__ import annotations

import copy
import re
from contextlib import suppress
from functools import reduce
from operator import getitem

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.errors import ArpdError
from arpd.model.link import LinkState
from arpd.model.plan import QosPlan
from arpd.model.settings import OnLost, Settings
from arpd.web.handlers import ASSETS
from tests.examples import examples
from tests.unit.drawn import printed
from tests.unit.fake_daemon import HISTORY, busy, document, event

BLOCKS = frozenset("▁▂▃▄▅▆▇█")


def test_a_frame_has_the_numbers_of_the_status():
    """Link, plan, publishers, ten minutes of history, and the last events."""
    answered = document(config_error="arpd.yaml:1:1: x: y; z")
    answered["events"] = [event(number, f"event {number} [bold]:boom:") for number in range(9)]
    lines = printed(answered, HISTORY, width=120, url="http://robot:9464")
    assert len([line for line in lines if BLOCKS & set(line)]) == 3
    for label, numbers in {
        "arpd": ("1.2.3", "wlan0", "http://robot:9464"),
        "link": ("4 Mbit/s", "peer"),
        "queue": ("12.5 ms", "1.6 %"),
        "plan": ("3", "3.5 Mbit/s", "2 of 3"),
        "/camera/image": ("12.5", "11.5", "30", "10", "100 ms", "link"),
    }.items():
        told = "".join(line for line in lines if line.startswith(f"{label} "))
        assert all(number in told for number in numbers), told
    assert "arpd.yaml:1:1: x: y; z" in "".join(lines)
    assert [line.partition("event ")[2] for line in lines if "event " in line] == [
        f"{n} [bold]:boom:" for n in range(4, 9)
    ]


def test_before_a_plan_there_is_none_and_a_state_has_the_words_of_the_page():
    """Zeros of a plan that nobody made would be numbers, and a key of the API no words."""
    lines = printed(document(link={"state": LinkState.APP_LIMITED}, decision={"plan": QosPlan()}))
    assert [line for line in lines if line.startswith("plan ")] == ["plan     none yet"]
    words = re.search(r'app_limited: "([^"]+)"', (ASSETS / "fields.js").read_text())[1]
    assert words in next(line for line in lines if line.startswith("link "))


def test_a_daemon_that_stands_by_is_not_called_the_one_in_charge():
    """Both see the other one in the ROS domain."""
    lines = printed(document(observation={"other_daemons": ("this host",), "active_daemon": "this host"}))
    assert [line for line in lines if "in charge" in line or "another one" in line] == []


@pytest.mark.parametrize("width", [60, 80, 132, 250])
def test_a_frame_fits_its_screen(width):
    """No line is too long; verdict and newest event stand above the topics."""
    lines = printed(busy(), HISTORY, width=width)
    assert max(map(len, lines)) <= width
    assert "The link is the limit" in lines[1]
    newest, topics = (next(i for i, line in enumerate(lines) if word in line) for word in ("event 29", "TOPIC"))
    assert newest < topics <= 24


HOSTILE = ("\x1b[2J", "\r\n\x07", "\u202e", "\x9b31m", "\ud800", "A" * 5000, "\u0301", "日本", "[bold]", ":boom:")


def leaves(document, path=()):
    """Return the path to every value of a document."""
    items = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in items:
        yield (*path, key)
        if isinstance(value, (dict, list)):
            yield from leaves(value, (*path, key))


RICH = document(settings=Settings(on_lost=OnLost.BASELINE))
RICH["events"] = [event(1, "text")]
RICH["faults"] = [RICH["verdict"] | {"text": "Reload refused: so.", "severity": "error", "wrong": True}]
LEAVES = list(leaves(RICH))
JUNK = st.one_of(
    st.none(), st.booleans(), st.floats(), st.integers(), st.sampled_from(HOSTILE), st.just([]), st.just({})
)
WORDS = [path for path in LEAVES if isinstance(reduce(getitem, path, RICH), str)]


@st.composite
def broken_documents(draw):
    """Return the document with odd words, and perhaps with values anywhere gone, or replaced by something else."""
    answered = copy.deepcopy(RICH)
    odd = st.lists(st.tuples(st.sampled_from(WORDS), st.sampled_from(HOSTILE)), max_size=6)
    for path, junk in draw(odd | st.lists(st.tuples(st.sampled_from(LEAVES), JUNK), max_size=6)):
        with suppress(KeyError, TypeError, IndexError):  # what was around it has gone
            reduce(getitem, path[:-1], answered)[path[-1]] = junk
    return answered


@examples(60)
@given(
    broken_documents(),
    st.sampled_from([None, HISTORY, {"link": 3}, HISTORY | {"link": {"allowed_ratio": [HOSTILE[0], None, 1e999]}}]),
    st.integers(1, 200),
)
def test_whatever_answers_neither_breaks_a_frame_nor_steers_the_terminal(answered, history, width):
    """Keys that are missing or hold something else are an error in one line; control characters are shown, not sent."""
    try:
        drawn = printed(answered, history, width=width, url=HOSTILE[0], why_silent=HOSTILE[1])
    except ArpdError as error:
        drawn = [str(error)]
    for line in drawn:
        assert all(character.isprintable() for character in line)
