"""One scenario three ways, with arpd, without it and with an oracle, and the summary of a run."""

from dataclasses import replace
from functools import cache

import pytest

from arpd.adapters.sim.baselines import Oracle
from arpd.adapters.sim.foreign import ForeignFlow
from arpd.adapters.sim.link import LinkModel
from arpd.adapters.sim.robot import SimTopic, configured_topics
from arpd.adapters.sim.schedule import RateSchedule, RateStep
from arpd.daemon.compare import LinkEvent, between, compare, estimate_error, events, summarize
from arpd.daemon.scenario import Moment, ScenarioResult, run
from arpd.model.endpoints import Direction
from arpd.model.link import LinkState
from arpd.model.settings import RelaySettings, Settings, TopicSettings

MBIT = 125_000.0
FALL = "0:8mbit,15:2mbit"
ROBOT = (
    SimTopic(name="/camera", payload_bytes=20_000, rate_hz=30.0, prefix="/link"),
    SimTopic(name="/scan", payload_bytes=5_000, rate_hz=20.0),
    SimTopic(name="/cmd_vel", payload_bytes=80, rate_hz=10.0, direction=Direction.ACTUATION),
)


@cache
def falling():
    return compare(Settings(), RateSchedule.parse(FALL), 30.0, seed=1, model=LinkModel(), topics=ROBOT)


def course(*moments):
    return ScenarioResult(topics=(), moments=moments)


def moment(t_s, **more):
    return Moment(t_s=t_s, truth_bytes_per_second=1000.0, queue_delay_s=0.0, **more)


# -- three ways


def test_all_three_ways_see_the_same_link_and_the_same_robot():
    """Link and offered samples are the same three ways."""
    runs = list(falling().ways.values())
    for other in runs[1:]:
        assert [m.truth_bytes_per_second for m in other.moments] == [m.truth_bytes_per_second for m in runs[0].moments]
        assert [(topic.topic, topic.offered) for topic in other.topics] == [
            (topic.topic, topic.offered) for topic in runs[0].topics
        ]


def test_the_oracle_is_never_wrong_and_never_measures():
    """The oracle's estimate is the link's rate except around a step, and it sends no probes."""
    oracle = falling().oracle
    wrong = [m.t_s for m in oracle.moments if m.t_s > 1.0 and estimate_error(m) > 1e-9]
    assert all(14.8 < t_s < 15.2 for t_s in wrong)
    assert oracle.moments[-1].probe_bytes == 0


def test_the_oracle_is_a_bound_that_arpd_comes_near():
    """The oracle builds the shorter queue at a fall; later arpd delivers more than 85 % of its bytes."""
    arpd, oracle = (summarize(falling().ways[way], start_s=10.0, end_s=30.0) for way in ("arpd", "oracle"))
    assert oracle.queue_peak_s < arpd.queue_peak_s
    settled = [summarize(falling().ways[way], start_s=22.0, end_s=30.0) for way in ("arpd", "oracle")]
    assert settled[0].goodput_bytes_per_second > 0.85 * settled[1].goodput_bytes_per_second


def test_without_arpd_there_is_no_belief_no_plan_and_a_full_queue():
    """Without arpd there is no estimate, plan, swap or probe, and the queue fills."""
    without = falling().without
    summary = summarize(without, start_s=10.0, end_s=30.0)
    assert summary.error_median is None
    assert summary.plans_per_minute == summary.swaps_per_minute == summary.measuring_share == 0.0
    assert summary.queue_peak_s > 0.9 * LinkModel().queue_bytes / (2 * MBIT)
    assert events(without) == ()


def test_a_fall_is_among_the_events():
    """A fall is an event with the levels before and after it."""
    fall = next(event for event in events(falling().arpd) if event.what == "down")
    assert 15.0 < fall.t_s < 20.0
    assert fall.before_bytes_per_second > 3 * fall.after_bytes_per_second > 0


