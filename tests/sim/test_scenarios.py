"""The whole of arpd with the demo robot in virtual time, as an operator sees it."""

import math
import statistics
from dataclasses import replace
from functools import cache

import pytest

from arpd.daemon.scenario import Scenario, Way
from arpd.daemon.summary import between
from arpd.model.endpoints import Direction
from arpd.model.link import LinkState
from arpd.model.settings import LinkSettings
from arpd.sim.demo import demo_settings, demo_topics
from arpd.sim.link import CrossFlow, LinkModel
from arpd.sim.schedule import RateSchedule, outages
from tests.sim.watched import MBIT, goodput

STEADY_S = 60.0
STEP = "0:20mbit,10:5mbit,22:20mbit"  # falls at 10 s, recovers at 22 s
STEP_S, FALL_S, RISE_S = 38.0, 10.0, 22.0
OUTAGE, OUTAGE_S = (10.0, 15.0), 25.0
SEEDS = (1, 4)


@cache
def play(schedule, duration_s, *, way=Way.ARPD, seed=1, losses=(), loss=0.0, link=None, cross_traffic=()):
    settings = demo_settings() if link is None else replace(demo_settings(), link=link)
    model = LinkModel(losses=losses, loss=loss)
    return Scenario(
        settings, RateSchedule.parse(schedule), duration_s, seed=seed, way=way, model=model, cross_traffic=cross_traffic
    ).play()


def plans(result):
    """Return the moments with a new plan."""
    return [moment for moment in result.moments if moment.cause]


def errors(moments):
    return [abs(moment.estimate_bytes_per_second / moment.truth_bytes_per_second - 1.0) for moment in moments]


def right(moments):
    """Return the share of moments whose estimate is within 15 % of the truth."""
    return statistics.mean(error < 0.15 for error in errors(moments))


def first(moments, holds):
    return next((moment.t_s for moment in moments if holds(moment)), math.inf)


# -- a steady link


def test_a_link_that_carries_everything_is_left_alone():
    """On a steady 20 Mbit/s no sample is lost or late, and less than 2 % are withheld."""
    for topic in play("0:20mbit", STEADY_S).topics:
        assert topic.lost == 0
        assert topic.latency_p50_s < 0.1
        assert topic.withheld_ratio < 0.02
        if topic.source_rate_hz >= 5.0:
            assert topic.latency_p99_s < 0.1


def test_an_overloaded_link_is_kept_free_of_a_queue():
    """At 5 Mbit/s, with a demand of 12, the queue stays short and the link stays busy."""
    result = play("0:5mbit", STEADY_S)
    settled = between(result.moments, 15.0, STEADY_S)
    assert max(moment.queue_delay_s for moment in settled) < 0.2
    # Samples are lost only in the first seconds, while everything flows unpaced before the first plan.
    assert sum(topic.lost for topic in result.topics) < 0.01 * sum(topic.sent for topic in result.topics)
    delivered = sum(topic.delivered_bytes for topic in result.topics if topic.topic != "/cmd_vel")
    assert delivered / STEADY_S > 0.6 * 5 * MBIT


# -- a link that falls and recovers


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("topic", [t.name for t in demo_topics() if t.name != "/cmd_vel"])
def test_through_a_fall_every_topic_is_fresher_with_arpd(topic, seed):
    """With arpd, p99 latency and p99 age are lower and loss is not higher than with rclpy's defaults."""
    without, managed = (
        next(result for result in play(STEP, STEP_S, way=way, seed=seed).topics if result.topic == topic)
        for way in (Way.WITHOUT, Way.ARPD)
    )
    assert managed.loss_ratio <= without.loss_ratio
    assert managed.latency_p99_s < without.latency_p99_s or without.loss_ratio > 0.01  # what never arrives has none
    assert managed.age_p99_s < without.age_p99_s


def test_commands_are_as_prompt_with_arpd_as_without():
    """Commands, whose direction is not overloaded, are not later and not lost."""
    commands = [play(STEP, STEP_S, way=way).topics[-1] for way in (Way.WITHOUT, Way.ARPD)]
    assert commands[1].lost == 0
    assert commands[1].latency_p99_s < commands[0].latency_p99_s + 0.005
    assert commands[1].age_p99_s < commands[0].age_p99_s + 0.06


