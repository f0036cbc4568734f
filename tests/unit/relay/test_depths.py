"""KEEP_LAST depths of the relay's own endpoints."""

import pytest

from arpd.relay.depths import BULK_BYTES, MOST_BYTES, PLAIN_BYTES, held_depth


@pytest.mark.parametrize(("sample_bytes", "rate_hz"), [(PLAIN_BYTES, 1000), (BULK_BYTES, 60)])
def test_a_depth_holds_a_second_of_the_fastest_topic_within_its_memory(sample_bytes, rate_hz):
    """An IMU of 1 kHz and a camera of 60 Hz may wait for a second, and take 16 MB at most."""
    depth = held_depth(10, sample_bytes=sample_bytes)
    assert depth >= rate_hz
    assert depth * sample_bytes <= MOST_BYTES


def test_what_the_configuration_asks_for_is_held():
    """A depth of `relay.topics` is never reduced."""
    assert held_depth(5000, sample_bytes=BULK_BYTES) == 5000
