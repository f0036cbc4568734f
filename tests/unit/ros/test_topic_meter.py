"""The meter of `arpd topics`: rate and size from numbered samples, some of which are lost."""

import random

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
from hypothesis import given
from hypothesis import strategies as st

from arpd.ros.topic_measuring import TopicMeter


@given(
    rate_hz=st.floats(1.0, 300.0),
    begun_s=st.floats(0.0, 2.0),
    lost=st.floats(0.0, 0.8),
    seed=st.integers(0, 1000),
)
def test_a_steady_writer_has_its_rate_although_samples_are_lost(rate_hz, begun_s, lost, seed):
    """Numbers count the samples that did not arrive; losses cost a period or two of accuracy."""
    meter, dice = TopicMeter(rated_from_s=0.0), random.Random(seed)
    last = int((5.0 - begun_s) * rate_hz)
    for number in range(last + 1):
        if number in {0, last} or dice.random() >= lost:
            meter.add(writer=b"a", number=1000 + number, size_bytes=100, at_s=begun_s + number / rate_hz)
    assert meter.traffic(5.0).rate_hz == pytest.approx(rate_hz, rel=0.01)


@pytest.mark.parametrize("lost", [0, 1, 14])
def test_one_burst_is_no_rate_although_samples_of_it_are_lost(lost):
    """Twenty at once in ten seconds are two a second, of which the reader has room for some."""
    meter = TopicMeter(rated_from_s=0.0)
    for number in (*range(5), *range(5 + lost, 20)):
        meter.add(writer=b"w", number=number, size_bytes=100, at_s=0.5 + number * 1e-4)
    assert meter.traffic(10.0).rate_hz == pytest.approx(2.1, rel=0.01)


def test_sizes_are_the_mean_and_the_largest():
    """Compressed pictures differ in size."""
    meter = TopicMeter(rated_from_s=0.0)
    for number, size in enumerate((10, 20, 60)):
        meter.add(writer=b"a", number=number, size_bytes=size, at_s=float(number))
    traffic = meter.traffic(3.0)
    assert (traffic.mean_bytes, traffic.largest_bytes) == (30, 60)
    assert traffic.bytes_per_second == pytest.approx(30)
