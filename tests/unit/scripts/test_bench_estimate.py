"""The figures of scripts/bench/estimate.py, on runs written by hand."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from statistics import fmean, pstdev

import pytest

from arpd.adapters.sim.link import LinkModel
from arpd.adapters.sim.result import TopicResult
from arpd.adapters.sim.robot import SimTopic
from arpd.adapters.sim.service import Service
from arpd.daemon.scenario import Moment, ScenarioResult
from scripts.bench.estimate import document
from scripts.bench.estimate_cellular import cellular
from scripts.bench.estimate_metrics import measure
from scripts.bench.estimate_scenarios import MBIT, SCENARIOS, Scenario, steps
from scripts.bench.estimate_targets import TARGETS, Target

END_S = 40.0


def result(truth, estimate=None, **columns):
    """Make a run of 40 s; every argument is a function of time."""
    moments = []
    for k in range(400):
        t_s = k / 10
        moments.append(
            Moment(
                t_s=t_s,
                truth_bytes_per_second=truth(t_s),
                estimate_bytes_per_second=(estimate or truth)(t_s),
                budget_bytes_per_second=columns.get("budget", truth)(t_s),
                queue_delay_s=columns.get("queue", lambda _: 0.0)(t_s),
                delivered_bytes=columns.get("delivered", lambda t_s: 1000.0 * t_s)(t_s),
                carried_bytes=columns.get("carried", lambda t_s: 1000.0 * t_s)(t_s),
                packet_overhead_s=columns.get("overhead", lambda _: 0.0)(t_s),
                generation=1,
            )
        )
    return ScenarioResult(topics=columns.get("topics", ()), moments=tuple(moments))


def scenario(**more):
    return Scenario(duration_s=END_S, schedule=steps("0:20mbit"), **more)


def at(moment_s, before, after):
    return lambda t_s: before if t_s < moment_s - 1e-9 else after


def test_a_reaction_ends_when_the_estimate_is_near_and_stays_there():
    """An estimate that is near only for a moment is no reaction."""

    def estimate(t_s):
        passes_by = 20.5 <= t_s < 21.0
        return 5 * MBIT if passes_by or t_s >= 22.5 - 1e-9 else 20 * MBIT

    run = result(at(20.0, 20 * MBIT, 5 * MBIT), estimate)
    assert measure(scenario(falls=(20.0,)), run)["reaction, estimate"] == pytest.approx(2.5)


def test_an_estimate_that_never_comes_near_never_reacts():
    """Its reaction time is infinite, not absent."""
    run = result(at(20.0, 20 * MBIT, 5 * MBIT), lambda _: 20 * MBIT)
    assert measure(scenario(falls=(20.0,)), run)["reaction, estimate"] == math.inf


def test_the_budget_has_reacted_when_it_fits():
    """The budget must fit into the new truth, and stay so for a second."""
    run = result(
        at(20.0, 20 * MBIT, 5 * MBIT),
        budget=lambda t_s: 4 * MBIT if 20.1 < t_s < 20.5 or t_s >= 20.7 - 1e-9 else 17 * MBIT,
        estimate=lambda _: 1.0,
    )
    assert measure(scenario(falls=(20.0,)), run)["reaction, budget"] == pytest.approx(0.7)


def test_a_fall_is_judged_by_the_queue_that_stands_after_it():
    """The figure is the median after the fall, less the bound's; the queue before it does not count."""
    truth = at(20.0, 20 * MBIT, 10 * MBIT)
    run = result(truth, queue=lambda t_s: 9.0 if t_s < 20.0 else 0.08 if t_s < 35.0 else 0.5)
    bound = result(truth, queue=lambda _: 0.02)
    assert measure(scenario(falls=(20.0,)), run, bound=bound)["queue over bound"] == pytest.approx(0.06)


def test_a_rise_is_timed_for_the_estimate_and_for_what_is_delivered():
    """Delivery is compared with the bound's last ten seconds, half a second at a time."""
    truth = at(20.0, 5 * MBIT, 20 * MBIT)
    run = result(truth, at(23.0, 5 * MBIT, 17 * MBIT), delivered=lambda t_s: 100.0 * t_s + 900.0 * max(0.0, t_s - 24.0))
    bound = result(truth, delivered=lambda t_s: 1000.0 * t_s)
    found = measure(scenario(rises=(20.0,)), run, bound=bound)
    assert found["rise, estimate"] == pytest.approx(3.0)
    assert found["rise, goodput"] == pytest.approx(4.4)


