"""A publisher of the simulated robot counts like a real one."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from random import Random

import pytest

from arpd.adapters.sim.link import LinkModel, SimulatedLink
from arpd.adapters.sim.robot import SampleSource, SimTopic, SimulatedPublisher
from arpd.adapters.sim.schedule import RateSchedule
from arpd.adapters.sim.timeline import Timeline
from arpd.adapters.sim.writer import LinkPath
from arpd.model.endpoints import SwapPhase, SwapResult, WithheldCause
from arpd.model.plan import TopicPlan

ORIGIN_S = 1000.0
PLAN = TopicPlan(rate_hz=10.0, min_rate_hz=1.0, deadline_ns=125_000_000, depth=40)


@pytest.fixture
def timeline():
    return Timeline(ORIGIN_S)


@pytest.fixture
def publisher(timeline):
    there, back = (
        SimulatedLink(
            timeline, RateSchedule.parse("0:20mbit"), origin_s=ORIGIN_S, model=LinkModel(), random=Random(name)
        )
        for name in ("there", "back")
    )
    topic = SimTopic(name="/scan", payload_bytes=500, rate_hz=50.0)
    route = LinkPath(timeline=timeline, there=there, back=back)
    publisher = SimulatedPublisher(route, topic, name="/link/scan", node="/relay", heartbeat_s=0.05)
    SampleSource(timeline, publisher.publish, rate_hz=50.0, start_s=ORIGIN_S, end_s=ORIGIN_S + 20.0, random=Random(1))
    timeline.every(1.0, partial(publisher.state, generation=0), first_s=ORIGIN_S)
    return publisher


def test_it_tells_what_left_what_gave_way_and_what_a_swap_took(timeline, publisher):
    """Rates, withheld samples by cause and phases of the swap add up."""
    timeline.run_until(ORIGIN_S + 5.0)
    publisher.retune(PLAN)
    timeline.run_until(ORIGIN_S + 19.0)
    state = publisher.state(generation=1)
    assert state.source_rate_hz == pytest.approx(50.0, rel=0.02)
    assert state.published_rate_hz == pytest.approx(10.0, rel=0.02)
    assert state.withheld_by_cause == {WithheldCause.RATE: state.withheld}
    assert state.deadlines_missed == 0
    assert (state.swaps_begun, state.swaps_by_result) == (1, {SwapResult.OK: 1})
    assert state.last_swap is not None
    assert (state.last_swap.depth, state.last_swap.deadline_ns) == (PLAN.depth, PLAN.deadline_ns)
    assert set(state.last_swap.seconds_by_phase) >= {SwapPhase.MATCHING, SwapPhase.PROVING}
    assert set(state.swap_seconds_by_phase) > set(state.last_swap.seconds_by_phase)


def test_a_source_that_ceases_misses_its_deadlines(timeline, publisher):
    """A silent source misses eight deadlines of 125 ms a second from its last sample on."""
    publisher.retune(replace(PLAN, rate_hz=100.0))
    timeline.run_until(ORIGIN_S + 19.0)
    assert publisher.state(generation=1).deadlines_missed == 0
    timeline.run_until(ORIGIN_S + 20.0 + 2.0)
    assert publisher.state(generation=1).deadlines_missed in {15, 16}
