"""Probes: pings always, trains when savings pay for them, and how many packets never arrive."""

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate import probes
from arpd.estimate.probes import ProbeLoss, ProbeSchedule
from arpd.estimate.receiver import Receiver
from arpd.model.probing import ProbeHeader, ProbeRequest
from arpd.model.wire import probe_wire_bytes
from tests.examples import examples

MBIT = 125_000.0  # bytes/s
CALM = {
    "is_measured": True,
    "is_out": False,
    "is_free": True,
    "is_urgent": False,
    "needs_pair": False,
    "copies": 1,
    "is_short": False,
}
CAPACITIES = st.floats(0.2 * MBIT, 200 * MBIT)


class Probing:
    """A schedule that ticks, and the times and probes it sent."""

    def __init__(self, capacity=20 * MBIT, *, tick_s=0.1, **options):
        self.schedule = ProbeSchedule()
        self.now_s = 800.0
        self.tick_s = tick_s
        self.options = CALM | {"capacity": capacity} | options
        self.sent = []

    def run(self, duration_s, **changes):
        """Return the probes sent meanwhile; ``changes`` stay."""
        self.options |= changes
        before = len(self.sent)
        for _ in range(round(duration_s / self.tick_s)):
            self.now_s += self.tick_s
            self.sent += [(self.now_s, request) for request in self.schedule.wanted(self.now_s, **self.options)]
        return self.sent[before:]

    def known(self):
        """Pass the first trains."""
        self.run(4 * probes.FIRST_S, is_measured=False)
        self.options["is_measured"] = True
        return self


def cost(sent, *, copies=1):
    """Return the link bytes of probes and of the reports that answer pings."""
    return copies * sum(
        request.packets * probe_wire_bytes(request.packet_bytes) + (request.packets == 1) * probes.REPORT_BYTES
        for _, request in sent
    )


def allowed(capacity, *, copies=1):
    """Return the share of a capacity, or the cost of the rarest pings and trains if that is more (bytes/s)."""
    pings = (probe_wire_bytes(probes.PING_BYTES) + probes.REPORT_BYTES) / probes.PING_MOST_S
    trains = probes.TRAIN_LEAST_PACKETS * probe_wire_bytes(probes.PACKET_BYTES) / probes.TRAIN_MOST_S
    return max(probes.SHARE * capacity, copies * (pings + trains) + 0.1 * probes.SHARE * capacity)


@examples(60)
@given(CAPACITIES, st.integers(1, 4), st.floats(0.05, 0.4), st.booleans())
def test_a_minute_costs_its_share(capacity, copies, tick_s, is_urgent):
    """Pings, trains and reports to all peers stay within the share, on any link and at any doubt."""
    probing = Probing(capacity, tick_s=tick_s, copies=copies).known()
    sent = probing.run(60.0, is_urgent=is_urgent)
    # Earlier savings pay for two more trains; trains of small packets cost a little.
    largest = max(cost([each], copies=copies) for each in sent)
    assert cost(sent, copies=copies) <= 1.02 * 60.0 * allowed(capacity, copies=copies) + 2 * largest


@examples(20)
@given(CAPACITIES, st.floats(1.0, 8.0))
def test_savings_are_bounded(capacity, urgent_s):
    """After ten calm minutes urgent trains may spend only a few seconds' budget, or a few trains."""
    probing = Probing(capacity, tick_s=0.4).known()
    probing.run(600.0)
    probing.tick_s = 0.1
    sent = probing.run(urgent_s, is_urgent=True)
    largest = max(cost([each]) for each in sent)
    assert cost(sent) <= allowed(capacity) * (urgent_s + probes.SAVED_S) + 4 * largest


@pytest.mark.parametrize(("mbit", "pause_s"), [(1.0, 8.0), (2.0, 3.0), (4.0, 1.0), (20.0, 1.0), (200.0, 1.0)])
def test_a_better_link_is_found_within_seconds_where_more_is_asked_of_it(mbit, pause_s):
    """While topics ask for more than is believed, a train leaves each second, on a slow link less often."""
    probing = Probing(mbit * MBIT).known()
    sent = probing.run(60.0, is_short=True)
    times = [at_s for at_s, request in sent if request.packets > 1 and request.packet_bytes == probes.PACKET_BYTES]
    assert max(after - before for before, after in pairwise(times)) <= pause_s + 0.5


@pytest.mark.parametrize("mbit", [0.2, 0.8, 3.0])
@pytest.mark.parametrize("copies", [1, 4])
def test_even_the_slowest_link_is_looked_at_now_and_then(mbit, copies):
    """A train leaves at least every 15 s at any cost, because only it shows a better link."""
    sent = Probing(mbit * MBIT, copies=copies).known().run(60.0)
    times = [at_s for at_s, request in sent if request.packets > 1]
    assert len(times) >= 60.0 // probes.TRAIN_MOST_S
    assert max(after - before for before, after in pairwise(times)) <= probes.TRAIN_MOST_S + 0.5


# -- loss


def lost_of(course, *, counted, peers):
    """Return the loss after probes of so many packets, some lost, to peers that counted those of earlier daemons."""
    loss, receivers = ProbeLoss(), [Receiver(f"peer {i}", 0.0) for i in range(peers)]
    for receiver in receivers:
        receiver._received = counted
    for number, (packets, lost) in enumerate(course, 1):
        loss.note_sent(ProbeRequest(packets=packets, packet_bytes=16, number=number))
        for receiver in receivers:
            for index in range(packets - lost):
                receiver.on_probe(ProbeHeader(number, index, packets), 16, sent_ns=0, received_ns=0)
            if report := receiver.look(number * 0.1, None):
                loss.digest(replace(report, probe_packets=report.probe_packets % 2**32))
    return loss.ratio(len(course) * 0.1)


@given(
    course=st.lists(st.integers(1, 24).flatmap(lambda p: st.tuples(st.just(p), st.integers(0, p))), max_size=100),
    counted=st.sampled_from([0, 17, 2**32 - 30]),
    peers=st.integers(1, 3),
)
def test_what_is_lost_is_counted_to_the_packet(course, counted, peers):
    """The ratio is exact over the probes between the first and the last that arrived; counts may wrap."""
    course = [(1, 0), *course, (1, 0)]  # a ping before and after: the second settles everything
    ratio = lost_of(course, counted=counted, peers=peers)
    sent, lost = (sum(column) for column in zip(*course[:-1], strict=True))
    if sent * peers < 20:
        assert ratio is None
    else:
        assert ratio == pytest.approx(lost / sent)
