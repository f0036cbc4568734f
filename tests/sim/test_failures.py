"""Failures around a daemon that governs, in virtual time."""

from dataclasses import replace

import pytest

from arpd.daemon import scenario
from arpd.model.endpoints import Direction
from arpd.model.link import LinkState
from arpd.model.settings import DefaultPreferences, ProgramSettings, Settings
from arpd.sim import world
from arpd.sim.result import SimTopic
from arpd.sim.schedule import RateSchedule
from tests.sim.watched import watch

LASTS_S = 25.0  # the sources end then
TOPICS = (
    SimTopic(name="/points", payload_bytes=5800, rate_hz=20.0),
    SimTopic(name="/odom", payload_bytes=730, rate_hz=20.0),
    SimTopic(name="/cmd_vel", payload_bytes=80, rate_hz=10.0, direction=Direction.ACTUATION),
)


def play(*, link="0:20mbit", duration_s=LASTS_S, settings=None, **options):
    """Play the robot with failures; `tests.sim.watched.watch` explains the options."""
    return watch(settings or Settings(), RateSchedule.parse(link), duration_s, topics=TOPICS, **options)


def settled(played):
    """Return whether all publishers confirm the last plan."""
    last = played.result.moments[-1]
    return last.planned == last.confirmed == len(TOPICS)


def test_a_dead_daemon_leaves_its_price_and_its_plan_in_force():
    """After a fall the daemon dies; the topics go on at its last rates on whatever link, and no queue builds up."""
    dies_s = 14.0
    played = play(link="0:20mbit,8:0.5mbit,20:20mbit", mute_s=dies_s, duration_s=30.0)
    rows = played.between(0.0, dies_s)[-1].decision.plan.topics
    sent = played.between(dies_s - 0.5, dies_s)  # perhaps without the last
    prices = [tick.snapshot.allocation.price for tick in sent]
    for topic, row in rows.items():
        source_hz = next(t.rate_hz for t in TOPICS if t.name == topic)
        allowed_hz = [min(source_hz, price.rate_hz(row)) for price in prices]
        assert 0.9 * min(allowed_hz) < played.sent_hz(topic, dies_s + 2.0, 30.0) < 1.1 * max(allowed_hz)
    assert prices[-1].rate_hz(rows["/points"]) < 0.7 * 20.0
    assert max(moment.queue_delay_s for moment in played.result.moments if moment.t_s > dies_s + 4.0) < 0.3
    assert {moment.confirmed for moment in played.result.moments if moment.t_s > dies_s + 2.0} == {len(TOPICS)}


# -- the network


def test_a_partition_of_the_graph_makes_no_plan():
    """If all remote readers vanish and return one after the other, no plan is made."""
    back_s = {"/points": 21.0, "/odom": 21.6, "/cmd_vel": 22.2}

    def see(t_s, seen):
        return replace(
            seen,
            publishers=tuple(
                replace(p, direction=Direction.LOCAL, remote_readers=0) if 14.0 <= t_s < back_s[p.topic] else p
                for p in seen.publishers
            ),
        )

    played = play(see=see)
    assert played.plans(13.0, LASTS_S) == []
    assert settled(played)


def test_a_peer_that_is_gone_and_back_leaves_the_plan_in_force():
    """While other hosts answer, the peer's silence is no outage: nobody is slowed, and the plan stays."""

    def see(t_s, seen):
        return replace(seen, reports=()) if 8.0 <= t_s < 22.0 else seen

    played = play(see=see, duration_s=28.0)
    silent = played.between(9.0, 22.0)
    assert {tick.snapshot.link.state for tick in silent} <= {LinkState.APP_LIMITED, LinkState.STEADY}
    assert {tick.decision.allowed for tick in silent} == {1.0}
    assert played.plans(8.0, 28.0) == []
    assert settled(played)


