"""What a sample costs on the wire."""

from hypothesis import given
from hypothesis import strategies as st

from arpd.wire import ACKNACK_BYTES, MTU_BYTES, RTPS_BYTES, probe_wire_bytes, wire_size

PAYLOADS = st.integers(0, 60_000)


@given(PAYLOADS, PAYLOADS)
def test_more_payload_never_costs_less(one, other):
    """Bytes rise strictly with the payload, packets never fall."""
    small, large = sorted((one, other))
    assert wire_size(small)[1] <= wire_size(large)[1]
    assert wire_size(small)[0] <= wire_size(large)[0]
    assert wire_size(small)[0] < wire_size(large)[0] or small == large


@given(PAYLOADS)
def test_every_packet_fits_the_mtu(payload_bytes):
    """The packets are enough for the datagram, and no packet is superfluous."""
    wire_bytes, packets = wire_size(payload_bytes)
    link_bytes = wire_bytes - ACKNACK_BYTES - packets * 14
    assert (packets - 1) * MTU_BYTES < link_bytes <= packets * MTU_BYTES


@given(PAYLOADS)
def test_overhead_is_more_than_the_headers_of_one_packet(payload_bytes):
    """No sample is cheaper than its payload, its RTPS headers and its acknowledgement."""
    assert wire_size(payload_bytes)[0] > payload_bytes + RTPS_BYTES + ACKNACK_BYTES


@given(st.integers(0, 1400))
def test_a_probe_costs_less_than_a_reliable_sample_of_its_size(data_bytes):
    """A best-effort probe carries no heartbeat and gets no acknowledgement."""
    assert data_bytes < probe_wire_bytes(data_bytes) < wire_size(data_bytes)[0]


def test_a_probe_packet_of_a_train_is_one_frame():
    """Trains are made of packets that need no fragment, so that each is one arrival."""
    assert probe_wire_bytes(1300) <= MTU_BYTES + 14