@pytest.mark.parametrize("seed", SEEDS)
def test_a_fall_is_known_within_three_seconds_and_a_recovery_used_at_once(seed):
    """The estimate falls, and budget and payload rise, within seconds; shorter deadlines wait until a rise lasted."""
    result = play(STEP, STEP_S, seed=seed)
    assert right(between(result.moments, FALL_S + 3.0, RISE_S)) > 0.95
    after = between(result.moments, RISE_S, STEP_S)
    demand = 0.9 * goodput(result, 5.0, FALL_S)  # the link carried everything then
    assert first(after, lambda moment: moment.budget_bytes_per_second > 0.7 * 20 * MBIT) <= RISE_S + 3.0
    assert goodput(result, RISE_S + 2.0, RISE_S + 6.0) > demand
    last = result.moments[-1]
    assert last.confirmed == last.planned == len(demo_topics())
    assert [plan.cause for plan in plans(result) if plan.t_s > FALL_S] == ["down"]


@pytest.mark.parametrize("seed", SEEDS)
def test_the_oracle_is_a_bound_that_arpd_comes_near(seed):
    """The oracle builds the shorter queue at a fall; later arpd delivers more than 90 % of its bytes."""
    runs = [play(STEP, STEP_S, way=way, seed=seed) for way in (Way.ARPD, Way.ORACLE)]
    arpd_s, oracle_s = (max(moment.queue_delay_s for moment in between(run.moments, FALL_S, RISE_S)) for run in runs)
    assert oracle_s < arpd_s
    arpd, oracle = (goodput(run, FALL_S + 5.0, RISE_S) for run in runs)
    assert arpd > 0.9 * oracle


# -- a link that is gone


def test_an_outage_pauses_the_topics_and_makes_no_plan():
    """From 0.6 s of silence on they get a twentieth of the link at most, and no more later; they are not gone."""
    result = play("0:20mbit", OUTAGE_S, losses=outages(OUTAGE))
    silent = between(result.moments, OUTAGE[0] + 0.6, OUTAGE[1])
    assert all(moment.state is LinkState.OUTAGE for moment in silent)
    budgets = [moment.budget_bytes_per_second for moment in silent]
    assert budgets[0] <= 0.05 * 20 * MBIT
    assert budgets == sorted(budgets, reverse=True)
    assert not [plan for plan in plans(result) if OUTAGE[0] < plan.t_s < OUTAGE[1] + 1.0]


def test_after_an_outage_traffic_and_estimate_return():
    """Half of the link may be used 0.5 s after the outage, payload flows after 1 s, the estimate is right after 5 s."""
    result = play("0:20mbit", OUTAGE_S, losses=outages(OUTAGE))
    after = between(result.moments, OUTAGE[1], OUTAGE_S)
    assert first(after, lambda moment: moment.budget_bytes_per_second > 0.5 * 20 * MBIT) <= OUTAGE[1] + 0.5
    assert goodput(result, OUTAGE[1] + 1.0, OUTAGE_S) > 0.9 * goodput(result, 5.0, OUTAGE[0])
    assert right(between(result.moments, OUTAGE[1] + 5.0, OUTAGE_S)) > 0.95
    assert max(moment.queue_delay_s for moment in after) < 0.25
    assert result.moments[-1].confirmed == len(demo_topics())


def test_what_waited_out_a_standstill_is_no_evidence():
    """After a standstill, late reports do not lower the estimate for long, and no plan is made."""
    schedule = RateSchedule.parse("0:5mbit,22:80bit,37:5mbit")
    result = Scenario(demo_settings(), schedule, 42.0, seed=5).play()
    assert not [plan for plan in plans(result) if plan.t_s > 22.0]
    assert min(moment.estimate_bytes_per_second for moment in between(result.moments, 37.0, 42.0)) > 0.5 * 5 * MBIT
    assert right(between(result.moments, 40.0, 42.0)) > 0.8


def test_a_lossy_link_is_no_slow_link():
    """Resends repair random loss of 1 % of the packets, and it does not look like congestion."""
    result = play("0:20mbit", 25.0, loss=0.01)
    assert statistics.mean(errors(between(result.moments, 10.0, 25.0))) < 0.15
    assert max(topic.loss_ratio for topic in result.topics) < 0.02
    assert not [plan for plan in plans(result) if plan.cause == "down"]


# -- cross traffic


def flow(start_s, end_s, mbits):
    return (CrossFlow(start_s=start_s, end_s=end_s, rate_bytes_per_second=mbits * MBIT),)


UPLOAD_S, UPLOAD_END_S = 12.0, 30.0