def test_it_is_told_which_way_runs():
    """The callback gets the name of each way before its run."""
    told = []
    compare(Settings(), RateSchedule.parse("0:8mbit"), 1.0, seed=1, model=LinkModel(), topics=ROBOT, on_way=told.append)
    assert told == ["arpd", "without", "oracle"]


# -- arguments of a run


def played(schedule="0:8mbit", duration_s=8.0, **more):
    if isinstance(schedule, str):
        schedule = RateSchedule.parse(schedule)
    return run(Settings(), schedule, duration_s, seed=1, managed=True, topics=ROBOT, **more)


def test_an_oracle_knows_what_else_is_on_the_link():
    """The oracle reports cross traffic while it flows."""
    flow = ForeignFlow(start_s=3.0, end_s=5.0, rate_bytes_per_second=1.0 * MBIT)
    result = played(foreign=(flow,), make_estimator=Oracle)
    told = {m.t_s: m.cross_traffic_bytes_per_second for m in result.moments}
    assert (told[2.5], told[4.0], told[6.0]) == pytest.approx((0.0, 1.0 * MBIT, 0.0))


@pytest.mark.parametrize("is_stalled", [False, True])
def test_an_oracle_knows_an_outage(is_stalled):
    """The oracle reports an outage when all packets are lost and when the rate is zero."""
    stalled = RateSchedule(
        steps=tuple(
            RateStep(start_s=at_s, rate_bytes_per_second=rate * MBIT) for at_s, rate in ((0, 8), (5, 0), (6, 8))
        )
    )
    result = (
        played(stalled, make_estimator=Oracle)
        if is_stalled
        else played(make_estimator=Oracle, model=LinkModel(outages=((5.0, 6.0),)))
    )
    states = {m.t_s: m.state for m in result.moments}
    assert states[5.5] is LinkState.OUTAGE
    assert states[4.5] is states[6.5] is LinkState.STEADY


def test_an_oracle_knows_what_a_packet_costs_on_a_busy_link():
    """On a busy link an aggregate shares one overhead."""
    model = LinkModel(packet_overhead_s=200e-6, aggregate_packets=8)
    assert played(model=model, make_estimator=Oracle).moments[-1].packet_overhead_s == 25e-6


def test_a_rate_that_changes_faster_than_anybody_looks_is_shown_in_the_mean():
    """Moments show the mean of a rate that changes every 20 ms."""
    jagged = RateSchedule(
        steps=tuple(RateStep(start_s=k * 0.02, rate_bytes_per_second=(k % 2) * 16 * MBIT) for k in range(600))
    )
    truths = [m.truth_bytes_per_second for m in played(jagged).moments]
    # Two or three of the five spans of 20 ms in a tenth of a second carry bytes.
    assert min(truths) == pytest.approx(6.4 * MBIT)
    assert max(truths) == pytest.approx(9.6 * MBIT)
    assert sum(truths) / len(truths) == pytest.approx(8 * MBIT)


def test_what_is_counted_never_falls():
    """Counts of bytes and swaps never fall, and with arpd all of them grow."""
    moments = falling().arpd.moments
    for name in ("delivered_bytes", "probe_bytes", "report_bytes", "swaps"):
        counts = [getattr(m, name) for m in moments]
        assert counts == sorted(counts)
        assert counts[-1] > 0


def test_topics_have_the_applications_names():
    """The results name relayed and other topics as the application does."""
    assert {topic.topic for topic in falling().oracle.topics} == {topic.name for topic in ROBOT}


# -- the robot of a configuration


def test_a_configuration_describes_a_robot():
    """The robot has the topics with a configured rate; relayed topics keep the application's name."""
    settings = Settings(
        relay=RelaySettings(topics=("/scan", "/unknown"), prefix="/air"),
        topics={
            "/air/scan": TopicSettings(payload_bytes=5828.0, source_rate_hz=20.0),
            "/camera": TopicSettings(payload_bytes=30_000.4, source_rate_hz=30.0),
            "/cmd_vel": TopicSettings(payload_bytes=0.2, source_rate_hz=10.0),
            "/no_rate": TopicSettings(payload_bytes=100.0),
            "/silent": TopicSettings(payload_bytes=100.0, source_rate_hz=0.0),
        },
    )
    assert configured_topics(settings, actuation=("/cmd_vel",)) == (
        SimTopic(name="/scan", payload_bytes=5828, rate_hz=20.0, prefix="/air"),
        SimTopic(name="/camera", payload_bytes=30_000, rate_hz=30.0),
        SimTopic(name="/cmd_vel", payload_bytes=1, rate_hz=10.0, direction=Direction.ACTUATION),
    )