@pytest.mark.parametrize(("others_hz", "is_over"), [(0.2, False), (1.0, True)])
def test_a_silence_nobody_breaks_is_an_outage_until_somebody_is_heard(others_hz, is_over):
    """The topics are cut at once; after ten seconds they flow again only if another host on the far side answers."""
    heard = []

    def see(t_s, seen):
        if not 8.0 <= t_s < 24.0:
            return seen
        heard.append(seen.counters.rx_packets)
        counters = replace(seen.counters, rx_packets=heard[0] + int(others_hz * (t_s - 8.0)))
        return replace(seen, reports=(), counters=counters)

    played = play(see=see, duration_s=30.0)
    first, last = played.between(9.0, 10.0), played.between(22.0, 24.0)
    assert {tick.snapshot.link.state for tick in first} == {LinkState.OUTAGE}
    assert max(tick.decision.allowed for tick in first) < 0.5
    assert {tick.snapshot.link.state is LinkState.OUTAGE for tick in last} == {not is_over}
    assert {tick.decision.allowed for tick in last} == {1.0 if is_over else 0.0}
    assert LinkState.OUTAGE not in {tick.snapshot.link.state for tick in played.between(26.0, 30.0)}
    assert len(played.plans(8.0, 30.0)) <= 1
    assert settled(played)


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_a_step_of_a_clock_is_no_queue_no_outage_and_no_plan(monkeypatch, step_s):
    """A step of the peer's or of this host's clock slows no topic, and makes no queue, outage or plan."""
    peer_s, unix_s = world._PEER_CLOCK_S, scenario._UNIX_S

    def step(t_s, seen):
        if t_s >= 10.0:
            monkeypatch.setattr(world, "_PEER_CLOCK_S", peer_s + step_s)
            monkeypatch.setattr(scenario, "_UNIX_S", unix_s - step_s)
        return seen

    undisturbed, played = (play(see=see, duration_s=20.0).between(10.0, 20.0) for see in (None, step))
    assert played[-1].snapshot.unix_time_s == pytest.approx(undisturbed[-1].snapshot.unix_time_s - step_s, abs=1.0)
    assert {tick.decision.allowed for tick in played} == {1.0}
    assert LinkState.OUTAGE not in {tick.snapshot.link.state for tick in played}
    usual_s, most_s = (max(tick.snapshot.link.queue_delay_s for tick in run) for run in (undisturbed, played))
    assert most_s < usual_s + 0.05
    assert not [tick.decision.reason for tick in played if tick.decision.reason]


# -- memory

MIB = 2.0**20
RESERVE = 128 * MIB
DEEP = Settings(
    program=ProgramSettings(memory_reserve_bytes=RESERVE),
    defaults=DefaultPreferences(latency_budget_s=100.0),  # histories of several MiB
)


def memory(available):
    """Return a `see` for `play` with this much memory available, a function of run time (bytes)."""
    return lambda t_s, seen: replace(seen, memory=replace(seen.memory, available_bytes=available(t_s)))


def planned_bytes(decision, publishers):
    return sum((700 + 1.3 * p.payload_bytes) * decision.plan.topics[p.topic].depth for p in publishers)


def test_depths_fall_as_soon_as_memory_does():
    """The plan asks for less memory at the next turn, and a writer swap brings it into force."""
    fall_s = 14.0
    played = play(
        settings=DEEP, see=memory(lambda t_s: 512 * MIB if t_s < fall_s else RESERVE + MIB / 2), duration_s=22.0
    )
    publishers = played.ticks[-1].snapshot.observation.publishers
    before = played.between(0.0, fall_s)[-1].decision
    asked = next(tick for tick in played.ticks if tick.decision.reason == "memory")
    assert planned_bytes(before, publishers) > 1.5 * MIB
    assert planned_bytes(asked.decision, publishers) <= MIB
    assert asked.t_s - fall_s < 0.6
    assert settled(played)
    assert {p.topic: p.depth for p in publishers} == {
        name: row.depth for name, row in asked.decision.plan.topics.items()
    }
    assert played.plans(fall_s, 22.0) == ["memory"]
    rates = [{name: row.rate_hz for name, row in made.plan.topics.items()} for made in (before, asked.decision)]
    assert rates[0] == rates[1]  # the link has not changed
    assert not any(topic.lost for topic in played.result.topics)


def test_memory_that_swings_is_not_followed_upwards():
    """Memory that returns for seconds makes no plan; memory that stays makes one after half a minute."""

    def available(t_s):
        if t_s < 14.0 or t_s >= 40.0:
            return 512 * MIB
        return RESERVE + (1 if int(t_s / 4) % 2 else 30) * MIB

    played = play(settings=DEEP, see=memory(available), duration_s=80.0)
    assert played.plans(14.0, 40.0) == ["memory"]
    risen_s = [tick.t_s for tick in played.between(40.0, 80.0) if tick.decision.reason == "up"]
    assert risen_s == [pytest.approx(70.0, abs=4.5)]
