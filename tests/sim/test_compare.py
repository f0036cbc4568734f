"""One scenario with arpd and with an oracle."""

from arpd.daemon.scenario import Scenario, Way
from arpd.daemon.summary import summarize
from arpd.model.settings import Settings
from arpd.sim.robot import SimTopic
from arpd.sim.schedule import RateSchedule

ROBOT = (
    SimTopic(name="/camera", payload_bytes=20_000, rate_hz=30.0, prefix="/link"),
    SimTopic(name="/scan", payload_bytes=5_000, rate_hz=20.0),
)


def test_the_oracle_is_a_bound_that_arpd_comes_near():
    """The oracle builds the shorter queue at a fall; later arpd delivers more than 85 % of its bytes."""
    schedule = RateSchedule.parse("0:8mbit,15:2mbit")
    runs = [Scenario(Settings(), schedule, 30.0, topics=ROBOT, way=way).play() for way in (Way.ARPD, Way.ORACLE)]
    arpd, oracle = (summarize(run, start_s=10.0, end_s=30.0) for run in runs)
    assert oracle.queue_peak_s < arpd.queue_peak_s
    settled = [summarize(run, start_s=22.0, end_s=30.0) for run in runs]
    assert settled[0].goodput_bytes_per_second > 0.85 * settled[1].goodput_bytes_per_second
