"""One scenario three ways, with arpd, without it and with an oracle, and the summary of a run."""

from functools import cache

from arpd.daemon.compare import LinkEvent, compare, events, summarize
from arpd.daemon.scenario import Moment, ScenarioResult
from arpd.model.endpoints import Direction
from arpd.model.link import LinkState
from arpd.model.settings import RelaySettings, RelayTopic, Settings, TopicSettings
from arpd.sim.link import LinkModel
from arpd.sim.robot import SimTopic, configured_topics
from arpd.sim.schedule import RateSchedule

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
    """Link and application are the same three ways; without arpd it stands inside publish() now and then."""
    runs = list(falling().values())
    for other in runs[1:]:
        assert [m.truth_bytes_per_second for m in other.moments] == [m.truth_bytes_per_second for m in runs[0].moments]
        assert [(topic.topic, topic.expected) for topic in other.topics] == [
            (topic.topic, topic.expected) for topic in runs[0].topics
        ]


def test_the_oracle_is_a_bound_that_arpd_comes_near():
    """The oracle builds the shorter queue at a fall; later arpd delivers more than 85 % of its bytes."""
    arpd, oracle = (summarize(falling()[way], start_s=10.0, end_s=30.0) for way in ("arpd", "oracle"))
    assert oracle.queue_peak_s < arpd.queue_peak_s
    settled = [summarize(falling()[way], start_s=22.0, end_s=30.0) for way in ("arpd", "oracle")]
    assert settled[0].goodput_bytes_per_second > 0.85 * settled[1].goodput_bytes_per_second


def test_without_arpd_there_is_no_belief_no_plan_and_a_full_queue():
    """Without arpd there is no estimate, plan, swap or probe, and the queue fills."""
    without = falling()["without"]
    summary = summarize(without, start_s=10.0, end_s=30.0)
    assert summary.error_median is None
    assert summary.plans_per_minute == summary.swaps_per_minute == summary.measuring_share == 0.0
    assert summary.queue_peak_s > 0.8 * LinkModel().queue_bytes / (2 * MBIT)
    assert events(without) == ()


# -- the robot of a configuration


def test_a_configuration_describes_a_robot():
    """The robot has the topics with a configured rate; relayed topics keep the application's name."""
    settings = Settings(
        relay=RelaySettings(topics=(RelayTopic(name="/scan"), RelayTopic(name="/unknown")), prefix="/air"),
        topics=(
            TopicSettings(name="/air/scan", payload_bytes=5828.0, source_rate_hz=20.0),
            TopicSettings(name="/camera", payload_bytes=30_000.4, source_rate_hz=30.0),
            TopicSettings(name="/cmd_vel", payload_bytes=0.2, source_rate_hz=10.0),
            TopicSettings(name="/no_rate", payload_bytes=100.0),
            TopicSettings(name="/silent", payload_bytes=100.0, source_rate_hz=0.0),
        ),
    )
    assert configured_topics(settings, actuation=("/cmd_vel",)) == (
        SimTopic(name="/scan", payload_bytes=5828, rate_hz=20.0, prefix="/air"),
        SimTopic(name="/camera", payload_bytes=30_000, rate_hz=30.0),
        SimTopic(name="/cmd_vel", payload_bytes=1, rate_hz=10.0, direction=Direction.ACTUATION),
    )


# -- sums


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
