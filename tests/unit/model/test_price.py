"""Price of the link: every publisher computes from it what the program gave it."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.plan import TopicPlan
from arpd.model.price import Price
from arpd.model.settings import Settings
from arpd.solve.program import Program
from tests.examples import examples
from tests.unit.solve.test_program import robots

PROGRAM = Program(Settings())
PRICE = Price(share_per_weight=0.01, capacity_bytes_per_second=1e6, packet_overhead_s=1e-4)
ROW = TopicPlan(rate_hz=100.0, min_rate_hz=2.0, deadline_ns=0, depth=1, weight=2.0, wire_bytes=900.0, packets=1)


def often(few, many):
    """Draw from a few values, which coincide, or from many."""
    return st.one_of(st.sampled_from(few), many)


CAPACITIES = often([5e3, 1e4, 2e4, 4e4, 1e5], st.floats(1e3, 1e8))
SHARES = often([0.0, 0.25, 0.5, 1.0], st.integers(0, 10**6).map(lambda millionths: millionths / 1e6))
OVERHEADS = st.sampled_from([0.0, 1e-4])


def row_of(topic):
    return TopicPlan(
        rate_hz=topic.desired_rate_hz,
        min_rate_hz=topic.min_rate_hz,
        deadline_ns=0,
        depth=1,
        weight=topic.weight,
        wire_bytes=topic.wire_bytes,
        packets=topic.packets,
    )


@examples(150)
@given(robots(), CAPACITIES, SHARES, OVERHEADS)
def test_the_price_gives_everybody_the_programs_rate(topics, capacity, share, overhead):
    """Each publisher computes the rate that the program divided, between two plans nearly; and all fit the share."""
    link = PROGRAM.on_link(capacity, topics, packet_overhead_s=overhead, share=share)
    allocation, quick = PROGRAM.solve(link, 2.0**30), link.price()
    assert math.fsum(each.share for each in allocation.topics) <= share * (1 + 1e-6)
    for topic, given_ in zip(topics, allocation.topics, strict=True):
        row = row_of(topic)
        assert allocation.price.rate_hz(row) == pytest.approx(given_.rate_hz, rel=1e-9)
        assert quick.rate_hz(row) * quick.cost_s(row) == pytest.approx(given_.share, abs=2e-6)


@pytest.mark.parametrize("change", [{"weight": 0.0}, {"wire_bytes": 0.0}])
@pytest.mark.parametrize("share", [0.0, 0.1, math.inf])
def test_without_terms_the_rate_is_the_ceiling(change, share):
    """A row without weight or size has the rate that it says, also where the source grows: no price applies."""
    price, row = replace(PRICE, share_per_weight=share), replace(ROW, **change)
    assert price.rate_hz(row) == price.growing_hz(row) == ROW.rate_hz


@pytest.mark.parametrize(
    "change",
    [
        {"share_per_weight": math.inf},
        {"yielding_weight": 1.0},
        {"kept_minimum": 0.0},
        {"capacity_bytes_per_second": 2e6},
        {"packet_overhead_s": 2e-4},
    ],
)
def test_what_changes_rates_is_not_near(change):
    """A price that frees everybody, or makes floors give way, is news; one that gives the same rates is none."""
    half = replace(PRICE, share_per_weight=0.005, capacity_bytes_per_second=2e6, packet_overhead_s=5e-5)
    assert half.is_near(PRICE, tolerance=0.01)
    assert half.rate_hz(ROW) == pytest.approx(PRICE.rate_hz(ROW))
    assert not replace(PRICE, **change).is_near(PRICE, tolerance=0.01)
    assert replace(PRICE, **change).is_near(replace(PRICE, **change, loss_ratio=0.1), tolerance=0.01)


def test_a_price_that_nobody_repeats_silences_nobody():
    """A daemon may die in an outage: publishers then send at least what their DEADLINEs promise."""
    shut = replace(PRICE, share_per_weight=0.0, yielding_weight=10.0, kept_minimum=0.0)
    row = TopicPlan(
        rate_hz=20.0, min_rate_hz=1.0, deadline_ns=200_000_000, depth=5, weight=1.0, wire_bytes=1e3, packets=1
    )
    assert (shut.rate_hz(row), replace(shut, is_stale=True).rate_hz(row)) == (0.0, 5.0)
    assert replace(shut, is_stale=True).rate_hz(replace(row, deadline_ns=0)) == 1.0
