"""Failures around a daemon that governs, in virtual time."""

from __future__ import annotations

from dataclasses import replace

import pytest

from arpd.adapters.sim import world
from arpd.adapters.sim.link import LinkModel
from arpd.adapters.sim.robot import SimTopic
from arpd.adapters.sim.schedule import RateSchedule
from arpd.daemon import scenario
from arpd.daemon.tick import Daemon
from arpd.model.endpoints import Direction
from arpd.model.link import LinkState
from arpd.model.settings import ProgramSettings, Settings, TopicSettings

LASTS_S = 25.0
STARTS_S = 1000.0  # of the sensors, on the clock of the daemon
TOPICS = (
    SimTopic(name="/points", payload_bytes=5800, rate_hz=20.0),
    SimTopic(name="/odom", payload_bytes=730, rate_hz=20.0),
    SimTopic(name="/cmd_vel", payload_bytes=80, rate_hz=10.0, direction=Direction.ACTUATION),
)


@pytest.fixture
def play(monkeypatch):
    """Return a function that plays the robot with failures and returns the result and the daemon."""

    def play(*, do=None, see=None, link="0:20mbit", duration_s=LASTS_S, settings=None, model=None, seed=1):
        """Play.

        Parameters
        ----------
        do : run time (s) → called with the daemon at that time
        see : changes the daemon's observation, given the run time (s)
        """
        orders = sorted((do or {}).items())
        seen = []

        class Watched(Daemon):
            def __init__(self, *arguments, **options):
                super().__init__(*arguments, **options)
                seen.append(self)
                self.decisions, self.queues_s = [], []

            def tick(self, now_s):
                while orders and now_s >= STARTS_S + orders[0][0]:
                    orders.pop(0)[1](self)
                self.decisions.append((now_s - STARTS_S, super().tick(now_s)))
                self.queues_s.append(self.snapshot.link.queue_delay_s)
                return self.decisions[-1][1]

        class Seen(world.SimulatedWorld):
            def observe(self, now_s):
                observation = super().observe(now_s)
                return observation if see is None else see(now_s - STARTS_S, observation)

        monkeypatch.setattr(scenario, "Daemon", Watched)
        monkeypatch.setattr(scenario, "SimulatedWorld", Seen)
        schedule = RateSchedule.parse(link)
        result = scenario.run(
            settings or Settings(), schedule, duration_s, seed=seed, managed=True, topics=TOPICS, model=model
        )
        return result, seen[0]

    return play


def plans(daemon, since_s, until_s=LASTS_S):
    """Return the causes of the plans made in that time, which ends with the sources."""
    return [made.reason for at_s, made in daemon.decisions if since_s <= at_s < until_s and made.level_changed]


def settled(result):
    """Return whether all publishers confirm the last plan."""
    last = result.moments[-1]
    return last.planned == last.confirmed == len(TOPICS)


def reload(settings):
    return lambda daemon: daemon.reload(lambda: settings)


SLACK = Settings(program=ProgramSettings(deadline_slack=2.0))  # changes QoS of every topic


# -- reload


def test_a_reload_during_a_swap_wins(play):
    """The last of several reloads is in force in the end, and no sample is lost."""
    result, daemon = play(do={14.0: reload(SLACK), 15.0: reload(Settings()), 16.0: reload(SLACK)})
    assert plans(daemon, 14.0) == ["reload", "reload", "reload"]
    assert settled(result)
    assert sum(topic.lost for topic in result.topics) == 0
    deadlines = {name: row.deadline_ns for name, row in daemon.snapshot.decision.plan.topics.items()}
    assert deadlines["/odom"] == pytest.approx(2.0e9 / 20.0, rel=0.05)


def test_a_reload_in_an_outage_is_planned_for_when_the_link_is_back(play):
    """The settings are in force at once; the plan waits until the link is back."""
    result, daemon = play(do={13.0: reload(SLACK)}, model=LinkModel(outages=((10.0, 16.0),)))
    assert plans(daemon, 10.0, 16.0) == []
    assert daemon.settings == SLACK
    assert plans(daemon, 16.0)[:1] == ["reload"]
    assert settled(result)


