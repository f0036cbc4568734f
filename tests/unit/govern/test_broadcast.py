"""When the price goes out: at once when it changed, and once a second."""

import math
from dataclasses import replace

import pytest

from arpd.govern.broadcast import Broadcast
from arpd.model.price import Price

PRICE = Price(share_per_weight=0.1, capacity_bytes_per_second=1e6)


def sent(prices, tick_s=0.1):
    """Return the ticks at which a price goes out, one price per tick."""
    broadcast = Broadcast()
    return [tick for tick, price in enumerate(prices) if broadcast.is_due(price, 100.0 + tick_s * tick)]


@pytest.mark.parametrize(("factor", "is_news"), [(1.005, False), (0.995, False), (1.02, True), (0.98, True), (0, True)])
def test_a_change_goes_out_at_once(factor, is_news):
    """A change of more than one per cent does not wait; what stays is repeated once a second, a sign of life."""
    assert sent([PRICE, PRICE, replace(PRICE, share_per_weight=0.1 * factor)]) == [0, *[2] * is_news]
    assert sent([PRICE] * 25) == [0, 10, 20]


def test_a_step_waits_for_no_pause():
    """A price that leaps or falls by more than a tenth goes out in 30 ms, one that creeps in a tenth of a second."""
    usual = replace(PRICE, capacity_bytes_per_second=625e3)
    steps = {part: [usual, *[replace(usual, share_per_weight=0.1 * part)] * 8] for part in (0.5, 0.95, 1.05, 1.5)}
    assert {part: sent(prices, tick_s=0.03) for part, prices in steps.items()} == {
        0.5: [0, 1],
        0.95: [0, 4],
        1.05: [0, 4],
        1.5: [0, 1],
    }


def test_a_leap_on_a_link_that_falls_waits():
    """Where the capacity falls, a price that leaps because a queue drained waits for a tenth of a second."""
    usual = replace(PRICE, capacity_bytes_per_second=625e3)
    leap = replace(usual, share_per_weight=0.2, capacity_bytes_per_second=0.9 * 625e3)
    assert sent([usual, *[leap] * 8], tick_s=0.03) == [0, 4]


def test_a_slow_link_is_not_filled_with_prices():
    """On a link of 8 kbit/s small changes wait for a second, and a deep fall does not."""
    slow = replace(PRICE, capacity_bytes_per_second=1e3)
    rising = [replace(slow, share_per_weight=0.1 * 1.05**tick) for tick in range(12)]
    assert sent(rising) == [0, 10]
    assert sent([slow, slow, replace(slow, share_per_weight=0.05)]) == [0, 2]
    for level in (0.0, math.inf):  # where floors give way, too
        yielding = replace(slow, share_per_weight=level)
        assert sent([replace(yielding, kept_minimum=0.05 * tick) for tick in range(12)]) == [0, 10]
