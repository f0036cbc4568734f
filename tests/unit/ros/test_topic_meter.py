"""The meter of `arpd topics`: rate and size from numbered samples, some of which are lost."""

from __future__ import annotations

import random

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
from hypothesis import given
from hypothesis import strategies as st

from arpd.ros.topic_measuring import TopicMeter


def fed(arrivals, *, rated_from_s=0.0, size=100):
    """Return a meter that took samples as (writer, number, arrival)."""
    meter = TopicMeter(rated_from_s=rated_from_s)
    for writer, number, at_s in arrivals:
        meter.add(writer=writer, number=number, size_bytes=size, at_s=at_s)
    return meter


def steady(rate_hz, *, until_s=5.0, writer=b"a", begun_s=0.0):
    period = 1.0 / rate_hz
    return [(writer, 1000 + n, begun_s + n * period) for n in range(int((until_s - begun_s) * rate_hz) + 1)]


@given(
    rate_hz=st.floats(1.0, 300.0),
    begun_s=st.floats(0.0, 2.0),
    lost=st.floats(0.0, 0.8),
    seed=st.integers(0, 1000),
)
def test_a_steady_writer_has_its_rate_although_samples_are_lost(rate_hz, begun_s, lost, seed):
    """Numbers count the samples that did not arrive; losses cost a period or two of accuracy."""
    dice = random.Random(seed)
    sent = steady(rate_hz, begun_s=begun_s)
    kept = [sent[0], *(sample for sample in sent[1:-1] if dice.random() >= lost), sent[-1]]
    assert fed(kept).traffic(5.0).rate_hz == pytest.approx(rate_hz, rel=0.01)


def test_the_history_of_a_latched_topic_has_a_size_and_no_rate():
    """Samples before the rated time tell the size alone."""
    traffic = fed([(b"a", 1, 0.1), (b"a", 2, 0.1)], rated_from_s=1.0, size=4000).traffic(5.0)
    assert (traffic.rate_hz, traffic.mean_bytes) == (0.0, 4000)


def test_sizes_are_the_mean_and_the_largest():
    """Compressed pictures differ in size."""
    meter = TopicMeter(rated_from_s=0.0)
    for number, size in enumerate((10, 20, 60)):
        meter.add(writer=b"a", number=number, size_bytes=size, at_s=float(number))
    traffic = meter.traffic(3.0)
    assert (traffic.mean_bytes, traffic.largest_bytes) == (30, 60)
    assert traffic.bytes_per_second == pytest.approx(30)