@pytest.mark.parametrize(
    ("schedule", "duration_s", "more"),
    [
        ("0:20mbit", STEADY_S, {}),
        ("0:5mbit", STEADY_S, {}),
        *((STEP, STEP_S, {"seed": seed}) for seed in SEEDS),
        ("0:20mbit", OUTAGE_S, {"losses": outages(OUTAGE)}),
    ],
)
def test_what_is_arpds_own_is_no_cross_traffic(schedule, duration_s, more):
    """Alone on the link, less than 5 % counts as cross traffic, resends included."""
    moments = play(schedule, duration_s, **more).moments
    assert max(moment.cross_traffic_bytes_per_second / moment.truth_bytes_per_second for moment in moments) < 0.05


def test_an_outage_does_not_hide_cross_traffic():
    """It is known, and so keeps its room, through outages of 0.6 s every 5 s."""
    cuts = outages(*((20.0 + 5.0 * k, 20.6 + 5.0 * k) for k in range(3)))
    result = play("0:10mbit", 35.0, losses=cuts, cross_traffic=flow(5.0, 60.0, 4.0))
    seen = between(result.moments, 21.0, 35.0)
    assert min(moment.cross_traffic_bytes_per_second for moment in seen) > 0.7 * 4.0 * MBIT


def test_an_upload_gets_room_and_gives_it_back():
    """The budget makes room for 2 Mbit/s on a link of 5 within five seconds, and takes it back afterwards."""
    result = play("0:5mbit", 50.0, cross_traffic=flow(UPLOAD_S, UPLOAD_END_S, 2.0))
    beside = between(result.moments, UPLOAD_S + 5.0, UPLOAD_END_S)
    assert all(1.5 * MBIT < moment.cross_traffic_bytes_per_second < 2.4 * MBIT for moment in beside)
    budgets = [moment.budget_bytes_per_second for moment in beside]
    assert statistics.mean(budgets) + 2.0 * MBIT < 5.0 * MBIT
    assert beside[-1].level_bytes_per_second + 2.0 * MBIT < 1.02 * 5.0 * MBIT  # the estimate errs by as much
    assert statistics.median(moment.queue_delay_s for moment in beside) < 0.1
    assert max(moment.queue_delay_s for moment in beside) < 0.4
    after = between(result.moments, UPLOAD_END_S + 6.0, 50.0)
    assert max(moment.cross_traffic_bytes_per_second for moment in after) < 0.02 * 5.0 * MBIT
    # In one of ten seeds the estimate falls for a single moment, with any version of what else is played here.
    assert sorted(moment.budget_bytes_per_second for moment in after)[1] > 0.75 * 5.0 * MBIT
    causes = [plan.cause for plan in plans(result) if plan.t_s > 10.0]
    assert set(causes) == {"down"}
    assert len(causes) <= 2


def test_half_of_the_link_stays_the_robots():
    """A flow that would take everything gets at most half of what the plan is made for."""
    result = play("0:5mbit", 35.0, cross_traffic=flow(12.0, 35.0, 4.5))
    yielded = between(result.moments, 19.0, 35.0)
    assert max(moment.cross_traffic_bytes_per_second for moment in yielded) > 2.7 * MBIT
    assert min(moment.level_bytes_per_second for moment in yielded) > 0.9 * 0.85 * 0.5 * 5.0 * MBIT


# -- the simulation itself


def test_a_pinned_capacity_costs_no_probe_and_is_obeyed():
    """The plan is made for the pinned capacity, even if the link carries more."""
    result = play("0:20mbit", 8.0, link=LinkSettings(capacity_bytes_per_second=4 * MBIT))
    assert result.moments[-1].level_bytes_per_second == pytest.approx(0.85 * 4 * MBIT, rel=0.05)
    assert result.moments[-1].probe_bytes == 0


def test_nothing_is_created_or_forgotten():
    """Every offered sample is withheld, sent or the last one waiting; every sent sample arrives or is lost."""
    for way in (Way.WITHOUT, Way.ARPD):
        for topic in play(STEP, STEP_S, way=way).topics:
            assert 0 <= topic.offered - topic.withheld - topic.sent <= 1
            assert topic.received + topic.lost == topic.sent
            assert topic.doubled == 0


@pytest.mark.parametrize("mbit", [20, 1000])
def test_a_link_at_rest_carries_few_probes(mbit):
    """While no topic crosses, probes take 8 kB/s at most in the first half minute, and then less than one."""
    quiet = tuple(replace(topic, direction=Direction.LOCAL) for topic in demo_topics())
    resting = Scenario(demo_settings(), RateSchedule.parse(f"0:{mbit}mbit"), 60.0, topics=quiet).play()
    spent = {t_s: next(moment.probe_bytes for moment in resting.moments if moment.t_s >= t_s) for t_s in (5, 30, 55)}
    assert spent[30] - spent[5] < 25 * 8000
    assert spent[55] - spent[30] < 25 * 1000
