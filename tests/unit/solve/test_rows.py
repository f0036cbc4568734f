"""Preferences of topics, reconciled with each other, the source and the link."""

from dataclasses import replace
from fractions import Fraction

from hypothesis import given
from hypothesis import strategies as st

from arpd.model.allocation import Binding, Topic
from arpd.solve.rows import SAMPLE, decimal, give_up, rational, rows_of

TOPIC = Topic(name="/t", wire_bytes=1000.0, packets=1, desired_rate_hz=100.0, min_rate_hz=2.0)
CAPACITY = 100_000.0
SIZES = st.floats(1.0, 1e6)
RATES = st.floats(0.0, 1e4)


def make(*topics, capacity=CAPACITY, overhead_s=0.0):
    return rows_of(topics, capacity=decimal(capacity), packet_overhead=decimal(overhead_s), parts=20)


def hertz(row, share):
    return Fraction(*row.rate_hz((share, 1)))


@given(st.lists(st.tuples(SIZES, RATES, RATES), min_size=1, max_size=5), st.floats(1e3, 1e8), st.floats(0.0, 0.1))
def test_rows_are_the_equations_in_whole_numbers(preferences, capacity, overhead_s):
    """Link time is a = k·t + s/C, lo = a·ℓ and hi = a·u in one unit for all topics, to the last digit."""
    topics = [
        replace(TOPIC, wire_bytes=size, packets=3, desired_rate_hz=desired, min_rate_hz=least)
        for size, desired, least in preferences
    ]
    for topic, row in zip(topics, make(*topics, capacity=capacity, overhead_s=overhead_s), strict=True):
        cost = 3 * rational(overhead_s) + rational(topic.wire_bytes) / rational(capacity)
        ceiling = rational(topic.desired_rate_hz) or rational(topic.min_rate_hz)
        floor = min(rational(topic.min_rate_hz), ceiling)
        assert Fraction(row.cost, row.units.time) == cost
        assert Fraction(row.lo, row.units.share) == cost * floor
        assert Fraction(row.hi, row.units.share) == max(cost * floor, min(cost * ceiling, 1))
        assert hertz(row, row.lo) == floor
        assert row.max_rate_hz == float(1 / cost)
        assert row.units.share % 20 == 0


@given(st.fractions(0, 1000), st.fractions(0, 1000))
def test_depth_cap_is_monotone_in_the_rate_and_within_bounds(one, other):
    """A faster topic never gets less history, and the cap stays within Dmin..Dmax."""
    (row,) = make(replace(TOPIC, min_depth=2, max_depth=50, latency_budget_s=0.5))
    slow, fast = (row.depth_cap(row.justified(rate.as_integer_ratio(), reserve=1)) for rate in sorted((one, other)))
    assert 2 * SAMPLE <= slow <= fast <= 50 * SAMPLE


@given(SIZES, st.fractions(0, 1000), st.integers(1, 5000), st.one_of(st.none(), st.floats(0.001, 100.0)))
def test_justified_history_is_eq_3(wire_bytes, rate_hz, max_depth, budget_s):
    """⌊τ·R − δ⌋ in whole samples agrees with exact arithmetic, for every window."""
    (row,) = make(replace(TOPIC, wire_bytes=wire_bytes, max_depth=max_depth, latency_budget_s=budget_s))
    window = max_depth * rational(wire_bytes) / rational(CAPACITY)
    if budget_s is not None:
        window = min(window, rational(budget_s))
    assert row.justified(rate_hz.as_integer_ratio(), reserve=1) // SAMPLE == (window * rate_hz - 1) // 1


def test_a_desired_rate_without_bound_means_what_the_link_carries():
    """A desired rate of inf means Rmax, and the link then stops the topic."""
    (row,) = make(replace(TOPIC, desired_rate_hz=float("inf")))
    assert (hertz(row, row.hi), row.ceiling) == (100, Binding.LINK)
    assert make(replace(TOPIC, desired_rate_hz=99.0))[0].ceiling is Binding.DESIRED_RATE


AMOUNTS = st.lists(st.tuples(st.integers(0, 100), st.sampled_from([1, 2, 4, 16])), min_size=1, max_size=10)


@given(AMOUNTS, st.integers(0, 500))
def test_giving_up_takes_exactly_the_deficit_from_the_lightest_first(rows, deficit):
    """The cut is the deficit or everything; a class is cut only when every lighter one is at 0."""
    amounts, weights = [amount for amount, _ in rows], [weight for _, weight in rows]
    left = {weight: Fraction(*part) for weight, part in give_up(amounts, weights, deficit).items()}
    taken = sum(amount * (1 - left.get(weight, Fraction(1))) for amount, weight in rows)
    assert taken == min(sum(amounts), deficit)
    for weight, part in left.items():
        assert 0 <= part < 1
        assert all(left[lighter] == 0 for amount, lighter in rows if lighter < weight and amount > 0)
