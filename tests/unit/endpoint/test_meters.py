"""Rate of samples."""

import pytest

from arpd.endpoint.meters import SampleRate


def test_what_waited_for_a_caller_that_was_held_up_is_no_rate():
    """After a stall the queued samples come at once; the rate is that of the samples that follow."""
    rate, now_s = SampleRate(), 100.0
    for _ in range(100):
        now_s += 0.001
        rate.count(now_s)
    for _ in range(20):
        now_s += 0.05
        rate.count(now_s)
    assert rate.rate_hz(now_s) == pytest.approx(20.0, rel=0.02)
