"""What is on its way across the link: never too much of it, and an outage is noticed."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.relay.envelope import WRAP
from arpd.relay.flight import Flight, Receipt, Received, Sign, decode_sign, encode_sign

ABROAD_S = 12_345.6  # how far the receiver's clock is ahead


class Ends:
    """A sender and a receiver; nothing arrives by itself."""

    def __init__(self):
        self.now_s = 4294.0  # the µs of this clock wrap within a second
        self.flight, self.received = Flight(), Received()
        self.on_way = []

    def send(self, size=1000):
        self.on_way.append((self.flight.send(size, self.now_s, size=size), size, self.now_s))

    def confirm(self, chunks):
        """Let the oldest chunks arrive, and a receipt for them."""
        there_s = self.now_s + ABROAD_S
        for number, size, sent_s in self.on_way[:chunks]:
            self.received.note(7, number, int(sent_s * 1e6) % WRAP, size, there_s)
        del self.on_way[:chunks]
        self.flight.confirm(self.received.take(there_s), self.now_s)


def test_no_more_is_on_its_way_than_a_quarter_of_a_second_of_the_capacity():
    """However fast a burst seems to arrive, the capacity that the daemon tells bounds what follows."""
    assert 60 < most_on_its_way(is_lossy=False) < most_on_its_way(is_lossy=True) <= 250


def most_on_its_way(*, is_lossy):
    """Return the milliseconds of the capacity that small messages may fill."""
    ends = Ends()
    ends.flight.believe(1e6, is_lossy=is_lossy)
    for _ in range(20):
        ends.send(100_000)
        ends.now_s += 0.01
        ends.confirm(1)
    while ends.flight.has_room(is_small=True):
        ends.send(1000)
    return len(ends.on_way)


@given(st.floats(0.001, 0.2), st.integers(1, 30), st.integers(0, 3))
def test_an_outage_is_noticed_in_time_and_ends_with_a_receipt(trip_s, trips, unconfirmed):
    """The link is out 0.4 s and the usual trip after the last receipt, until there is another one."""
    ends = Ends()
    for _ in range(trips):
        ends.send()
        ends.now_s += trip_s
        for _ in range(unconfirmed):
            ends.send()
        ends.confirm(1)
    ends.send()
    assert ends.now_s + 0.399 < ends.flight.out_s
    assert ends.now_s + 0.4 + trip_s + 0.001 >= ends.flight.out_s
    ends.now_s += 10.0
    ends.flight.confirm(Receipt(session=7, number=WRAP - 1), ends.now_s)  # of before: nothing new has arrived
    assert ends.now_s >= ends.flight.out_s
    ends.confirm(1)
    assert ends.now_s < ends.flight.out_s


def test_a_queue_that_stays_on_the_link_drains():
    """Less is sent than the link carries while all is late, and a little more than its share again afterwards."""
    ends = Ends()
    for late_s, is_drained in ((0.0, True), (0.1, False), (0.0, True)):
        for _ in range(30):
            ends.send()
            ends.now_s += 0.01 + late_s
            ends.confirm(1)
        assert (ends.flight.relief > 1.0) == is_drained, late_s


def test_receipts_that_are_held_up_on_their_way_take_no_room():
    """A radio that sleeps gets its receipts by the tenth of a second, while all that it sends arrives at once."""
    rooms = []
    for held_s in (0.0, 0.08):
        ends = Ends()
        ends.flight.believe(1e6, is_lossy=False)
        for _ in range(20):
            receipts = []
            for _ in range(10):
                number = ends.flight.send(10_000, ends.now_s, size=10_000)
                ends.now_s += 0.01
                ends.received.note(7, number, int(ends.now_s * 1e6 - 5e3) % WRAP, 10_000, ends.now_s + ABROAD_S)
                receipts.append(ends.received.take(ends.now_s + ABROAD_S))
                if not held_s:
                    ends.flight.confirm(receipts.pop(), ends.now_s)
            for each in receipts:
                ends.flight.confirm(each, ends.now_s)
        rooms.append(ends.flight.window_bytes)
    assert rooms[0] < 60_000
    assert 100_000 < rooms[1] < 200_000


def test_what_went_to_a_process_that_is_gone_holds_nothing_up():
    """After a restart of the other end sending goes on."""
    ends = Ends()
    while ends.flight.has_room(is_small=True):
        ends.send()
    ends.now_s += 1.0
    assert ends.now_s >= ends.flight.out_s
    ends.flight.restart()
    assert ends.now_s < ends.flight.out_s
    assert ends.flight.has_room(is_small=False)


@given(st.integers(0, WRAP - 1), st.lists(st.floats(0.0, 1.0), min_size=1, max_size=30))
def test_an_age_is_the_lateness_whatever_the_clocks_say(offset_us, delays):
    """A chunk is as old as it is later than the fastest before it, with any offset of clocks that wrap."""
    received = Received()
    sent = [(4294.0 + number / 10.0, delay_s) for number, delay_s in enumerate(delays)]
    fastest_s = math.inf
    for sent_s, delay_s in sorted(sent, key=sum):
        fastest_s = min(fastest_s, delay_s)
        departed_us = (int(sent_s * 1e6) + offset_us) % WRAP
        age_s = received.note(7, 1, departed_us, 100, sent_s + delay_s)
        assert age_s == pytest.approx(delay_s - fastest_s, abs=1e-5)


def test_numbers_and_bytes_wrap_and_begin_anew_with_a_session():
    """A receipt names the newest chunk and counts on beyond the last number; of a restarted sender it knows nothing."""
    received = Received()
    received.note(6, 1000, 0, 500, 1.0)
    for number, size in ((WRAP - 2, WRAP - 10), (0, 20), (WRAP - 1, 5), (1, 5)):
        received.note(7, number, 0, size, 1.0)
    receipt = received.take(1.0)
    assert (receipt.session, receipt.number, receipt.received) == (7, 1, 20)


NUMBERS = st.integers(0, WRAP - 1)
SIGNS = st.builds(Sign, NUMBERS, NUMBERS, NUMBERS, st.builds(Receipt, NUMBERS, NUMBERS, NUMBERS, NUMBERS, NUMBERS))


@given(SIGNS, st.integers(0, 255), st.binary(max_size=60))
def test_a_sign_arrives_as_it_was_sent_or_is_refused(sign, version, other):
    """Every field survives up to its last value; an end of another version is not misunderstood."""
    good = encode_sign(sign)
    assert decode_sign(good) == sign
    for data in (bytes([version]) + good[1:], other, good[:-1], good + other):
        if data[:1] != good[:1] or len(data) != len(good):
            with pytest.raises(ValueError, match="version"):
                decode_sign(data)


def test_after_a_receipt_for_much_the_next_one_is_expected_and_after_one_for_little_none():
    """So of chunks that come quickly none has to wake the thread that sends receipts."""
    received = Received()
    for number, (size, is_quick) in enumerate([(20_000, True), (100, False)], 1):
        received.note(7, number, 0, size, 10.0 + number)
        received.take(10.0 + number)
        assert (received.expects_s > 10.0 + number) == is_quick
    received.note(7, 3, 0, 20_000, 20.0)
    received.take(20.0)
    expected_s = received.expects_s
    received.note(7, 4, 0, 20_000, 20.001)
    assert received.due_s() == expected_s
