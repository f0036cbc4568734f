"""One scenario with arpd and with an oracle, and the events of a run."""

from arpd.daemon.compare import LinkEvent, compare, events, summarize
from arpd.daemon.scenario import Moment, ScenarioResult
from arpd.model.link import LinkState
from arpd.model.settings import Settings
from arpd.sim.link import LinkModel
from arpd.sim.robot import SimTopic
from arpd.sim.schedule import RateSchedule

ROBOT = (
    SimTopic(name="/camera", payload_bytes=20_000, rate_hz=30.0, prefix="/link"),
    SimTopic(name="/scan", payload_bytes=5_000, rate_hz=20.0),
)


def test_the_oracle_is_a_bound_that_arpd_comes_near():
    """The oracle builds the shorter queue at a fall; later arpd delivers more than 85 % of its bytes."""
    schedule = RateSchedule.parse("0:8mbit,15:2mbit")
    ways = compare(Settings(), schedule, 30.0, seed=1, model=LinkModel(), topics=ROBOT)
    arpd, oracle = (summarize(ways[way], start_s=10.0, end_s=30.0) for way in ("arpd", "oracle"))
    assert oracle.queue_peak_s < arpd.queue_peak_s
    settled = [summarize(ways[way], start_s=22.0, end_s=30.0) for way in ("arpd", "oracle")]
    assert settled[0].goodput_bytes_per_second > 0.85 * settled[1].goodput_bytes_per_second


def moment(t_s, **more):
    return Moment(t_s=t_s, truth_bytes_per_second=1000.0, queue_delay_s=0.0, **more)


def test_events_are_plans_and_outages():
    """Events are plans, the first without a level before it, and begins and ends of outages."""
    planned = {"level_bytes_per_second": 900.0, "generation": 1}
    moments = (
        moment(0.0, level_bytes_per_second=0.0),
        moment(1.0, cause="start", **planned),
        moment(2.0, state=LinkState.OUTAGE, **planned),
        moment(3.0, state=LinkState.OUTAGE, **planned),
        moment(4.0, state=LinkState.STEADY, cause="down", level_bytes_per_second=400.0, generation=2),
    )
    assert events(ScenarioResult(topics=(), moments=moments)) == (
        LinkEvent(t_s=1.0, what="start", before_bytes_per_second=None, after_bytes_per_second=900.0),
        LinkEvent(t_s=2.0, what="outage"),
        LinkEvent(t_s=4.0, what="outage over"),
        LinkEvent(t_s=4.0, what="down", before_bytes_per_second=900.0, after_bytes_per_second=400.0),
    )
