"""The figures of scripts/bench/estimate.py, on runs written by hand."""

from __future__ import annotations

import json
import math

import pytest

from arpd.adapters.sim.link import LinkModel
from arpd.adapters.sim.robot import SimTopic
from arpd.daemon.scenario import Moment, ScenarioResult
from scripts.bench.estimate import document
from scripts.bench.estimate_metrics import measure
from scripts.bench.estimate_report import TARGETS, Target, scenario_table, target_table
from scripts.bench.estimate_scenarios import MBIT, SCENARIOS, Scenario, steps

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
                level_bytes_per_second=columns.get("level", truth)(t_s),
                queue_delay_s=columns.get("queue", lambda _: 0.0)(t_s),
                gate=columns.get("gate", lambda _: 1.0)(t_s),
                delivered_bytes=columns.get("delivered", lambda t_s: 1000.0 * t_s)(t_s),
                packet_overhead_s=columns.get("overhead", lambda _: 0.0)(t_s),
                generation=1,
            )
        )
    return ScenarioResult(topics=(), moments=tuple(moments))


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
    assert measure(scenario(falls=(20.0,)), run, None)["reaction, estimate"] == pytest.approx(2.5)


def test_an_estimate_that_never_comes_near_never_reacts():
    """Its reaction time is infinite, not absent."""
    run = result(at(20.0, 20 * MBIT, 5 * MBIT), lambda _: 20 * MBIT)
    assert measure(scenario(falls=(20.0,)), run, None)["reaction, estimate"] == math.inf


def test_the_gate_has_reacted_when_what_it_lets_through_fits():
    """Gate times level must fit into the new truth."""
    run = result(
        at(20.0, 20 * MBIT, 5 * MBIT), gate=at(20.4, 1.0, 0.29), level=lambda _: 17 * MBIT, estimate=lambda _: 1.0
    )
    assert measure(scenario(falls=(20.0,)), run, None)["reaction, gate"] == pytest.approx(0.4)


def test_a_rise_is_timed_for_the_estimate_and_for_what_is_delivered():
    """Delivery is compared with the oracle's last ten seconds, a second at a time."""
    truth = at(20.0, 5 * MBIT, 20 * MBIT)
    run = result(truth, at(23.0, 5 * MBIT, 17 * MBIT), delivered=lambda t_s: 100.0 * t_s + 900.0 * max(0.0, t_s - 24.0))
    oracle = result(truth, delivered=lambda t_s: 1000.0 * t_s)
    found = measure(scenario(rises=(20.0,)), run, oracle)
    assert found["rise, estimate"] == pytest.approx(3.0)
    assert found["rise, goodput"] == pytest.approx(4.8)


def test_utilisation_leaves_the_start_out():
    """It is the delivery from 10 s on, over the oracle's."""
    run = result(lambda _: 20 * MBIT, delivered=lambda t_s: 1e6 * min(t_s, 10.0) + 500.0 * max(0.0, t_s - 10.0))
    oracle = result(lambda _: 20 * MBIT, delivered=lambda t_s: 1000.0 * t_s)
    assert measure(scenario(), run, oracle)["utilisation"] == pytest.approx(0.5)
    assert "utilisation" not in measure(scenario(), run, None)


def test_the_error_is_that_of_rmax():
    """A known overhead gives no error, and an unknown one does."""
    robot = (SimTopic(name="/small", payload_bytes=100, rate_hz=10.0),)
    lossless = scenario(robot=robot, model=LinkModel(packet_overhead_s=200e-6))
    run = result(lambda _: 1e6, overhead=lambda _: 200e-6)
    assert measure(lossless, run, None)["error p90"] == 0.0
    unaware = measure(lossless, result(lambda _: 1e6), None)["error p90"]
    assert 0.5 < unaware < 2.0
    plain = measure(scenario(), result(lambda _: 1e6, lambda _: 1.1e6), None)
    assert plain["error p50"] == pytest.approx(0.1)


def test_an_outage_is_judged_by_gate_queue_and_recovery():
    """Each figure is that of the worst outage."""
    spans = ((15.0, 17.0), (25.0, 28.0))
    out = lambda t_s: any(start_s <= t_s < end_s for start_s, end_s in spans)  # noqa: E731
    run = result(
        lambda t_s: 0.0 if out(t_s) else 20 * MBIT,
        lambda _: 20 * MBIT,
        gate=lambda t_s: 0.05 if 15.3 <= t_s < 17.0 or 25.5 <= t_s < 28.0 else 1.0,
        queue=lambda t_s: 9.0 if out(t_s) else 0.25 if t_s in (29.0, 35.0) else 0.01,
        delivered=lambda t_s: 1000.0 * (min(t_s, 15.0) + min(max(0.0, t_s - 17.0), 8.0) + max(0.0, t_s - 30.0)),
    )
    found = measure(scenario(outages=spans), run, None)
    assert found["closed within"] == pytest.approx(0.5)
    assert found["queue in"] == 0.01
    assert found["queue after"] == 0.25
    assert found["recovery"] == pytest.approx(2.9)
    assert "queue over oracle" not in found
    oracle = result(lambda t_s: 0.0 if out(t_s) else 20 * MBIT, queue=lambda _: 0.004)
    assert measure(scenario(outages=spans), run, oracle)["queue over oracle"] == pytest.approx(0.006)
    assert found["queue peak"] == 0.25  # moments without service do not count


# -- targets and tables


def values(figure, *numbers):
    return {"fall 20 to 5": {"arpd": [{figure: number} for number in numbers]}}


def test_a_target_is_met_by_median_and_worst_seed():
    """Each has its own limit."""
    target = Target(title="t", scenarios=("fall 20 to 5",), figure="reaction, gate", limit=0.6, worst_limit=1.5)
    for numbers, met in (((0.5, 0.6, 1.5), True), ((0.5, 0.7, 0.8), False), ((0.1, 0.1, 1.6), False)):
        assert target.is_met(target.values(values("reaction, gate", *numbers), "arpd")) is met


def test_a_target_from_below_is_missed_by_its_smallest():
    """Where more is better, the smallest value is the worst."""
    target = Target(title="t", scenarios=(), figure="utilisation", limit=0.95)
    assert target.worst([0.99, 0.94]) == 0.94
    assert not target.is_met([0.99, 0.98, 0.94])


def test_every_target_names_scenarios_that_exist():
    """A target without values would never be judged."""
    for target in TARGETS:
        assert set(target.scenarios) <= set(SCENARIOS)


def test_what_never_happened_is_shown_as_never():
    """Both tables say never, and JSON has null."""
    found = values("reaction, gate", 0.5, 0.5, math.inf)
    found["fall 20 to 5"]["arpd"] = [row | {"error p50": 0.0} for row in found["fall 20 to 5"]["arpd"]]
    assert "(never)" in scenario_table(found, seeds=3)
    assert "never" in target_table(found, "arpd")
    text = json.dumps(document(found, 3, 1.0), allow_nan=False)
    assert '"worst": null' in text


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_is_a_link_for_any_seed(name):
    """The same seed gives the same schedule, and all changes lie within the run."""
    played = SCENARIOS[name]
    assert played.schedule(1) == played.schedule(1)
    assert played.schedule(2).duration_s < played.duration_s
    for moment_s in (*played.falls, *played.rises, *(end_s for _, end_s in played.outages)):
        assert 10.0 < moment_s < played.duration_s
