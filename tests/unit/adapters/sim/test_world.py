"""The world of a simulated run: what the daemon is shown of a link whose truth is known."""

from __future__ import annotations

import pytest

from arpd.adapters.sim.baselines import Oracle
from arpd.adapters.sim.demo import demo_settings, demo_topics
from arpd.adapters.sim.foreign import ForeignFlow
from arpd.adapters.sim.link import LinkModel
from arpd.adapters.sim.robot import SimTopic
from arpd.adapters.sim.schedule import RateSchedule
from arpd.daemon.scenario import run
from arpd.model.endpoints import Direction

MBIT = 125_000.0
RUN_STARTS_S = 1000.0
MAP = SimTopic(name="/map", payload_bytes=2_000_000, rate_hz=2.0, direction=Direction.LOCAL)


class Watching(Oracle):
    """An oracle that keeps what it is shown."""

    def __init__(self, truth):
        super().__init__(truth)
        self.observations = []
        self.truths = {}

    def update(self, observation):
        self.observations.append(observation)
        self.truths[observation.now_s - RUN_STARTS_S] = self._truth()
        return super().update(observation)


def watch(duration_s=4.0, rate="0:20mbit", **more):
    """Run the demo robot under a watching oracle; return it and the result."""
    watching = []

    def make(truth):
        watching.append(Watching(truth))
        return watching[-1]

    schedule = RateSchedule.parse(rate)
    result = run(demo_settings(), schedule, duration_s, seed=1, managed=True, make_estimator=make, **more)
    return watching[0], result


def test_the_bound_knows_the_mean_of_the_next_fifth_of_a_second():
    """Just before a fall the truth is between both rates, and 0.2 s before it still the old one."""
    oracle, _ = watch(rate="0:20mbit,3:5mbit")
    for t_s, truth in oracle.truths.items():
        ahead = min(1.0, max(0.0, (3.0 - t_s) / 0.2))
        assert truth.capacity_bytes_per_second == pytest.approx((5.0 + 15.0 * ahead) * MBIT)
    assert any(0.0 < 3.0 - t_s < 0.2 for t_s in oracle.truths)


def test_the_bound_knows_cross_traffic_and_delivery():
    """Cross traffic is averaged as the rate is, and the delivery is what has arrived lately."""
    upload = ForeignFlow(start_s=2.0, end_s=3.0, rate_bytes_per_second=8.0 * MBIT)
    oracle, _ = watch(foreign=(upload,), topics=(demo_topics()[-1],))
    for t_s, truth in oracle.truths.items():
        if 2.0 <= t_s <= 2.8:
            assert truth.cross_traffic_bytes_per_second == pytest.approx(8.0 * MBIT)
        if 2.3 <= t_s <= 2.9:
            assert truth.delivered_bytes_per_second == pytest.approx(8.0 * MBIT, rel=0.1)
        if not 1.8 <= t_s <= 3.0:
            assert truth.cross_traffic_bytes_per_second == 0.0


def test_a_download_of_the_peer_is_in_its_reports_and_not_on_the_link():
    """The peer's interface receives 40 Mbit/s more, in full packets, and the link carries the same as without."""
    download = ForeignFlow(start_s=1.0, end_s=3.0, rate_bytes_per_second=40.0 * MBIT)
    oracle, result = watch(into_peer=(download,))
    quiet_oracle, quiet = watch()

    def reported(watching):
        reports = [report for observation in watching.observations for report in observation.reports]
        return sum(report.rx_bytes for report in reports), sum(report.rx_packets for report in reports)

    (more_bytes, more_packets), (fewer_bytes, fewer_packets) = reported(oracle), reported(quiet_oracle)
    assert more_bytes - fewer_bytes == pytest.approx(80.0 * MBIT, rel=0.01)
    assert more_packets - fewer_packets == pytest.approx(80.0 * MBIT / 1514, rel=0.01)
    assert [moment.carried_bytes for moment in result.moments] == pytest.approx(
        [moment.carried_bytes for moment in quiet.moments], abs=20_000
    )


def test_a_local_topic_is_announced_and_never_on_the_link():
    """Its reader on the robot receives every sample; the announcement names no remote reader, and no plan has it."""
    oracle, result = watch(topics=(*demo_topics(), MAP))
    announced = [state for state in oracle.observations[-1].publishers if state.topic == "/map"]
    assert [(state.direction, state.remote_readers, state.payload_bytes) for state in announced] == [
        (Direction.LOCAL, 0, 2e6)
    ]
    assert result.moments[-1].planned == len(demo_topics())
    local = next(topic for topic in result.topics if topic.topic == "/map")
    assert local.received == local.offered > 0
    _, without = watch()
    assert result.moments[-1].carried_bytes == pytest.approx(without.moments[-1].carried_bytes, rel=0.01)
    assert result.moments[-1].delivered_bytes == pytest.approx(without.moments[-1].delivered_bytes, rel=0.01)


def test_a_local_topic_allows_no_queue_on_the_link():
    """The bound's allowance for one large message is that of a message on the link."""
    schedule = RateSchedule.parse("0:5mbit")
    allowances: list[float] = []

    class Noting(Oracle):
        def update(self, observation):
            link = super().update(observation)
            allowances[-1] = link.queue_allowance_s
            return link

    for topics in (demo_topics(), (*demo_topics(), MAP)):
        allowances.append(0.0)
        run(demo_settings(), schedule, 3.0, seed=1, managed=True, topics=topics, make_estimator=Noting)
    assert allowances[0] == allowances[1] > 0.0


def test_without_a_peer_probes_go_nowhere_and_no_report_comes():
    """The graph shows no peer, no report ever arrives, and the robot's traffic does."""
    oracle, result = watch(has_peer=False)
    assert not any(observation.reports for observation in oracle.observations)
    assert {observation.peers for observation in oracle.observations} == {0}
    assert result.moments[-1].report_bytes == 0
    assert result.moments[-1].delivered_bytes > 0
    alone = run(demo_settings(), RateSchedule.parse("0:20mbit"), 4.0, seed=1, managed=True, has_peer=False)
    assert alone.moments[-1].probe_bytes > 0
    assert alone.moments[-1].report_bytes == 0


def test_both_directions_have_a_rate_of_their_own():
    """A slow way back delays commands, and not the sensors."""
    schedule, slow = RateSchedule.parse("0:20mbit"), RateSchedule.parse("0:20kbit")
    command, sensor = demo_topics()[0], demo_topics()[-1]
    assert command.direction is Direction.ACTUATION
    assert sensor.direction is Direction.SENSING

    def latencies(**more):
        played = run(demo_settings(), schedule, 5.0, seed=1, managed=False, topics=(command, sensor), **more)
        return [topic.latency_p50_s for topic in played.topics]

    (usual, sensed), (late, also_sensed) = latencies(), latencies(down=slow)
    assert late > 10 * usual
    assert also_sensed == sensed


def test_a_moment_shows_the_budget_and_the_wire_bytes_so_far():
    """The budget is what the allocation of that tick divides, and the bytes are those at the far interface."""
    _, result = watch(model=LinkModel())
    last, before = result.moments[-1], result.moments[-11]
    assert last.budget_bytes_per_second == pytest.approx(0.85 * 20 * MBIT, rel=0.01)
    assert last.carried_bytes > last.delivered_bytes > 0
    assert 0 < last.carried_bytes - before.carried_bytes < 20 * MBIT