def test_utilisation_leaves_the_start_out():
    """It is the delivery from 10 s on, over the bound's."""
    run = result(lambda _: 20 * MBIT, delivered=lambda t_s: 1e6 * min(t_s, 10.0) + 500.0 * max(0.0, t_s - 10.0))
    bound = result(lambda _: 20 * MBIT, delivered=lambda t_s: 1000.0 * t_s)
    assert measure(scenario(), run, bound=bound)["utilisation"] == pytest.approx(0.5)
    assert "utilisation" not in measure(scenario(), run)


def test_the_error_is_that_of_rmax():
    """A known overhead gives no error, and an unknown one does."""
    robot = (SimTopic(name="/small", payload_bytes=100, rate_hz=10.0),)
    lossless = scenario(robot=robot, model=LinkModel(packet_overhead_s=200e-6))
    run = result(lambda _: 1e6, overhead=lambda _: 200e-6)
    assert measure(lossless, run)["error p90"] == 0.0
    unaware = measure(lossless, result(lambda _: 1e6))["error p90"]
    assert 0.5 < unaware < 2.0
    plain = measure(scenario(), result(lambda _: 1e6, lambda _: 1.1e6))
    assert plain["error p50"] == pytest.approx(0.1)


def test_an_outage_is_judged_by_budget_queue_and_recovery():
    """Each figure is that of the worst outage."""
    spans = ((15.0, 17.0), (25.0, 28.0))
    out = lambda t_s: any(start_s <= t_s < end_s for start_s, end_s in spans)  # noqa: E731
    run = result(
        lambda t_s: 0.0 if out(t_s) else 20 * MBIT,
        lambda _: 20 * MBIT,
        budget=lambda t_s: (1.5 if 15.3 <= t_s < 17.0 or 25.5 <= t_s < 28.0 else 16.0) * MBIT,
        queue=lambda t_s: 9.0 if out(t_s) else 0.25 if t_s in (29.0, 35.0) else 0.01,
        delivered=lambda t_s: 1000.0 * (min(t_s, 15.0) + min(max(0.0, t_s - 17.0), 8.0) + max(0.0, t_s - 30.0)),
    )
    found = measure(scenario(outages=spans), run)
    assert found["closed within"] == pytest.approx(0.5)
    assert found["queue in"] == 0.01
    assert found["queue after"] == 0.25
    assert found["recovery"] == pytest.approx(2.5)
    assert "queue in over bound" not in found
    bound = result(lambda t_s: 0.0 if out(t_s) else 20 * MBIT, queue=lambda _: 0.004)
    assert measure(scenario(outages=spans), run, bound=bound)["queue in over bound"] == pytest.approx(0.006)
    assert found["queue peak"] == 0.25  # moments without service do not count


def test_a_queue_near_zero_counts_once_the_fall_has_drained():
    """The first ten seconds belong to what was on its way."""
    run = result(at(12.0, 20 * MBIT, 0.1 * MBIT), queue=lambda t_s: 30.0 if t_s < 22.0 else 3.0 if t_s < 35.0 else 8.0)
    assert measure(scenario(lows=((12.0, 35.0),)), run)["near zero, queue"] == 3.0


def test_what_the_link_carried_is_compared_with_the_fluid():
    """Wire bytes of the window count, and the queue that 95 % of its moments have or less."""
    queue = lambda t_s: 0.5 if t_s < 11.0 else 0.2  # noqa: E731 - a second is less than 5 % of the window
    run = result(lambda _: 1000.0, carried=lambda t_s: 5e5 * min(t_s, 10.0) + 600.0 * t_s, queue=queue)
    fluid = result(lambda _: 1000.0, carried=lambda t_s: 800.0 * t_s, queue=lambda _: 0.1)
    found = measure(scenario(), run, fluid=fluid)
    assert found["carried"] == pytest.approx(0.6)
    assert found["carried / fluid"] == pytest.approx(0.75)
    assert found["queue p95 / fluid"] == pytest.approx(2.0)


def topic(*, sent, received):
    return TopicResult(
        topic="/t",
        source_rate_hz=10.0,
        expected=sent,
        offered=sent,
        withheld=0,
        sent=sent,
        received=received,
        doubled=0,
        reordered=0,
        delivered_bytes=0,
        latency_p50_s=None,
        latency_p99_s=None,
        latency_max_s=None,
        age_p50_s=None,
        age_p99_s=None,
    )


def test_losses_beyond_the_bound_are_counted_by_topic():
    """Where the bound loses more of another topic, that makes up for nothing."""
    ours = (topic(sent=10, received=7), topic(sent=10, received=10))
    theirs = (topic(sent=9, received=8), topic(sent=10, received=3))
    run, bound = (result(lambda _: 1e6, topics=topics) for topics in (ours, theirs))
    found = measure(scenario(), run, bound=bound)
    assert (found["lost"], found["lost beyond bound"]) == (3, 2)


