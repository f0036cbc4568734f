"""Cost of a sample on the wire."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.wire import ACKNACK_BYTES, FRAGMENT_BYTES, HEARTBEAT_BYTES, MTU_BYTES, wire_size

PAYLOADS = st.integers(0, 60_000)


@given(PAYLOADS)
def test_every_packet_fits_the_mtu(payload_bytes):
    """A sample takes the fewest parts that carry it, and IP fragments none of them, even under WireGuard."""
    wire_bytes, packets = wire_size(payload_bytes, rate_hz=math.inf)
    assert (packets - 1) * FRAGMENT_BYTES < max(1, payload_bytes) <= packets * FRAGMENT_BYTES
    headers = (wire_bytes - payload_bytes) / packets
    assert headers + FRAGMENT_BYTES - 14 <= 1420 < MTU_BYTES


@pytest.mark.parametrize(
    ("payload_bytes", "rate_hz", "wire_bytes", "packets"),
    [
        (324, math.inf, 498, 1),
        (1216, math.inf, 1390, 1),
        (1300, math.inf, 1402 + 270, 2),
        (324, 50.0, 498 + 0.4 * 336, 2),
        (76, 20.0, 250 + 336, 3),
        (76, 0.0, 250 + 336, 3),
    ],
)
def test_sizes_are_those_of_captured_frames(payload_bytes, rate_hz, wire_bytes, packets):
    """324 bytes took 498 on the wire, 1300 bytes 1402 and 270, a heartbeat 170, its acknowledgement 166."""
    assert HEARTBEAT_BYTES + ACKNACK_BYTES == 336
    assert wire_size(payload_bytes, rate_hz=rate_hz) == (wire_bytes, packets)
