"""Queue as the reports of one peer show it: exact where possible, and otherwise silent."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.estimate import parameters
from arpd.estimate.peer_queue import PeerGauges, QueueGauge, SentPing
from arpd.model.probing import PeerReport

RATE = 500_000.0  # bytes/s, of the link
IDLE_S = 0.004  # one way with nothing in front


class Fifo:
    """A sender, a link of `RATE`, and a peer that reports whenever a ping arrives."""

    def __init__(self, *, clock_s=0.0, is_counted=True):
        self.gauge = QueueGauge()
        self.clock_s = clock_s  # lead of the peer's clock
        self.now_s = 100.0
        self.queue = 0.0  # bytes that stand before the link
        self._is_counted = is_counted
        self._handed = 7_000_000.0  # as the interface counts
        self._received, self._reported = 0.0, 0  # by the link; in reports
        self._reported_s = self.now_s
        self._sent = self._last = 0  # numbers of probes
        self._waiting = []  # pings: number, when sent, bytes in front

    def ping(self):
        self._sent += 1
        self.gauge.note_sent(SentPing(number=self._sent, sent_s=self.now_s, handed_bytes=self._known()))
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
            handed_bytes=self._known(),
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

    def backlog_s(self, burst_bytes=0.0, capacity=RATE):
        return self.gauge.backlog.delay_s(self.now_s, burst_bytes=burst_bytes, capacity=capacity)

    def projected_s(self):
        return self.gauge.projected_s(self.now_s, handed_bytes=self._known(), capacity=RATE)

    def _carry(self, until_s):
        carried = min(self.queue, RATE * (until_s - self.now_s))
        self.queue -= carried
        self._received += carried
        self._waiting = [(number, at_s, in_front - carried) for number, at_s, in_front in self._waiting]
        self.now_s = until_s

    def _known(self):
        return self._handed if self._is_counted else None


LOADS = st.lists(st.floats(0.0, 2.5 * RATE * 0.1), min_size=1, max_size=40)
CLOCKS = st.sampled_from([0.0, -3.0e9, 17.5])


# -- delay and overdue


@settings(deadline=None)
@given(LOADS, CLOCKS)
def test_a_ping_tells_how_long_it_waited(loads, clock_s):
    """At any clock offset, the delay above that of an empty queue is the time of the bytes in front."""
    fifo = Fifo(clock_s=clock_s)
    fifo.cycle()
    for load in loads:
        fifo.send(load)
        in_front = fifo.queue
        fifo.cycle(duration_s=in_front / RATE + 0.01)
        assert fifo.gauge.delay_s == pytest.approx(in_front / RATE, abs=1e-5)


@pytest.mark.parametrize("step_s", [-1e6, -0.3, 0.3, 1e6])
def test_a_step_of_the_peers_clock_is_at_most_the_round_trip(step_s):
    """The round trip by our clock bounds what a step adds to a delay."""
    fifo = Fifo()
    for _ in range(20):
        fifo.cycle(0.02 * RATE)
    fifo.clock_s = step_s
    for _ in range(20):
        fifo.cycle(0.02 * RATE)
        assert 0.0 <= fifo.gauge.delay_s <= 0.02


@settings(deadline=None)
@given(st.lists(st.floats(0.0, 0.3), min_size=3, max_size=30), st.floats(0.0, 3.0))
def test_an_overdue_ping_waits_behind_a_queue_of_that_length(waits_s, standing_s):
    """A ping on its way for longer than usual shows at once a queue at least as long as the excess."""
    fifo = Fifo()
    for wait_s in waits_s:
        fifo.send(wait_s * RATE)
        fifo.cycle(duration_s=wait_s + 0.01)
    assert fifo.gauge.overdue_s(fifo.now_s) == 0.0
    fifo.send(standing_s * RATE)
    fifo.ping()
    for _ in range(10):
        fifo.wait(0.099 * standing_s)
        assert 0.0 <= fifo.gauge.overdue_s(fifo.now_s) <= standing_s
    usual_s = sorted(waits_s)[len(waits_s) // 2]
    assert fifo.gauge.overdue_s(fifo.now_s) >= 0.98 * standing_s - usual_s - 1e-6
    fifo.wait(0.02 * standing_s + 0.01)
    assert fifo.gauge.overdue_s(fifo.now_s) == 0.0


def test_a_ping_is_overdue_only_after_a_first_one():
    """Before the first round trip nothing is usual."""
    fifo = Fifo()
    fifo.ping()
    assert fifo.gauge.overdue_s(fifo.now_s + 5.0) == 0.0


# -- projected


@pytest.mark.parametrize("is_busy", [False, True])
@settings(deadline=None)
@given(st.lists(st.floats(0.0, 0.15), min_size=3, max_size=30), CLOCKS, st.floats(0.0, 1.0))
def test_the_queue_that_a_ping_met_is_projected_to_now(is_busy, loads_s, clock_s, later_s):
    """What the last ping met, what came since, less the time since: exact on a busy link, and never too long."""
    fifo = Fifo(clock_s=clock_s)
    fifo.cycle()
    for load_s in loads_s:
        fifo.cycle((load_s + 0.1 * is_busy) * RATE)
        true_s = fifo.queue / RATE
        assert true_s - (1e-5 if is_busy else true_s) <= fifo.projected_s() <= true_s + 1e-5
    fifo.now_s += later_s
    assert fifo.projected_s() <= max(0.0, true_s - later_s) + 1e-5


# -- bytes


@settings(deadline=None)
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
    assert fifo.backlog_s() == pytest.approx(fifo.queue / RATE, abs=1e-3 + max(loads) / RATE)


@settings(deadline=None)
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
    fifo.gauge = QueueGauge(fifo.gauge)
    assert fifo.gauge.backlog.busy_rate is None


def test_bytes_that_arrived_before_a_held_report_do_not_wait():
    """A report that waited after its ping has bytes of later messages, so a link that is idle then is not slow."""
    gauge, handed, late = QueueGauge(), 0, 0
    # Samples leave and arrive after a report; one leaves after a ping and arrives while its report is held for 20 ms.
    rounds = [*[(0.1, 0, 30_000)] * 5, (0.1, 0, 0), (0.02, 30_000, 0), (0.1, 0, 0)]
    for number, (interval_s, early, next_late) in enumerate(rounds, 1):
        gauge.note_sent(SentPing(number=number, sent_s=0.1 * number, handed_bytes=handed))
        report = steadily((100 + early + late) / interval_s, 0.1 * number + 0.01, interval_s)
        late, handed = next_late, handed + early
        gauge.digest(replace(report, delays_s=(0.004,), last_probe=number), handed_bytes=handed)
        assert gauge.backlog.busy_rate is None
        handed += late


def test_a_short_interval_shows_no_capacity():
    """The bytes handed over are read after the report left, and a message may have come in between."""
    fifo = Fifo()
    fifo.cycle()
    for _ in range(3):
        fifo.wait(0.1, 0.2 * RATE)
        assert fifo.gauge.backlog.busy_rate is None or fifo.gauge.backlog.busy_rate == pytest.approx(RATE)
        fifo.wait(0.02)
        assert fifo.gauge.backlog.busy_rate is None


def test_lost_bytes_raise_an_alarm_until_the_next_ping():
    """Lost bytes look like a queue until the next ping arrives."""
    fifo = Fifo()
    for _ in range(5):
        fifo.cycle(0.5 * RATE * 0.1)
    fifo.lose(100_000)
    for _ in range(4):
        fifo.wait(0.1, 0.5 * RATE * 0.1)
    assert fifo.backlog_s() > 100_000 / RATE
    fifo.cycle()
    assert fifo.backlog_s() == 0.0
    assert fifo.gauge.delay_s == pytest.approx(0.0, abs=1e-5)


@settings(deadline=None)
@given(LOADS)
def test_without_counters_only_pings_speak(loads):
    """Without counters of the interface the delay counts, and bytes can neither have come nor have left."""
    fifo = Fifo(is_counted=False)
    fifo.cycle()
    for load in loads:
        fifo.cycle(load)
        fifo.report()
        assert (fifo.backlog_s(), fifo.gauge.backlog.busy_rate) == (0.0, None)
    fifo.send(0.2 * RATE)
    in_front = fifo.queue
    fifo.cycle(duration_s=in_front / RATE + 0.01)
    assert fifo.projected_s() == fifo.gauge.delay_s == pytest.approx(in_front / RATE, abs=1e-5)


def test_after_forget_measuring_starts_again():
    """Without measurements there is no queue, no backlog and no delivery, and the next ping has the least delay."""
    fifo = Fifo()
    for _ in range(10):
        fifo.cycle(1.5 * RATE * 0.1)
    fifo.gauge = QueueGauge(fifo.gauge)
    assert fifo.gauge.delay_s == fifo.backlog_s() == fifo.gauge.overdue_s(fifo.now_s) == 0.0
    assert fifo.gauge.delivery(-math.inf) == (0.0, 0.0)
    for _ in range(4):
        fifo.wait(0.2)
    fifo.cycle()
    assert fifo.gauge.delay_s == 0.0


# -- delivery


def steadily(rate, now_s, interval_s):
    return PeerReport(
        peer="p",
        received_at_s=now_s,
        interval_s=interval_s,
        rx_bytes=rate * interval_s,
        rx_packets=rate * interval_s / 1000,
    )


def fed(rates, *, interval_s=0.1):
    """Return a gauge after one report per rate, the last one at the time 0."""
    gauge = QueueGauge()
    for place, rate in enumerate(rates, 1):
        gauge.digest(steadily(rate, (place - len(rates)) * interval_s, interval_s), handed_bytes=None)
    return gauge


@given(st.floats(0.02, 0.25), st.integers(1, 30), st.floats(1e3, 1e8))
def test_delivery_is_bytes_over_the_time_they_took(interval_s, reports, rate):
    """At a steady rate, intervals of any length show that rate."""
    delivery = fed([rate] * reports, interval_s=interval_s).delivery(-math.inf)
    assert delivery == (pytest.approx(rate), pytest.approx(rate / 1000))


def test_delivery_follows_within_its_window():
    """One window after a change the old rate does not count, after a pause at once, and never before a moment."""
    steps = round(parameters.DELIVERY_WINDOW_S / 0.1) + 1
    gauge = fed([4e5] * 10 + [1e5] * (steps - 1) + [3e5])
    assert gauge.delivery(-math.inf)[0] < 3e5
    assert gauge.delivery(-0.15)[0] == pytest.approx(3e5)
    assert gauge.delivery(-0.05) == (0.0, 0.0)
    gauge.digest(steadily(1e3, 20.0, 20.0), handed_bytes=None)
    assert gauge.delivery(-math.inf)[0] == pytest.approx(1e3)


@pytest.mark.parametrize("elsewhere", [0.5, 0.95])
def test_what_goes_elsewhere_is_no_queue(elsewhere):
    """When bytes go to another host than the peer, the queue is unknown."""
    fifo = Fifo()
    for _ in range(20):
        fifo.ping()
        fifo.run(0.05)
        fifo.send((1.0 - elsewhere) * 0.3 * RATE * 0.1)
        fifo.lose(elsewhere * 0.3 * RATE * 0.1 + 20_000)
        fifo.run(0.05)
        fifo.report()
    assert fifo.backlog_s() == 0.0


# -- the way back


def answer(gauge, number, *, way_back_s, clock_s):
    """Send a ping every 100 ms, and return the delay that its report shows."""
    sent_s = 0.1 * number
    gauge.note_sent(SentPing(number=number, sent_s=sent_s, handed_bytes=None))
    gauge.digest(
        replace(
            steadily(1e5, sent_s + 0.01 + way_back_s, 0.1),
            delays_s=(0.01 - clock_s,),
            last_probe=number,
            return_delay_s=way_back_s + clock_s,
        ),
        handed_bytes=None,
    )
    return gauge.return_delay_s


@given(ways_back_s=st.lists(st.floats(0.001, 0.05), min_size=1, max_size=90), clock_s=CLOCKS)
def test_the_way_back_is_measured_above_its_least(ways_back_s, clock_s):
    """A queue on the way back shows at any clock offset, and shows none on the way there."""
    gauge = QueueGauge()
    for number, way_back_s in enumerate(ways_back_s, 1):
        excess_s = answer(gauge, number, way_back_s=way_back_s, clock_s=clock_s)
    assert excess_s == pytest.approx(ways_back_s[-1] - min(ways_back_s), abs=2e-6)
    assert gauge.delay_s == pytest.approx(0.0, abs=2e-6)


def test_without_a_return_delay_the_way_back_is_unknown():
    """The way back is unknown before a report with a return delay, and after measurements are forgotten."""
    gauge = QueueGauge()
    gauge.digest(steadily(1e5, 1.0, 0.1), handed_bytes=None)
    assert gauge.return_delay_s is None
    assert answer(gauge, 20, way_back_s=0.004, clock_s=0.0) == 0.0
    gauge = QueueGauge(gauge)
    assert gauge.return_delay_s is None


@pytest.mark.parametrize(("waited_s", "after_s", "counts"), [(2.0, 0.2, False), (0.1, 0.2, True), (2.0, 5.0, True)])
def test_a_report_that_waited_out_an_outage_delivers_nothing(waited_s, after_s, counts):
    """Its bytes belong to the link before; much later such a delay may come from a clock that was set."""
    gauge = QueueGauge()

    def report(number, now_s, return_delay_s):
        gauge.note_sent(SentPing(number=number, sent_s=now_s - 0.01, handed_bytes=None))
        sent = replace(steadily(1e5, now_s, 0.1), delays_s=(0.005,), last_probe=number, return_delay_s=return_delay_s)
        gauge.digest(sent, handed_bytes=None)

    report(1, 100.0, 7.0)
    gauge = QueueGauge(gauge)
    report(2, 110.0, 7.0)
    report(3, 110.0 + after_s, 7.0 + waited_s)
    assert (gauge.delivery(110.05)[0] > 0) is counts


# -- several peers


def test_a_peer_that_died_has_no_queue():
    """While another peer answers, overdue pings of a silent one are no queue; when all are silent, they are."""
    gauges = PeerGauges()
    longest_s: dict[str, float] = {}
    for tick in range(1, 31):
        now_s, heard = 0.1 * tick, "ab" if tick <= 10 else "a" if tick <= 20 else ""
        gauges.note_sent(SentPing(number=tick, sent_s=now_s - 0.01, handed_bytes=None))
        for peer in heard:
            report = replace(steadily(1e5, now_s, 0.1), peer=peer, delays_s=(0.005,), last_probe=tick)
            gauges.digest(report, handed_bytes=None)
        # Until it has been silent for a while, nobody knows.
        if tick not in range(11, 15):
            delay_s = gauges.delay_s(now_s, handed_bytes=None, capacity=RATE)
            longest_s[heard] = max(delay_s, longest_s.get(heard, 0.0))
    assert longest_s["ab"] == longest_s["a"] == 0.0
    assert longest_s[""] > 0.8
