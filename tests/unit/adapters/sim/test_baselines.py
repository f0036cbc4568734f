"""The estimators to compare arpd's with: the oracle, and estimates from throughput alone."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.adapters.sim.baselines import Oracle, ThroughputAverage, Truth, WindowMaximum
from arpd.model.link import CapacityKind, LinkState
from arpd.model.observation import MemoryState, Observation
from arpd.model.probing import PeerReport
from arpd.model.settings import LinkSettings

INTERVAL_S = 0.1
SETTINGS = LinkSettings(initial_capacity_bytes_per_second=123_456.0)
FROM_THROUGHPUT = (ThroughputAverage, WindowMaximum)


def observation(now_s, *reports):
    return Observation(
        now_s=now_s,
        counters=None,
        reports=reports,
        publishers=(),
        memory=MemoryState(total_bytes=2**32, available_bytes=2**31),
        sensing_topics=0,
        actuation_topics=0,
    )


def report(at_s, rate, interval_s=INTERVAL_S):
    size = round(rate * interval_s)
    return PeerReport(peer="p", received_at_s=at_s, interval_s=interval_s, rx_bytes=size, rx_packets=1)


def feed(estimator, rates, start_s=0.0):
    """Feed one report per rate; return the last estimate."""
    last = None
    for k, rate in enumerate(rates):
        at_s = start_s + (k + 1) * INTERVAL_S
        last = estimator.update(observation(at_s, report(at_s, rate)))
    return last


# -- the oracle


def test_the_oracle_tells_the_truth():
    """The oracle's capacity, queue, cross traffic, overhead and loss are those of the link at that moment."""
    truth = Truth(
        capacity_bytes_per_second=1e6,
        queue_delay_s=0.2,
        cross_traffic_bytes_per_second=3e5,
        packet_overhead_s=1e-4,
        loss_ratio=0.01,
    )
    told = Oracle(lambda: truth).update(observation(1.0))
    assert told.capacity_bytes_per_second == 1e6
    assert told.queue_delay_s == 0.2
    assert told.available_bytes_per_second == 7e5
    assert told.packet_overhead_s == 1e-4
    assert told.loss_ratio == 0.01
    assert told.kind is CapacityKind.CONFIGURED
    assert told.state is LinkState.STEADY


def test_the_oracle_knows_an_outage_without_waiting_for_silence():
    """A link that carries nothing is out, and its capacity stays above zero."""
    told = Oracle(lambda: Truth(capacity_bytes_per_second=0.0, queue_delay_s=0.0, is_out=True)).update(observation(1.0))
    assert told.state is LinkState.OUTAGE
    assert told.capacity_bytes_per_second > 0


def test_nothing_here_puts_probes_on_the_link():
    """No baseline requests a probe, before or after evidence."""
    oracle = Oracle(lambda: Truth(capacity_bytes_per_second=1e6, queue_delay_s=0.0))
    for estimator in (oracle, *(kind(SETTINGS) for kind in FROM_THROUGHPUT)):
        assert estimator.wanted_probes(0.0) == ()
        feed(estimator, [1e5] * 20)
        assert estimator.wanted_probes(2.0) == ()


# -- both estimates from throughput


@pytest.mark.parametrize("kind", FROM_THROUGHPUT)
def test_before_the_first_report_the_configured_belief_holds(kind):
    """Before the first report the estimate is the initial capacity, without evidence and without an outage."""
    estimator = kind(SETTINGS)
    told = estimator.update(observation(0.0))
    assert told.capacity_bytes_per_second == SETTINGS.initial_capacity_bytes_per_second
    assert told.state is LinkState.STEADY
    assert not estimator.has_evidence


@pytest.mark.parametrize("kind", FROM_THROUGHPUT)
def test_a_second_of_reports_is_evidence(kind):
    """A second of reports is evidence, and less is not."""
    estimator = kind(SETTINGS)
    feed(estimator, [1e5] * 9)
    assert not estimator.has_evidence
    feed(estimator, [1e5] * 3, start_s=0.9)
    assert estimator.has_evidence


@pytest.mark.parametrize("kind", FROM_THROUGHPUT)
def test_silence_is_an_outage_and_changes_no_belief(kind):
    """After 0.4 s without a report the link is out, and the estimate stays."""
    estimator = kind(SETTINGS)
    before = feed(estimator, [1e5] * 20)
    assert estimator.update(observation(2.35)).state is LinkState.STEADY
    silent = estimator.update(observation(2.45))
    assert silent.state is LinkState.OUTAGE
    assert silent.capacity_bytes_per_second == before.capacity_bytes_per_second


@pytest.mark.parametrize("kind", FROM_THROUGHPUT)
def test_what_an_outage_swallowed_is_no_rate(kind):
    """The delivery rate after an outage comes from the reports after it."""
    estimator = kind(SETTINGS)
    feed(estimator, [1e5] * 20)
    told = estimator.update(observation(10.0, report(10.0, 4e5)))
    assert told.delivery_rate_bytes_per_second == 4e5


@pytest.mark.parametrize("kind", FROM_THROUGHPUT)
def test_a_robot_that_sends_little_looks_like_a_slow_link(kind):
    """If the robot sends little, throughput alone underestimates the capacity; so arpd sends trains."""
    assert feed(kind(SETTINGS), [1e6] * 20 + [1e4] * 200).capacity_bytes_per_second < 2e4


# -- the average


def test_the_average_begins_with_what_it_sees_first():
    """The first report replaces the initial capacity."""
    assert feed(ThroughputAverage(SETTINGS), [5e5]).capacity_bytes_per_second == 5e5


def test_the_average_has_gone_63_percent_of_the_way_after_its_time_constant():
    """After its time constant the average has followed 63 % of a change."""
    estimator = ThroughputAverage(SETTINGS, time_constant_s=2.0)
    feed(estimator, [1e5] * 10)
    told = feed(estimator, [2e5] * 20, start_s=1.0)
    assert told.capacity_bytes_per_second == pytest.approx(2e5 - 1e5 / math.e)


def test_an_empty_interval_teaches_the_average_nothing():
    """A report of an empty interval does not change the average."""
    estimator = ThroughputAverage(SETTINGS)
    feed(estimator, [1e5] * 3)
    empty = replace(report(0.31, 0.0), interval_s=0.0)
    assert estimator.update(observation(0.31, empty)).capacity_bytes_per_second == pytest.approx(1e5)


# -- the maximum


def test_the_maximum_is_forgotten_after_its_window():
    """A burst of half a second raises the maximum for eight seconds."""
    estimator = WindowMaximum(SETTINGS)
    feed(estimator, [1e5] * 10 + [9e5] * 5)
    assert feed(estimator, [1e5] * 79, start_s=1.5).capacity_bytes_per_second == pytest.approx(9e5)
    assert feed(estimator, [1e5] * 5, start_s=9.4).capacity_bytes_per_second == pytest.approx(1e5)


@given(st.lists(st.integers(min_value=0, max_value=10**6), min_size=1, max_size=60))
def test_the_maximum_is_that_of_all_delivery_rates_in_the_window(rates):
    """The estimate is the maximum of all delivery rates in the window."""
    estimator = WindowMaximum(SETTINGS, window_s=1.0)
    seen = []
    for k, rate in enumerate(rates):
        at_s = (k + 1) * INTERVAL_S
        told = estimator.update(observation(at_s, report(at_s, rate)))
        seen.append((at_s, told.delivery_rate_bytes_per_second))
        expected = max(rate for seen_s, rate in seen if at_s - seen_s <= 1.0)
        assert told.capacity_bytes_per_second == max(1.0, expected)
