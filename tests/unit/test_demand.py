"""What one topic asks for, reconciled: no wish survives that the link or the source makes pointless."""

from dataclasses import replace
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.demand import give_up, refuse_nonsense, row
from arpd.model import Binding, Topic

TOPIC = Topic(name="/t", wire_bytes=1000.0, packets=1, desired_rate_hz=100.0, min_rate_hz=2.0)
CAPACITY = Fraction(100_000)
SIZES = st.floats(1.0, 1e6)
RATES = st.floats(0.0, 1e4)


def make(topic, capacity=CAPACITY, overhead=0, reserve=1):
    return row(topic, capacity=capacity, packet_overhead=Fraction(overhead), depth_reserve=Fraction(reserve))


@settings(deadline=None)
@given(SIZES, RATES, RATES)
def test_floor_ceiling_and_link_are_in_order(wire_bytes, desired_hz, min_hz):
    """The floor is at most the ceiling, and the ceiling at most what the link carries, unless the floor is more."""
    made = make(replace(TOPIC, wire_bytes=wire_bytes, desired_rate_hz=desired_hz, min_rate_hz=min_hz))
    assert made.ceiling is not None
    assert 0 <= made.floor <= made.ceiling
    assert made.ceiling <= max(made.floor, 1 / made.cost)


@settings(deadline=None)
@given(SIZES, RATES, st.floats(0.0, 0.1))
def test_cost_is_packets_and_bytes(wire_bytes, desired_hz, overhead_s):
    """Link time per message is k·t_ovh + s/C, so Rmax falls when a packet costs more."""
    topic = replace(TOPIC, wire_bytes=wire_bytes, desired_rate_hz=desired_hz, packets=3)
    made, free = make(topic, overhead=Fraction(overhead_s)), make(topic)
    assert made.cost - free.cost == 3 * Fraction(overhead_s)
    assert made.max_rate_hz <= free.max_rate_hz


@settings(deadline=None)
@given(st.fractions(0, 1000), st.fractions(0, 1000))
def test_depth_cap_is_monotone_in_the_rate_and_within_bounds(one, other):
    """A faster topic never gets less history, and the cap stays within Dmin..Dmax."""
    made = make(replace(TOPIC, min_depth=2, max_depth=50, latency_budget_s=0.5))
    slow, fast = sorted((one, other))
    assert 2 <= made.depth_cap(slow) <= made.depth_cap(fast) <= 50


def test_a_desired_rate_without_bound_means_what_the_link_carries():
    """No wish means Rmax; without a cost on the link there is no bound at all."""
    assert make(replace(TOPIC, desired_rate_hz=float("inf"))).ceiling == 100
    assert make(replace(TOPIC, desired_rate_hz=float("inf"), wire_bytes=0.0)).ceiling is None


def test_an_unmeasured_source_gets_its_floor():
    """A desired rate of 0 says that nothing was measured yet."""
    assert make(replace(TOPIC, desired_rate_hz=0.0)).ceiling == 2


def test_a_floor_above_the_source_is_lowered():
    """A deadline shorter than the source's own period would be missed for ever."""
    assert make(replace(TOPIC, desired_rate_hz=1.0, min_rate_hz=5.0)).floor == 1


@pytest.mark.parametrize(
    ("topic", "rate_hz", "binding"),
    [
        (replace(TOPIC, latency_budget_s=0.1), 50, Binding.LATENCY_BUDGET),
        (replace(TOPIC, latency_budget_s=None), 50, Binding.LINK),
        (replace(TOPIC, max_depth=3, latency_budget_s=None), 500, Binding.MAX_DEPTH),
        (replace(TOPIC, min_depth=40, latency_budget_s=0.1), 50, Binding.FLOOR),
    ],
)
def test_the_depth_says_what_holds_it(topic, rate_hz, binding):
    """The binding names the constraint an operator would have to relax."""
    assert make(topic).depth_binding(Fraction(rate_hz)) is binding


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"wire_bytes": float("nan")}, "wire_bytes"),
        ({"wire_bytes": -1.0}, "wire_bytes"),
        ({"min_rate_hz": float("inf")}, "min_rate_hz"),
        ({"desired_rate_hz": float("nan")}, "desired_rate_hz"),
        ({"weight": 0.0}, "weight"),
        ({"latency_budget_s": -1.0}, "latency_budget_s"),
        ({"min_depth": 9, "max_depth": 3}, "depths 9..3"),
    ],
)
def test_nonsense_is_refused_by_name(change, field):
    """The message names topic and field."""
    with pytest.raises(ValueError, match=f"/t: {field}"):
        refuse_nonsense(replace(TOPIC, **change))


AMOUNTS = st.lists(st.tuples(st.fractions(0, 100), st.sampled_from([0.5, 1.0, 2.0, 8.0])), min_size=1, max_size=10)


@settings(deadline=None)
@given(AMOUNTS, st.fractions(0, 500))
def test_giving_up_takes_exactly_the_deficit_from_the_lightest_first(rows, deficit):
    """The cut is the deficit or everything; a class is touched only when every lighter one is at nothing."""
    amounts, weights = [amount for amount, _ in rows], [weight for _, weight in rows]
    kept, cuts = give_up(amounts, weights, deficit)
    taken = sum((a * (1 - k) for a, k in zip(amounts, kept, strict=True)), Fraction(0))
    assert taken == min(sum(amounts, Fraction(0)), deficit)
    assert all(0 <= part <= 1 for part in kept)
    for weight, part in cuts.items():
        assert part < 1
        lighter = [k for a, w, k in zip(amounts, weights, kept, strict=True) if w < weight and a > 0]
        assert all(part == 0 for part in lighter)
