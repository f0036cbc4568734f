"""Messages from the network, refused without harm, and without a network."""

import math
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray, UInt8MultiArray

from arpd.model.observation import MessageRefusal
from arpd.ros import inbox
from arpd.ros.cdr import doubles, octets
from arpd.ros.inbox import Inbox, Letters
from arpd.ros.other_daemons import OtherDaemons
from arpd.ros.price_message import encode_price
from arpd.ros.raw_reader import Sample
from tests.examples import examples
from tests.ros.world import FREE

LOW, OWN, HIGH = (bytes([number]) * 16 for number in (1, 2, 3))


class Clock:
    """A stopped clock."""

    now_s = 0.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock(monkeypatch):
    """Make no reader: the tests deliver."""
    monkeypatch.setattr(inbox, "RawReader", lambda *_arguments, **_options: None)
    monkeypatch.setattr(inbox, "ReadingThread", SimpleNamespace(of=lambda _context: None))
    return Clock()


NODE = SimpleNamespace(context=None)
QOS = None


@pytest.fixture
def letters(clock):
    """Return an inbox of numbers; `found` has those that arrived, and `words` what was said."""
    found, words = [], []
    kind = Letters(topic="/letters", decode=int, most_bytes=26, most_hz=5.0)
    made = Inbox(NODE, kind, QOS, lambda _sample, number: found.append(number), clock=clock, warn=words.append)
    made.found, made.words = found, words
    return made


def letter(content, writer=LOW):
    return Sample(serialize_message(UInt8MultiArray(data=content)), writer, 1)


def test_a_flood_of_one_writer_costs_no_other(letters):
    """Beyond its rate a writer is not heard, and another one is."""
    for number in range(1000):
        letters.take(letter(b"%d" % number))
    letters.take(letter(b"7", HIGH))
    assert letters.found == [*range(10), 7]
    assert letters.refused == {MessageRefusal.RATE: 990}


def test_a_letter_that_takes_long_to_read_counts_for_several(letters, clock):
    """So does one that cannot be read; in the next period its writer is heard again."""
    weigh = {None: 4.0, 7: 4.0}
    letters._letters = replace(letters._letters, weigh=lambda number: weigh.get(number, 0.0))
    for content in (b"7", b"x", b"1", b"2"):
        letters.take(letter(content))
    assert (letters.found, letters.refused) == ([7], {MessageRefusal.MALFORMED: 1, MessageRefusal.RATE: 2})
    clock.now_s = 2.0
    letters.take(letter(b"3"))
    assert letters.found == [7, 3]


def test_nonsense_is_counted_by_reason_and_said_once_a_minute(letters, clock):
    """Neither a message that is too long, nor one that is none, is delivered; each source is named once a minute."""
    for clock.now_s in (0.0, 1.0, 61.0):
        letters.take(letter(b"x"))
    letters.take(letter(b"1" * 11))
    assert letters.refused == {MessageRefusal.MALFORMED: 3, MessageRefusal.SIZE: 1}
    assert len(letters.words) == 3
    for number in range(10_000):
        letters.refuse(MessageRefusal.QUOTA, f"liar-{number}", "a lie")
    assert letters.refused[MessageRefusal.QUOTA] == 10_000
    assert len(letters.words) < 50
    assert not letters.found


@pytest.fixture
def daemons(clock):
    return OtherDaemons(NODE, OWN, tells_hosts=True, clock=clock)


@pytest.fixture
def price(daemons):
    """Deliver a price, or other numbers; return where the active daemon is then."""

    def price(writer, numbers=None):
        numbers = encode_price(FREE) if numbers is None else numbers
        daemons.inbox.take(Sample(serialize_message(Float64MultiArray(data=numbers)), writer, 1))
        return daemons.active_daemon()

    return price


def test_only_a_lower_guid_makes_a_daemon_stand_by(price, daemons, clock):
    """Its own price and those of higher GUIDs change nothing; the lower one counts until it is silent."""
    assert [price(who) for who in (OWN, HIGH, LOW)] == ["", "", "another host"]
    clock.now_s = 3.4
    assert daemons.active_daemon() == "another host"
    clock.now_s = 3.6
    assert daemons.active_daemon() == ""


def test_what_is_no_price_makes_no_daemon(price, daemons):
    """Nonsense is counted, and changes nothing."""
    assert [price(LOW, numbers) for numbers in ([1.0], [1.0] * 1000)] == ["", ""]
    assert daemons.inbox.refused == {MessageRefusal.MALFORMED: 1, MessageRefusal.SIZE: 1}


VALUES = [1.0, -math.inf, 2.5]
NUMBERS = serialize_message(Float64MultiArray(data=VALUES))
MESSAGE = serialize_message(UInt8MultiArray(data=bytes(range(40))))


@given(st.binary(max_size=60), st.lists(st.tuples(st.integers(0, 10**4), st.integers(0, 255)), max_size=6), st.data())
@examples(50)
def test_any_bytes_are_refused_or_read(noise, spoils, data):
    """Any bytes are refused or read, and nothing else is raised."""
    assert octets(MESSAGE) == bytes(range(40))
    assert list(doubles(NUMBERS)) == VALUES
    for message, read in ((MESSAGE, octets), (NUMBERS, doubles)):
        spoilt = bytearray(message[: data.draw(st.integers(0, len(message)))])
        for index, value in spoils:
            if spoilt:
                spoilt[index % len(spoilt)] = value
        for each in (noise, bytes(spoilt)):
            with suppress(ValueError):
                read(each)
