"""The frame of `arpd status` and `arpd top`, at any size and for any document."""

from __future__ import annotations

import copy
from functools import reduce
from operator import getitem

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.errors import ArpdError
from tests.examples import examples
from tests.unit.drawn import on_screen, printed
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
    assert [line.partition("event ")[2] for line in lines[-5:]] == [f"{n} [bold]:boom:" for n in range(4, 9)]


@pytest.mark.parametrize("width", [60, 80, 132, 250])
@pytest.mark.parametrize("height", [10, 12, 13, 24, 60])
def test_a_frame_fits_its_screen(width, height):
    """No line is too many or too long; the verdict is always there, and the newest event with any."""
    lines = on_screen(busy(), HISTORY, width=width, height=height)
    assert len(lines) <= max(height, 11)
    assert max(map(len, lines)) <= width
    assert "The link is the limit" in lines[1]
    assert any("event 29" in line for line in lines) == any("event" in line for line in lines) == (height >= 12)


HOSTILE = ("\x1b[2J", "\r\n\x07", "\u202e", "\x9b31m", "\ud800", "A" * 5000, "\u0301", "日本", "[bold]", ":boom:")


def leaves(document, path=()):
    """Return the path to every value of a document."""
    items = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in items:
        yield (*path, key)
        if isinstance(value, (dict, list)):
            yield from leaves(value, (*path, key))


RICH = document(lease_s=3.0)
RICH["events"] = [event(1, "text")]
RICH["faults"] = [RICH["verdict"] | {"text": "Reload refused: so.", "severity": "error", "wrong": True}]
TEXTS = [
    ("version",),
    ("interface",),
    ("link", "evidence"),
    ("plan", "reason"),
    ("verdict", "text"),
    ("topics", 0, "topic"),
    ("events", 0, "text"),
]
JUNK = st.one_of(
    st.none(), st.booleans(), st.floats(), st.integers(), st.sampled_from(HOSTILE), st.just([]), st.just({})
)


@st.composite
def broken_documents(draw):
    """Return the document with odd words, and perhaps with values anywhere gone, or replaced by something else."""
    answered = copy.deepcopy(RICH)
    for path in TEXTS:
        reduce(getitem, path[:-1], answered)[path[-1]] = draw(st.sampled_from(HOSTILE))
    for path in draw(st.just([]) | st.lists(st.sampled_from(list(leaves(RICH))), max_size=6)):
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


@examples(60)
@given(
    broken_documents(),
    st.sampled_from([None, HISTORY, {"link": 3}, HISTORY | {"link": {"allowed_ratio": [HOSTILE[0], None, 1e999]}}]),
    st.integers(1, 200),
)
def test_whatever_answers_neither_breaks_a_frame_nor_steers_the_terminal(answered, history, width):
    """Keys that are missing or hold something else are an error in one line; control characters are shown, not sent."""
    try:
        drawn = on_screen(answered, history, width=width, height=20, url=HOSTILE[0], why_silent=HOSTILE[1])
        drawn += printed(answered, history, width=width)
    except ArpdError as error:
        drawn = [str(error)]
    for line in drawn:
        assert all(character.isprintable() for character in line)
