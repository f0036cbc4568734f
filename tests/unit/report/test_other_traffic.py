"""Other traffic: what the interface carried beyond topics, heartbeats, probes and reports."""

from __future__ import annotations

from dataclasses import replace

import pytest

from arpd.estimate.probes import REPORT_BYTES
from arpd.model.endpoints import Direction
from arpd.model.probing import PeerReport
from arpd.model.wire import ACKNACK_BYTES, wire_size
from arpd.report.other_traffic import OtherTraffic
from tests.sample_link import INTERFACE, observation
from tests.sample_publishers import publisher

TICK_S = 0.1
HZ, PAYLOAD_BYTES = 50.0, 5000.0
SAMPLE_BYTES, ACKNOWLEDGED_HZ = wire_size(PAYLOAD_BYTES, rate_hz=HZ)[0], 20.0
DATA = HZ * SAMPLE_BYTES - ACKNOWLEDGED_HZ * ACKNACK_BYTES  # samples and heartbeats (bytes/s)
REPORT = PeerReport(peer="p", received_at_s=0.0, interval_s=0.1, rx_bytes=0, rx_packets=0)


def rates(*, transmit, receive, ticks=30, probe_rate=0.0, **fields):
    """Return the other traffic of an interface that carries so many bytes a second."""
    other = OtherTraffic()
    found = []
    for tick in range(ticks):
        at_s = tick * TICK_S
        counters = replace(INTERFACE, tx_bytes=round(transmit * at_s), rx_bytes=round(receive * at_s))
        seen = observation(500.0 + at_s, **{"counters": counters, "peers": 1, **fields})
        reports = (tick + 1) * len(seen.reports)
        found.append(other.update(seen, probe_bytes=round(probe_rate * at_s), reports=reports))
    return found


def topic(direction, **fields):
    return publisher(
        "/n", "/t", direction=direction, payload_bytes=PAYLOAD_BYTES, published_rate_hz=HZ, remote_readers=1, **fields
    )


def test_what_nobody_explains_is_other_traffic():
    """Nothing is known before a second has passed; then all of an idle robot's bytes are other traffic."""
    found = rates(transmit=3000.0, receive=1000.0)
    assert found[:10] == [None] * 10
    assert found[-1] == pytest.approx((3000.0, 1000.0), rel=0.01)


@pytest.mark.parametrize(
    ("direction", "carried", "left"),
    [
        (Direction.SENSING, (DATA + 3000.0, 1000.0), (3000.0, 1000.0)),
        (Direction.ACTUATION, (3000.0, DATA + 1000.0), (3000.0, 1000.0)),
        (Direction.LOCAL, (3000.0, 1000.0), (3000.0, 1000.0)),
    ],
)
def test_samples_count_in_their_direction(direction, carried, left):
    """Samples and heartbeats are explained where they flow; the acknowledgements are not."""
    transmit, receive = carried
    found = rates(transmit=transmit, receive=receive, publishers=(topic(direction),))
    assert found[-1] == pytest.approx(left, abs=20.0)


def test_probes_and_reports_are_ours():
    """A probe crosses once per peer, and each tick brings a report."""
    reports_rate = REPORT_BYTES / TICK_S
    found = rates(transmit=6500.0, receive=reports_rate + 250.0, probe_rate=3000.0, peers=2, reports=(REPORT,))
    assert found[-1] == pytest.approx((500.0, 250.0), abs=20.0)