def test_a_reload_while_standing_by_is_in_force_when_it_is_called_to_drive(play):
    """A daemon makes no plan while another one drives, and then one plan with the new settings."""
    result, daemon = play(
        do={10.0: reload(SLACK)},
        see=lambda t_s, seen: (
            replace(seen, active_daemon="robot-2", other_daemons=("robot-2",)) if 6.0 <= t_s < 14.0 else seen
        ),
    )
    assert plans(daemon, 6.0, 14.0) == []
    assert plans(daemon, 14.0) == ["start"]
    assert settled(result)


# -- the network


def test_a_partition_of_the_graph_makes_no_plan(play):
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

    result, daemon = play(see=see)
    assert plans(daemon, 13.0) == []
    assert settled(result)


def test_a_peer_that_is_gone_and_back_leaves_the_plan_in_force(play):
    """While other hosts answer, the peer's silence is no outage: gate and plan stay."""

    def see(t_s, seen):
        return replace(seen, reports=()) if 8.0 <= t_s < 22.0 else seen

    result, daemon = play(see=see, duration_s=28.0)
    silent = [moment for moment in result.moments if 9.0 <= moment.t_s < 22.0]
    assert {moment.state for moment in silent} <= {LinkState.APP_LIMITED, LinkState.STEADY}
    assert {moment.gate for moment in silent} == {1.0}
    assert plans(daemon, 8.0, 28.0) == []
    assert settled(result)


@pytest.mark.parametrize(("others_hz", "is_over"), [(0.2, False), (1.0, True)])
def test_a_silence_nobody_breaks_is_an_outage_until_somebody_is_heard(play, others_hz, is_over):
    """The gate closes at once; after ten seconds it opens only if another host on the far side answers."""
    heard = []

    def see(t_s, seen):
        if not 8.0 <= t_s < 24.0:
            return seen
        heard.append(seen.counters.rx_packets)
        counters = replace(seen.counters, rx_packets=heard[0] + int(others_hz * (t_s - 8.0)))
        return replace(seen, reports=(), counters=counters)

    result, daemon = play(see=see, duration_s=30.0)
    states = {round(moment.t_s, 1): (moment.state, moment.gate) for moment in result.moments}
    assert states[10.0] == (LinkState.OUTAGE, pytest.approx(0.01))
    assert (states[23.0][0] is not LinkState.OUTAGE) is is_over
    assert states[23.0][1] == (1.0 if is_over else pytest.approx(0.01))
    assert states[26.0][0] is not LinkState.OUTAGE
    assert len(plans(daemon, 8.0, 30.0)) <= 1
    assert settled(result)


@pytest.mark.parametrize(("trickle_kbit", "is_followed"), [(16, False), (24, False), (100, True)])
def test_a_trickle_is_an_outage_and_a_slow_link_is_followed(play, trickle_kbit, is_followed):
    """A silent peer and a trickle of frames are an outage; on a slow link in use the estimate follows the rate."""
    rate = trickle_kbit * 1e3 / 8
    frame, begin_s, end_s = 1514, 10.0, 26.0
    first = []

    def see(t_s, seen):
        if not begin_s <= t_s < end_s:
            return seen
        first.append(seen.counters)
        frames = int(rate * (t_s - begin_s) / frame)
        counters = replace(
            first[0],
            rx_packets=first[0].rx_packets + 6 * frames,
            tx_bytes=first[0].tx_bytes + frame * frames,
            backlog_bytes=150_000,
        )
        return replace(seen, reports=(), counters=counters)

    result, daemon = play(see=see, duration_s=36.0)
    last = [moment for moment in result.moments if moment.t_s < end_s][-1]
    assert (last.state is LinkState.OUTAGE) is not is_followed
    assert ("down" in plans(daemon, begin_s, end_s)) is is_followed
    if is_followed:
        assert last.estimate_bytes_per_second == pytest.approx(rate, rel=0.15)
    else:
        assert plans(daemon, begin_s, 36.0) == []
    assert settled(result)


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_a_step_of_a_clock_is_no_queue_no_outage_and_no_plan(play, monkeypatch, step_s):
    """A step of the peer's or of this host's clock changes no decision and no queue."""

    def step(_daemon):
        monkeypatch.setattr(world, "_PEER_CLOCK_S", world._PEER_CLOCK_S + step_s)
        monkeypatch.setattr(scenario, "_UNIX_S", scenario._UNIX_S - step_s)

    _, undisturbed = play(duration_s=14.0)
    _, daemon = play(do={10.0: step}, duration_s=14.0)
    assert daemon.snapshot.unix_time_s == pytest.approx(undisturbed.snapshot.unix_time_s - step_s, abs=1.0)
    assert daemon.decisions == undisturbed.decisions
    assert daemon.queues_s == pytest.approx(undisturbed.queues_s, abs=0.05)