# -- targets


def values(figure, *numbers):
    return {"fall 20 to 5": {"arpd": [{figure: number} for number in numbers]}}


def test_a_target_is_met_by_median_and_worst_seed():
    """Each has its own limit."""
    target = Target("t", "reaction, budget", 0.6, ("fall 20 to 5",), 1.5)
    for numbers, met in (((0.5, 0.6, 1.5), True), ((0.5, 0.7, 0.8), False), ((0.1, 0.1, 1.6), False)):
        assert target.is_met(target.values(values("reaction, budget", *numbers), "arpd")) is met


def test_a_target_from_below_is_missed_by_its_smallest():
    """Where more is better, the smallest value is the worst."""
    target = Target("t", "utilisation", 0.95)
    assert target.worst([0.99, 0.94]) == 0.94
    assert not target.is_met([0.99, 0.98, 0.94])


def test_every_target_names_scenarios_that_exist():
    """A target without values would never be judged."""
    for target in TARGETS:
        assert set(target.scenarios) <= set(SCENARIOS)


def test_what_never_happened_is_null_in_json_and_the_worst_of_all():
    """A seed without the event does not meet the target, after its way through JSON either."""
    written = json.loads(json.dumps(document(values("reaction, budget", 0.5, 0.5, math.inf), 3, 1.0), allow_nan=False))
    target = Target("t", "reaction, budget", 0.6, ("fall 20 to 5",), 1.5)
    assert written["scenarios"]["fall 20 to 5"]["arpd"][-1] == {"reaction, budget": None}
    assert target.worst(target.values(written["scenarios"], "arpd")) == math.inf


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_is_a_link_for_any_seed(name):
    """The same seed gives the same schedule, and all changes lie within the run."""
    played = SCENARIOS[name]
    assert played.schedule(1) == played.schedule(1)
    assert played.schedule(2).duration_s <= played.duration_s + 0.1
    for moment_s in (*played.falls, *played.rises, *(end_s for _, end_s in played.outages)):
        assert 10.0 < moment_s < played.duration_s


# -- links from a seed


def carried_mbit(schedule, duration_s):
    """Return the mean rate of every tenth of a second (Mbit/s)."""
    service = Service(schedule, 0.0)
    marks = [service.by(0.1 * k) for k in range(round(10 * duration_s) + 1)]
    return [10.0 * (after - before) / MBIT for before, after in pairwise(marks)]


def test_a_cellular_link_is_sometimes_out_and_carries_four_to_seven_mbit_on_average():
    """Over many seeds the mean is that of the process, and so is the time without any packet."""
    rates = [rate for seed in range(20) for rate in carried_mbit(cellular(f"test {seed}", 120.0), 120.0)]
    assert 4.0 < fmean(rates) < 7.0
    assert 0.05 < rates.count(0.0) / len(rates) < 0.25
    assert max(rates) < 20.0


def test_a_cellular_link_changes_by_200_packets_in_a_second():
    """Far from both bounds, means over 0.1 s a second apart differ by the motion and by what Poisson arrivals add."""
    changes = []
    for seed in range(40):
        rates = carried_mbit(cellular(f"test {seed}", 60.0), 60.0)
        changes += [after - before for before, after in zip(rates, rates[10:], strict=False) if 5.0 < before < 7.0]
    motion, arrivals = 200.0, math.sqrt(2 * 500 / 0.1)
    assert 0.75 < pstdev(changes) / (math.hypot(motion, arrivals) * 1500 / MBIT) < 1.15


def test_a_cellular_link_that_ends_in_an_outage_comes_back_after_the_run():
    """Until the end of the run nothing is carried; later everything that waits can leave."""
    ends = [cellular(f"test {seed}", 20.0) for seed in range(200)]
    out = [schedule for schedule in ends if schedule.duration_s > 20.0]
    assert 5 < len(out) < 60
    assert all(schedule.rate_at(20.0) == 0.0 < schedule.rate_at(20.1) for schedule in out)
    assert all(schedule.rate_at(30.0) > 0.0 for schedule in ends)


def test_a_link_near_zero_carries_next_to_nothing_for_fifty_seconds():
    """From 17 to 67 s it carries 0.01 to 0.25 Mbit/s, before 13 s and after it 20."""
    rates = carried_mbit(SCENARIOS["near zero"].schedule(3), 75.0)
    assert min(rates[170:670]) >= 0.01 - 1e-9
    assert max(rates[170:670]) <= 0.25 + 1e-9
    assert rates[:130] == pytest.approx([20.0] * 130)
    assert rates[671:] == pytest.approx([20.0] * len(rates[671:]))
