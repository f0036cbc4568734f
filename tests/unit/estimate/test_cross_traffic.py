"""Cross traffic: never our own traffic; the simulation has what others send."""

from dataclasses import replace

import pytest

from arpd.estimate.cross_traffic import CrossTraffic
from arpd.model.relay import RelaySummary
from arpd.model.wire import wire_size
from tests.sample_link import INTERFACE, observation
from tests.sample_publishers import publisher
from tests.unit.estimate.test_estimator import FIRST, Link

TICK_S = 0.1
CHATTER, ALLOWANCE = 40_000.0, 0.05
START_S = 700.0
PAYLOAD_BYTES, RATE_HZ = 5000.0, 50.0


@pytest.mark.parametrize("what", ["ran before", "starts again", "is read by another host", "is read there no more"])
def test_what_a_publisher_sends_is_its_own(what):
    """A daemon that starts beside it, its restart, and readers that the graph shows 0.8 s late change nothing."""
    traffic, measured, carried, told = CrossTraffic(), [], 0.0, ()
    size, _ = wire_size(PAYLOAD_BYTES, rate_hz=RATE_HZ)
    before, after, at = {"is read by another host": (1, 2, 52), "is read there no more": (2, 1, 59)}.get(
        what, (1, 1, 0)
    )
    for tick in range(120):
        now_s = START_S + TICK_S * tick
        carried += RATE_HZ * TICK_S * size * (after if tick >= at else before)
        if tick and tick % 10 == 0:  # it tells once a second
            since = 50 if what == "starts again" and tick > 50 else -1000
            told = (
                publisher(
                    "/n",
                    "/t",
                    payload_bytes=PAYLOAD_BYTES,
                    source_rate_hz=RATE_HZ,
                    published=round(RATE_HZ * TICK_S * (tick - since)),
                    remote_readers=after if tick >= 60 else before,
                    announced_at_s=now_s,
                ),
            )
        counters = replace(INTERFACE, tx_bytes=int(carried))
        measured.append(traffic.update(observation(now_s, counters=counters, publishers=told)))
    assert measured == [0.0] * 120


@pytest.mark.parametrize("cross_traffic", [0.0, 1e6])
def test_what_a_relay_sends_is_its_own(cross_traffic):
    """Of a relay's two ends the bytes they count are no cross traffic, before a map has crossed whole, and in calls."""
    traffic, measured, own = CrossTraffic(), [], 600e3
    summary = RelaySummary()
    for tick in range(100):
        now_s = START_S + tick * TICK_S
        if tick % 10 == 3:  # it tells once a second
            summary = RelaySummary(link_bytes=int(own * (tick * TICK_S)))
        counters = replace(INTERFACE, tx_bytes=int((own + cross_traffic) * tick * TICK_S))
        measured.append(traffic.update(observation(now_s, counters=counters, relay=summary)))
    expected = max(0.0, cross_traffic - ALLOWANCE * own - CHATTER)
    assert measured[60:] == pytest.approx([expected] * 40, abs=0.03 * own)


def test_what_is_dropped_before_the_link_is_not_on_it():
    """Behind an access point that drops most of what leaves this host, cross traffic is the whole link at most."""
    estimate = Link().measured().ticks(60, sent=8 * FIRST)
    assert 0.0 < estimate.cross_traffic_bytes_per_second <= estimate.capacity_bytes_per_second
