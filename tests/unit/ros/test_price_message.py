"""The price of the link, to and from the numbers of its message."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.plan import TopicPlan
from arpd.model.price import Price
from arpd.ros.price_message import decode_price, encode_price

POSITIVE = st.floats(0.0, exclude_min=True, allow_infinity=False)
PART = st.floats(0.0, 1.0)
PRICES = st.builds(
    lambda budget_share, spare_share, **rest: Price(
        budget_share=budget_share, spare_share=spare_share * budget_share, **rest
    ),
    share_per_weight=st.floats(0.0),
    capacity_bytes_per_second=POSITIVE,
    large_share_per_weight=st.floats(0.0, allow_infinity=False),
    packet_overhead_s=st.floats(0.0, allow_infinity=False),
    yielding_weight=st.floats(0.0, allow_infinity=False),
    kept_minimum=PART,
    loss_ratio=st.none() | PART,
    budget_share=PART,
    spare_share=PART,
)
GOOD = [1.0, math.inf, 1e6, 0.01, 0.0001, 2.0, 0.5, 0.02, 0.85, 0.1]


@given(PRICES)
def test_a_price_is_read_as_it_was_sent(price):
    """Encoding and decoding a price changes nothing."""
    assert decode_price(encode_price(price)) == price


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (0, 2.0),
        (0, math.nan),
        (1, -0.1),
        (2, 0.0),
        (2, math.inf),
        (3, -0.1),
        (3, math.inf),
        (4, -1e-9),
        (5, -1.0),
        (6, 1.1),
        (7, math.inf),
        (8, math.nan),
        (9, 0.9),
    ],
)
def test_a_number_that_no_price_has_is_refused(place, value):
    """One impossible number makes the whole message no price."""
    assert decode_price(GOOD).loss_ratio == 0.02
    with pytest.raises(ValueError, match=r"."):
        decode_price([*GOOD[:place], value, *GOOD[place + 1 :]])


@given(PRICES, st.sampled_from([0.0, 1e-6, 1.0, 1e6]), st.sampled_from([0.0, 1.0, 1e12]))
def test_under_any_price_a_publisher_keeps_to_its_ceiling(price, weight, wire_bytes):
    """No price that is a message, however absurd, makes a rate that is no rate."""
    plan = TopicPlan(
        rate_hz=30.0, min_rate_hz=5.0, deadline_ns=0, depth=1, weight=weight, wire_bytes=wire_bytes, packets=3
    )
    assert 0.0 <= price.rate_hz(plan) <= 30.0
    assert price.rate_hz(plan) <= price.growing_hz(plan)
