"""Receiver of probes at the peer: the dispersion of trains."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate.receiver import (
    BUSY_S,
    LONGEST_QUIET_S,
    PROMPT_S,
    QUIET_S,
    WORTH_BYTES,
    Arrival,
    Receiver,
    measure_train,
)
from arpd.model.probing import ProbeHeader
from arpd.model.wire import probe_wire_bytes

SIZE = 1200
WIRE = probe_wire_bytes(SIZE)
RATE = 625_000.0  # 5 Mbit/s
SPACING_NS = round(WIRE / RATE * 1e9)
OFFSET_NS = -7 * 10**15  # the two clocks never agreed


def arrivals(received_ns, *, sent_every_ns, wire_bytes=WIRE):
    return [
        Arrival(wire_bytes=wire_bytes, sent_ns=i * sent_every_ns, received_ns=OFFSET_NS + at)
        for i, at in enumerate(received_ns)
    ]


@st.composite
def journeys(draw):
    """Draw a train over a token bucket and an aggregating radio, to a thread that wakes up late at any packet.

    Two stamps are on time: those of the last packets of two aggregates more than half of the train apart.
    """
    packets = draw(st.integers(12, 40))
    wire_bytes = draw(st.integers(180, 1500))
    spacing_ns = draw(st.integers(100_000, 20_000_000))
    sent_every_ns = draw(st.integers(0, spacing_ns // 2))
    saved = draw(st.integers(0, packets // 8))  # packets' worth of tokens
    aggregate = draw(st.integers(1, packets // 6))
    last = packets - 1
    left = [max(i * sent_every_ns, (i - saved) * spacing_ns) for i in range(packets)]
    ended = [left[min(last, i - i % aggregate + aggregate - 1)] for i in range(packets)]
    steady = 2 * saved - 2 * saved % aggregate + aggregate - 1
    late = st.one_of(st.just(0), st.integers(0, 5 * spacing_ns))
    received = [end if i in (steady, last) else end + draw(late) for i, end in enumerate(ended)]
    for i in reversed(range(last)):
        received[i] = min(received[i : i + 2])  # one thread stamps them, in order
    return arrivals(received, sent_every_ns=sent_every_ns, wire_bytes=wire_bytes), wire_bytes / spacing_ns * 1e9


@given(journeys())
def test_late_stamps_groups_and_bursts_do_not_matter(journey):
    """When two stamps more than half of the train apart are on time, the train reads the rate of the link."""
    train, rate = journey
    measured = measure_train(train, packets=len(train))
    assert measured is not None
    assert measured.payload_bytes / measured.duration_s == pytest.approx(rate, rel=1e-3)


@given(st.lists(st.integers(-1, 3_000_000), min_size=1, max_size=40), st.integers(0, 400_000), st.integers(0, 10))
def test_a_train_is_a_part_of_what_was_sent(gaps, sent_every_ns, lost):
    """At any arrivals, bytes, packets and spans are those between two packets, or there is no train."""
    sent = arrivals([sum(gaps[:i]) for i in range(len(gaps))], sent_every_ns=sent_every_ns)
    train = measure_train(sent, packets=len(sent) + lost)
    if train is not None:
        assert lost <= 0.1 * (len(sent) + lost)
        assert 1 <= train.packets < len(sent)
        assert train.payload_bytes == train.packets * WIRE
        assert train.sent_s == pytest.approx(train.packets * sent_every_ns / 1e9)
        assert 0 < train.duration_s <= (sent[-1].received_ns - sent[0].received_ns) / 1e9


def send(receiver, number, packets, *, indices=None, quiet_s=0.0):
    for index in range(packets) if indices is None else indices:
        receiver.on_probe(
            ProbeHeader(number, index, packets, quiet_s),
            SIZE if packets > 1 else 16,
            sent_ns=index * 100_000,
            received_ns=OFFSET_NS + index * SPACING_NS,
        )


def test_a_complete_train_is_reported_once():
    """A train is available once its last packet arrives, and is taken once."""
    receiver = Receiver("base", 0.0)
    send(receiver, 5, 10)
    first, second = (receiver.look(at_s, None) for at_s in (0.1, 0.4))
    assert (len(first.delays_s), len(first.trains), first.last_probe) == (1, 1, 5)
    assert first.trains[0].payload_bytes / first.trains[0].duration_s == pytest.approx(RATE, rel=1e-6)
    assert (second.delays_s, second.trains, second.interval_s) == ((), (), pytest.approx(0.3))


@pytest.mark.parametrize(("indices", "wait_s"), [(range(5), PROMPT_S), (range(4), QUIET_S)])
def test_a_train_is_reported_as_soon_as_it_is_whole(indices, wait_s):
    """Its last packet waits for no ping, and none before it asks for a report of half a train."""
    receiver = Receiver("p", 0.0)
    send(receiver, 1, 5, indices=indices)
    assert receiver.due_s == pytest.approx(wait_s)


@pytest.mark.parametrize("lost", [{4}, {0}, {19}, {0, 19}, {7, 8}])
def test_a_tenth_may_be_lost_anywhere(lost):
    """A train counts without its first or last packet; the next probe ends it."""
    receiver = Receiver("base", 0.0)
    send(receiver, 1, 20, indices=[i for i in range(20) if i not in lost])
    send(receiver, 2, 1)
    (train,) = receiver.look(0.1, None).trains
    # A packet lost in the middle took link time, and its bytes do not count: the train reads low, never high.
    assert 0.8 * RATE < train.payload_bytes / train.duration_s < 1.001 * RATE


def test_repeated_packets_do_not_pile_up():
    """A sender that repeats one packet of a train without end takes no memory."""
    receiver = Receiver("base", 0.0)
    send(receiver, 1, 10, indices=[0] * 1000)
    assert len(receiver._arrivals) <= 10


@pytest.mark.parametrize(("quiet_s", "kept_s"), [(0.0, QUIET_S), (1.0, 1.0), (60.0, LONGEST_QUIET_S)])
def test_reports_are_as_rare_as_a_probe_asks(quiet_s, kept_s):
    """After the answer nothing is due for the time that the ping named, within bounds, nor is news looked for."""
    receiver = Receiver("base", 0.0)
    send(receiver, 1, 1, quiet_s=quiet_s)
    assert receiver.look(0.1, None)
    assert receiver.due_s == pytest.approx(0.1 + max(BUSY_S, min(quiet_s, LONGEST_QUIET_S)))
    while not receiver.look(at_s := receiver.due_s, None):
        pass
    assert at_s == pytest.approx(0.1 + kept_s)


def test_a_report_has_what_the_interface_received_since_the_last_one():
    """One that is not there yet, or is gone, has received nothing; what came meanwhile counts when it is back."""
    receiver = Receiver("base", 0.0)
    reports = [receiver.look(at_s, counted) for at_s, counted in ((0.3, (5000, 5)), (0.6, None), (0.9, (7000, 9)))]
    assert [(report.rx_bytes, report.rx_packets) for report in reports] == [(0, 0), (0, 0), (2000, 4)]


@pytest.mark.parametrize(("received", "is_told"), [(WORTH_BYTES - 1, False), (WORTH_BYTES, True)])
def test_much_traffic_is_reported_though_no_ping_has_come(received, is_told):
    """While a queue stands pings are late."""
    assert (Receiver("base", 0.0, (0, 0)).look(BUSY_S, (received, 1)) is not None) is is_told
