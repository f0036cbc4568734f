"""Admission of messages from the network: rates, and reports of peers."""

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.observation import MessageRefusal
from arpd.model.probing import PeerReport, Train
from arpd.ros.peer_reports import Ceiling, PeerAdmission
from arpd.ros.rate_limits import SourceRateLimiter, TokenBucket
from tests.examples import examples

REPORT = PeerReport(peer="base", received_at_s=0.0, interval_s=0.1, rx_bytes=1000, rx_packets=2, last_probe=0)
HIGH = 1e12


# -- rates


@examples(50)
@given(st.lists(st.floats(0, 100), max_size=60), st.floats(0.1, 20), st.integers(1, 10))
def test_a_bucket_lets_its_rate_and_its_burst_through(times, rate_hz, burst):
    """At any pattern of times, no more passes than burst and rate allow, and the burst always does."""
    bucket = TokenBucket(rate_hz, burst)
    passed = sum(bucket.take(now_s) for now_s in sorted(times))
    assert passed <= burst + rate_hz * (max(times, default=0.0) - min(times, default=0.0)) + 1e-6
    assert passed >= min(len(times), burst)


def test_a_flood_takes_nothing_from_the_others():
    """Each source has its own rate, and those beyond the bound share one."""
    limiter = SourceRateLimiter(rate_hz=2.0, burst=2.0)
    passed = 0
    for tick in range(100):
        now_s = tick / 10
        if tick % 10 == 0:
            assert limiter.lets_pass("honest", now_s)
        passed += sum(limiter.lets_pass("flood", now_s) for _ in range(100))
    assert passed <= 2 + 2 * 10
    assert sum(limiter.lets_pass(f"invented{k}", 10.0) for k in range(5000)) < 1010
    assert limiter.lets_pass("honest", 10.0)


# -- reports


def answering(admission, probe, **fields):
    return replace(REPORT, last_probe=admission.number(probe), **fields)


@pytest.mark.parametrize("base", [0, 1, 2**31, 2**32 - 1])
def test_a_report_must_answer_a_probe_that_was_sent(base):
    """Only the number of a recent probe is an answer; it comes back as our own number."""
    admission: Any = PeerAdmission(base)
    admission.see(1)
    for probe in range(1, 4):
        admission.number(probe)
    answer = answering(admission, 3)
    assert admission.check(answer, 0.0, ceiling=HIGH).last_probe == 3
    for guess in (0, (base + 4) % 2**32, base, (base - 5) % 2**32, 4711):
        if (guess - base) % 2**32 not in (1, 2, 3) or guess == 0:
            assert admission.check(replace(REPORT, last_probe=guess), 0.0, ceiling=HIGH) is MessageRefusal.UNANSWERED
    admission.number(5000)
    assert admission.check(answer, 0.0, ceiling=HIGH) is MessageRefusal.UNANSWERED  # too old


def test_no_more_peers_are_believed_than_there_are():
    """Invented peers get at most as many entries as the graph shows, and never that of a known peer."""
    admission: Any = PeerAdmission(9)
    admission.see(2)
    for tick in range(200):
        now_s = tick / 10
        assert isinstance(admission.check(answering(admission, 1), now_s, ceiling=HIGH), PeerReport)
        results = [
            admission.check(answering(admission, 1, peer=f"liar-{tick}-{k}"), now_s, ceiling=HIGH) for k in range(5)
        ]
        assert sum(isinstance(result, PeerReport) for result in results) <= 1


def test_no_report_exceeds_what_the_link_can_do():
    """Bytes and trains above the upper bound count as the bound."""
    admission: Any = PeerAdmission(9)
    fast = Train(payload_bytes=1_000_000, duration_s=1e-6, packets=24)
    slow = Train(payload_bytes=1000, duration_s=0.5, packets=24)
    admitted = admission.check(answering(admission, 1, rx_bytes=2**32 - 1, trains=(fast, slow)), 0.0, ceiling=2e6)
    assert admitted.rx_bytes == 200_000
    assert admitted.trains[0].rate_bytes_per_second == pytest.approx(2_000_000.0)
    assert admitted.trains[1] == slow


def test_the_ceiling_is_the_lowest_bound():
    """The speed of a wired interface, twice the best recent rate of the radio, and 100 Gbit/s in any case."""
    ceiling = Ceiling()
    assert ceiling.bytes_per_second == 12.5e9
    ceiling.note(0.0, interface=125e6, radio=None)
    assert ceiling.bytes_per_second == 125e6
    ceiling.note(1.0, interface=None, radio=8e6)
    ceiling.note(30.0, interface=None, radio=1e6)  # it idles
    assert ceiling.bytes_per_second == 16e6
    ceiling.note(80.0, interface=None, radio=1e6)
    assert ceiling.bytes_per_second == 2e6
