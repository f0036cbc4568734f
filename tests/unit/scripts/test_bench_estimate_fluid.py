"""The delay-target controller on a fluid."""

from __future__ import annotations

import math

import pytest

from arpd.adapters.sim.result import percentile
from arpd.adapters.sim.schedule import RateSchedule, RateStep
from scripts.bench.estimate_fluid import Feedback, control, flow
from scripts.bench.estimate_scenarios import SCENARIOS

MBIT = 125_000.0


def play(text, duration_s, *, demand=30.0 * MBIT, **more):
    return control(RateSchedule.parse(text), duration_s, demand_bytes_per_second=demand, **more)


def test_on_a_steady_link_the_queue_comes_to_its_target():
    """The link is full after a second, and 30 ms wait."""
    run = play("0:5mbit", 20.0)
    assert run.carried_between(1.0, 20.0) == pytest.approx(19.0 * 5 * MBIT, rel=0.01)
    assert all(abs(delay_s - 0.03) < 0.005 for delay_s in run.delays_between(5.0, 20.0))


def test_a_small_demand_is_carried_without_a_queue():
    """It never sends more than the demand."""
    run = play("0:5mbit", 10.0, demand=2.0 * MBIT)
    assert run.carried_between(2.0, 10.0) == pytest.approx(8.0 * 2.0 * MBIT)
    assert max(run.delays_between(2.0, 10.0)) == 0.0


def test_a_fall_leaves_a_queue_that_drains():
    """What came between the fall and the first sight of it waits, and is gone within seconds."""
    run = play("0:20mbit,10:5mbit", 20.0)
    assert max(run.delays_between(10.0, 10.5)) > 0.3
    assert max(run.delays_between(14.0, 20.0)) < 0.05


def test_older_feedback_means_longer_queues():
    """On a link that changes every two seconds, feedback of a quarter of the age at least halves p99."""
    steps = ",".join(f"{2 * k}:{20 if k % 2 else 5}mbit" for k in range(15))
    fresh, stale = (
        percentile(play(steps, 30.0, feedback=Feedback(every_s=age_s, age_s=age_s)).delays_between(5.0, 30.0), 0.99)
        for age_s in (0.05, 0.2)
    )
    assert fresh is not None
    assert stale is not None
    assert stale > 2.0 * fresh


BLIND = Feedback(age_s=100.0)  # it sends its first rate, 0.4 Mbit/s, to the end


def test_a_delay_is_the_time_until_the_byte_leaves():
    """A link of half the rate makes the queue grow by half of the time; a faster one has none."""
    slow, fast = (play(text, 0.5, feedback=BLIND) for text in ("0:0.2mbit", "0:4mbit"))
    assert slow.queue_delays_s == pytest.approx([0.01 * (step + 1) for step in range(50)])
    assert fast.queue_delays_s == (0.0,) * 50
    assert sum(fast.carried_bytes) == pytest.approx(0.5 * 0.4 * MBIT)


def test_what_a_dead_link_holds_never_leaves():
    """Its delay is infinite."""
    dead = RateSchedule(steps=(RateStep(start_s=0.0, rate_bytes_per_second=0.0),))
    assert control(dead, 0.1, demand_bytes_per_second=MBIT).queue_delays_s[-1] == math.inf


def test_its_run_has_the_moments_of_a_scenario():
    """Ten times a second it shows the link, the queue and what was carried so far, and no topic."""
    scenario = SCENARIOS["oscillation 8 s"]
    result = flow(scenario, 1)
    assert result.topics == ()
    assert [moment.t_s for moment in result.moments] == [round(0.1 * k, 6) for k in range(520)]
    assert {round(moment.truth_bytes_per_second / MBIT, 6) for moment in result.moments} == {5.0, 20.0}
    could = sum(0.1 * moment.truth_bytes_per_second for moment in result.moments)
    assert 0.9 * could < result.moments[-1].carried_bytes < could
    assert max(moment.queue_delay_s for moment in result.moments) > 0.1