def test_two_ends_of_a_relay_rename_nothing():
    """The topics of a relay with two ends have the robot's names on the link."""
    settings = Settings(
        relay=RelaySettings(topics=("/scan",), link_domain=77, ceddp="10.0.0.2"),
        topics={"/scan": TopicSettings(payload_bytes=5828.0, source_rate_hz=20.0)},
    )
    assert configured_topics(settings, actuation=()) == (SimTopic(name="/scan", payload_bytes=5828, rate_hz=20.0),)


# -- sums


def test_a_summary_is_of_its_span():
    """A summary counts only what happens in its span."""
    believed = {"estimate_bytes_per_second": 1100.0, "level_bytes_per_second": 900.0, "generation": 1}
    result = course(
        moment(0.0, delivered_bytes=5, swaps=3, probe_bytes=7, report_bytes=1, cause="start", **believed),
        moment(10.0, delivered_bytes=100, swaps=4, probe_bytes=10, report_bytes=2, cause="up", **believed),
        replace(moment(20.0, delivered_bytes=600, swaps=6, cause="down", **believed), queue_delay_s=0.5),
        moment(30.0, delivered_bytes=1100, swaps=8, probe_bytes=100, report_bytes=112, **believed),
        moment(40.0, delivered_bytes=9999, swaps=99, probe_bytes=999, **believed),
    )
    summary = summarize(result, start_s=10.0, end_s=40.0)
    assert summary.goodput_bytes_per_second == 50.0
    assert summary.queue_peak_s == summary.queue_p99_s == 0.5
    assert summary.error_median == summary.error_p90 == pytest.approx(0.1)
    assert summary.plans_per_minute == pytest.approx(4.0)
    assert summary.swaps_per_minute == 12.0
    assert summary.measuring_share == pytest.approx(200 / 20_000)


def test_a_link_that_is_not_there_has_no_error():
    """While the rate is zero there is no error of the estimate and no share of measuring."""
    stalled = replace(moment(0.0, estimate_bytes_per_second=5.0), truth_bytes_per_second=0.0)
    assert estimate_error(stalled) is None
    summary = summarize(course(stalled, replace(stalled, t_s=1.0)), start_s=0.0, end_s=2.0)
    assert summary.error_median is None
    assert summary.measuring_share == 0.0


def test_events_are_plans_and_outages():
    """Events are plans, the first without a level before it, and begins and ends of outages."""
    planned = {"level_bytes_per_second": 900.0, "generation": 1}
    found = events(
        course(
            moment(0.0, level_bytes_per_second=0.0),
            moment(1.0, cause="start", **planned),
            moment(2.0, state=LinkState.OUTAGE, **planned),
            moment(3.0, state=LinkState.OUTAGE, **planned),
            moment(4.0, state=LinkState.STEADY, cause="down", level_bytes_per_second=400.0, generation=2),
        )
    )
    assert found == (
        LinkEvent(t_s=1.0, what="start", before_bytes_per_second=None, after_bytes_per_second=900.0),
        LinkEvent(t_s=2.0, what="outage"),
        LinkEvent(t_s=4.0, what="outage over"),
        LinkEvent(t_s=4.0, what="down", before_bytes_per_second=900.0, after_bytes_per_second=400.0),
    )


def test_a_span_includes_its_start_and_not_its_end():
    """A span includes its start and excludes its end, so that adjacent spans count every moment once."""
    moments = [moment(float(t_s)) for t_s in range(5)]
    assert [m.t_s for m in between(moments, 1.0, 3.0)] == [1.0, 2.0]