# -- memory

MIB = 2.0**20
RESERVE = 128 * MIB
DEEP = Settings(
    program=ProgramSettings(memory_reserve_bytes=RESERVE),
    default_topic=TopicSettings(latency_budget_s=100.0),  # histories of several MiB
)


def memory(available):
    """Return a `see` for `play` with this much memory available, a function of run time (bytes)."""
    return lambda t_s, seen: replace(seen, memory=replace(seen.memory, available_bytes=available(t_s)))


def history_bytes(publishers, depths):
    return sum((700 + 1.3 * p.payload_bytes) * depths[p.topic] for p in publishers)


def planned_bytes(decision, publishers):
    return history_bytes(publishers, {name: row.depth for name, row in decision.plan.topics.items()})


def announced_bytes(publishers):
    return history_bytes(publishers, {p.topic: p.depth for p in publishers})


def test_depths_fall_as_soon_as_memory_does(play):
    """The plan asks for less memory within a tick after the fall, and a writer swap brings it into force."""
    fall_s = 14.0
    result, daemon = play(
        settings=DEEP, see=memory(lambda t_s: 512 * MIB if t_s < fall_s else RESERVE + MIB / 2), duration_s=22.0
    )
    publishers = daemon.snapshot.observation.publishers
    before = [made for at_s, made in daemon.decisions if at_s < fall_s][-1]
    asked_s, asked = next((at_s, made) for at_s, made in daemon.decisions if made.reason == "memory")
    assert planned_bytes(before, publishers) > 1.5 * MIB
    assert planned_bytes(asked, publishers) <= MIB
    assert asked_s - fall_s < 0.2
    assert settled(result)
    assert announced_bytes(publishers) <= MIB
    assert plans(daemon, fall_s, 22.0) == ["memory"]
    rates = [{name: row.rate_hz for name, row in made.plan.topics.items()} for made in (before, asked)]
    assert rates[0] == rates[1]  # the link has not changed
    assert sum(topic.lost for topic in result.topics) == 0


def test_memory_that_falls_slowly_is_followed_in_steps(play):
    """Slowly falling memory makes at most twelve plans."""
    _, daemon = play(settings=DEEP, see=memory(lambda t_s: RESERVE + MIB * max(1.0, 20.0 - t_s)), duration_s=26.0)
    made = plans(daemon, 12.0, 26.0)
    assert set(made) == {"memory"}
    assert len(made) <= 12
    assert planned_bytes(daemon.snapshot.decision, daemon.snapshot.observation.publishers) <= 1.12 * MIB


def test_memory_that_swings_is_not_followed_upwards(play):
    """Memory that returns for seconds makes no plan; memory that stays makes one after half a minute."""

    def available(t_s):
        if t_s < 14.0 or t_s >= 40.0:
            return 512 * MIB
        return RESERVE + (1 if int(t_s / 4) % 2 else 30) * MIB

    _, daemon = play(settings=DEEP, see=memory(available), duration_s=80.0)
    assert plans(daemon, 14.0, 40.0) == ["memory"]
    risen = [at_s for at_s, made in daemon.decisions if 40.0 < at_s < 80.0 and made.reason == "memory"]
    assert risen == [pytest.approx(70.0, abs=4.5)]
