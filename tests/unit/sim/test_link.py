"""The link in virtual time: rate, overhead, loss, hidden queue, and conservation of packets."""

from itertools import pairwise
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.sim.link import FRAME_BYTES, LinkModel, SimulatedLink
from arpd.sim.schedule import LossStep, RateSchedule, RateStep, Service, outages
from arpd.sim.timeline import Timeline
from tests.examples import examples


def schedule_of(*steps):
    return RateSchedule(steps=tuple(RateStep(start_s=s, rate_bytes_per_second=r) for s, r in steps))


def carried(schedule, from_s, until_s):
    """Return the bytes that the schedule allows between two moments of run time, by plain summation."""
    edges = sorted({from_s, until_s, *(s.start_s for s in schedule.steps if from_s < s.start_s < until_s)})
    return sum((end - start) * schedule.rate_at(max(0.0, start)) for start, end in pairwise(edges))


def link_of(schedule, model, seed=1):
    """Return a link, and its time."""
    timeline = Timeline(0.0)
    return SimulatedLink(timeline, schedule, model=model, random=Random(seed)), timeline


def nothing():
    """Receive a datagram."""


rates = st.one_of(st.just(0.0), st.floats(1e4, 1e7))
schedules = st.tuples(
    st.floats(1e4, 1e7), st.lists(st.tuples(st.floats(0.01, 1.0), rates), max_size=4), st.floats(1e4, 1e7)
).map(
    lambda t: schedule_of(
        (0.0, t[0]),
        *((sum(gap for gap, _ in t[1][: i + 1]), rate) for i, (_, rate) in enumerate(t[1])),
        (sum(gap for gap, _ in t[1]) + 0.5, t[2]),
    )
)
MODEL = {
    "delay_s": st.floats(0.0, 0.05),
    "queue_bytes": st.integers(0, 100_000),
    "packet_overhead_s": st.sampled_from([0.0, 0.0001, 0.003]),
    "aggregate_packets": st.sampled_from([1, 4, 64]),
    "firmware_bytes": st.sampled_from([0, 5_000, 60_000]),
}
models = st.builds(
    LinkModel,
    loss=st.sampled_from([0.0, 0.2]),
    losses=st.sampled_from(
        [(), outages((0.2, 0.5)), (LossStep(start_s=0.3, loss=0.5), LossStep(start_s=0.6, loss=0.0))]
    ),
    **MODEL,
)
sends = st.lists(st.tuples(st.floats(0.0, 0.05), st.integers(60, FRAME_BYTES), st.integers(1, 20)), max_size=40)


# -- on any link


@examples(150)
@given(schedules, models, sends, st.integers(0, 5))
def test_packets_are_conserved_and_queues_are_bounded(schedule, model, offered, seed):
    """Every packet is dropped, lost or received; counters never fall, and the host's queue keeps within its size."""
    link, timeline = link_of(schedule, model, seed)
    before = 0.0, 0.0
    for gap_s, packet_bytes, packets in offered:
        timeline.run_until(timeline.now_s + gap_s)
        link.send(packet_bytes * packets, packets, nothing)
        assert link.backlog_bytes <= model.queue_bytes + FRAME_BYTES + 1e-3
        counters = link.sent_bytes, link.received_bytes()
        assert all(now >= then - 1e-3 for now, then in zip(counters, before, strict=True))
        assert link.received_bytes() <= link.sent_bytes + 1e-3
        before = counters
    timeline.run_until(timeline.now_s + 60.0)
    assert link.sent_packets + link.dropped_packets == sum(packets for _, _, packets in offered)
    assert link.sent_packets == link.received_packets + link.lost_packets
    assert link.lost_packets or link.received_bytes() == pytest.approx(link.sent_bytes, abs=1e-3)
    assert link.backlog_bytes == pytest.approx(0.0, abs=1e-3)
    assert link.queue_delay_s == pytest.approx(0.0, abs=1e-6)


# -- rate


@examples(60)
@given(schedules, st.lists(st.floats(0.0, 6.0), min_size=1, max_size=20))
def test_service_is_the_integral_of_the_rate_and_its_inverse(schedule, moments):
    """`by` is the integral of the rate and `when` its first inverse, in any order of questions."""
    service = Service(schedule)
    for t_s in moments:
        size = service.by(t_s)
        assert size == pytest.approx(carried(schedule, 0.0, t_s), abs=1e-3)
        first_s = service.when(size + 1.0)
        assert carried(schedule, t_s, first_s) == pytest.approx(1.0, abs=1e-2)


# -- overhead, aggregates, firmware


@pytest.mark.parametrize("model", [{}, {"packet_overhead_s": 0.01, "aggregate_packets": 4}])
def test_firmware_hides_what_it_holds(model):
    """The host counts bytes in the firmware as sent and sees no backlog, but packets wait for them."""
    link, _ = link_of(schedule_of((0.0, 1000.0)), LinkModel(firmware_bytes=5000, queue_bytes=3000, **model))
    for _ in range(5):
        link.send(1000, 1, nothing)
    assert (link.backlog_bytes, link.sent_bytes) == (0.0, 5000.0)
    assert link.queue_delay_s >= 5.0
    link.send(1000, 1, nothing)
    assert (link.backlog_bytes, link.sent_bytes) == (1000.0, 5000.0)
    for _ in range(9):
        link.send(1000, 1, nothing)
    assert (link.dropped_packets, link.backlog_bytes) == (6, 4000.0)
