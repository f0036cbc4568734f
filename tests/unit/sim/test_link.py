"""The link in virtual time: on any link packets are conserved, and queues bounded."""

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.sim.link import FRAME_BYTES, LinkModel, SimulatedLink
from arpd.sim.schedule import LossStep, RateSchedule, RateStep, outages
from arpd.sim.timeline import Timeline
from tests.examples import examples


def schedule_of(*steps):
    return RateSchedule(steps=tuple(RateStep(start_s=s, rate_bytes_per_second=r) for s, r in steps))


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
