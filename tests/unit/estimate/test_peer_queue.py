"""Queue as the reports of one peer show it: exact where possible, and otherwise silent."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate.peer_queue import QueueGauge, SentPing
from arpd.estimate.receiver import PROMPT_S
from arpd.model.probing import PeerReport

RATE = 500_000.0  # bytes/s, of the link
IDLE_S = 0.004  # one way with nothing in front


class Fifo:
    """A sender, a link of `RATE`, and a peer that reports whenever a ping arrives."""

    def __init__(self, *, clock_s=0.0):
        self.gauge = QueueGauge()
        self.clock_s = clock_s  # lead of the peer's clock
        self.now_s = 100.0
        self.queue = 0.0  # bytes that stand before the link
        self._handed = 7_000_000.0  # as the interface counts
        self._received, self._reported = 0.0, 0  # by the link; in reports
        self._reported_s = self.now_s
        self._sent = self._last = 0  # numbers of probes
        self._waiting = []  # pings: number, when sent, bytes in front

    def ping(self):
        self._sent += 1
        self.gauge.note_sent(SentPing(number=self._sent, sent_s=self.now_s, handed_bytes=self._handed))
        self._waiting.append((self._sent, self.now_s, self.queue))

    def send(self, size):
        self._handed += size
        self.queue += size

    def lose(self, size):
        self._handed += size

    def run(self, duration_s):
        """Let the link carry bytes, with a report for every ping that arrives."""
        end_s = self.now_s + duration_s
        while self._waiting and (at_s := self.now_s + self._waiting[0][2] / RATE) <= end_s:
            self._carry(at_s)
            number, sent_s, _ = self._waiting.pop(0)
            self._last = number
            self.report(at_s - sent_s + IDLE_S + self.clock_s)
        self._carry(end_s)

    def report(self, *delays_s):
        received = round(self._received) - self._reported
        self._reported += received
        interval_s, self._reported_s = max(1e-6, self.now_s - self._reported_s), self.now_s
        self.gauge.digest(
            PeerReport(
                peer="p",
                received_at_s=self.now_s,
                interval_s=interval_s,
                rx_bytes=received,
                rx_packets=round(received / 1000),
                delays_s=delays_s,
                last_probe=self._last,
            ),
            handed_bytes=self._handed,
        )

    def cycle(self, size=0.0, duration_s=0.1):
        """Send a ping, and then data."""
        self.ping()
        self.send(size)
        self.run(duration_s)

    def wait(self, duration_s, size=0.0):
        """Send data and report what arrives; no ping leaves."""
        self.send(size)
        self.run(duration_s)
        self.report()

    def _carry(self, until_s):
        carried = min(self.queue, RATE * (until_s - self.now_s))
        self.queue -= carried
        self._received += carried
        self._waiting = [(number, at_s, in_front - carried) for number, at_s, in_front in self._waiting]
        self.now_s = until_s


LOADS = st.lists(st.floats(0.0, 2.5 * RATE * 0.1), min_size=1, max_size=40)
CLOCKS = st.sampled_from([0.0, -3.0e9, 17.5])


@given(st.lists(st.floats(0.0, 0.3), min_size=3, max_size=30), st.floats(0.0, 3.0))
def test_an_overdue_ping_waits_behind_a_queue_of_that_length(waits_s, standing_s):
    """A ping on its way for longer than the least round trip shows at once a queue as long as the excess."""
    fifo = Fifo()
    for wait_s in waits_s:
        fifo.send(wait_s * RATE)
        fifo.cycle(duration_s=wait_s + 0.01)

    def queue_s():
        return fifo.gauge.queue_s(fifo.now_s, handed_bytes=None, capacity=RATE)

    fifo.send(standing_s * RATE)
    fifo.ping()
    before_s = fifo.gauge.delay_s
    for _ in range(10):
        fifo.wait(0.099 * standing_s)
        assert 0.0 <= queue_s() <= max(before_s, standing_s)
    assert queue_s() >= 0.98 * standing_s - min(waits_s) - PROMPT_S


def test_a_ping_that_waited_out_an_outage_shows_all_of_the_wait():
    """While no ping arrives, the least delay does not grow old."""
    fifo = Fifo(clock_s=17.5)
    fifo.cycle()
    fifo.send(20.0 * RATE)
    fifo.cycle(duration_s=20.1)
    assert fifo.gauge.delay_s == pytest.approx(20.0, abs=1e-3)


@given(LOADS, CLOCKS, st.lists(st.floats(1e3, 0.5 * RATE * 0.1), min_size=4, max_size=10))
def test_bytes_tell_the_queue_before_a_ping_can(loads, clock_s, growth):
    """Bytes that were handed over and did not arrive are exactly the queue, while pings wait in it."""
    fifo = Fifo(clock_s=clock_s)
    fifo.cycle()
    for load in loads:
        fifo.cycle(load)
    for load in growth:
        fifo.wait(0.1, RATE * 0.1 + load)
    # Bytes that were on the way at the last good ping are no queue.
    backlog_s = fifo.gauge.backlog.delay_s(fifo.now_s, burst_bytes=0.0, capacity=RATE)
    assert backlog_s == pytest.approx(fifo.queue / RATE, abs=1e-3 + max(loads) / RATE)


@given(st.lists(st.floats(0.0, 0.3), min_size=5, max_size=40))
def test_a_link_that_was_never_idle_shows_its_exact_capacity(loads_s):
    """Bytes that waited before a report and did not all arrive in it prove that the link was busy."""
    fifo = Fifo()
    fifo.cycle()
    for load_s in loads_s:
        fifo.wait(0.1, load_s * RATE)
        assert fifo.gauge.backlog.busy_rate in (None, pytest.approx(RATE, rel=1e-3))
    fifo.wait(0.1, 0.3 * RATE)
    fifo.wait(0.1)
    assert fifo.gauge.backlog.busy_rate == pytest.approx(RATE, rel=1e-3)


def test_bytes_that_go_elsewhere_make_no_link_busy():
    """At rest a missing packet outweighs what arrives; a ping that met no queue shows that the link was idle."""
    fifo = Fifo()
    for round_ in range(20):
        fifo.ping()
        fifo.send(100)
        fifo.lose(900 * (round_ % 6 == 5))
        fifo.run(0.3)
        assert fifo.gauge.backlog.busy_rate is None


def test_bytes_without_their_ping_are_a_queue_at_once():
    """What waits at one report may be a burst, unless the report came because no ping arrived in time."""
    fifo = Fifo()
    for _ in range(12):
        fifo.cycle(1000)
    fifo.wait(0.1, size=200_000)
    assert fifo.gauge.backlog.delay_s(fifo.now_s, burst_bytes=15_000, capacity=RATE) > 0.25
