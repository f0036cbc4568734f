"""A run in virtual time with a test beside the daemon: it sees every tick, and may act and change what is seen."""

import math
from dataclasses import dataclass, replace
from typing import Any
from unittest import mock

from arpd.daemon import scenario
from arpd.daemon.summary import between
from arpd.daemon.tick import Daemon
from arpd.sim.world import SimulatedWorld

MBIT = 125_000.0  # bytes/s


def goodput(result, start_s, end_s):
    """Return the payload that reached the base computer in a span (bytes/s)."""
    first, *_, last = between(result.moments, start_s, end_s)
    return (last.delivered_bytes - first.delivered_bytes) / (last.t_s - first.t_s)


def queues(result, start_s, end_s):
    """Return how long what entered the link waited, at each moment of a span, the shortest first (s)."""
    return sorted(moment.queue_delay_s for moment in between(result.moments, start_s, end_s))


@dataclass(frozen=True)
class Tick:
    """Run time and snapshot of one tick."""

    t_s: float
    snapshot: Any

    @property
    def decision(self):
        return self.snapshot.decision


@dataclass(frozen=True)
class Watched:
    """A run and every tick of its daemon."""

    result: Any
    ticks: tuple[Tick, ...]

    def between(self, start_s, end_s):
        return [tick for tick in self.ticks if start_s <= tick.t_s < end_s]

    def plans(self, start_s, end_s):
        """Return the causes of the plans made in a span."""
        return [tick.decision.reason for tick in self.between(start_s, end_s) if tick.decision.reason]

    def sent_hz(self, topic, start_s, end_s):
        """Return the rate at which samples left in a span, by the first and the last announcement in it (Hz)."""
        ticks = self.between(start_s, end_s)
        seen = [p for tick in ticks for p in tick.snapshot.observation.publishers if p.topic == topic]
        first, last = seen[0], seen[-1]
        return (last.published - first.published) / (last.announced_at_s - first.announced_at_s)


def watch(settings, schedule, duration_s, *, see=None, mute_s=math.inf, **options):
    """Run a robot under arpd.

    Parameters
    ----------
    see : changes the daemon's observation, given the run time (s)
    mute_s : run time from which on nothing of the daemon reaches anybody, as if it were dead (s)
    options : further ones of `arpd.daemon.scenario.Scenario`
    """
    ticks = []

    class Beside(Daemon):
        def tick(self, now_s):
            decision = super().tick(now_s)
            # A tick that rests leaves the snapshot of the one before, whose plan must not count again.
            ticks.append(Tick(now_s, replace(self.snapshot, decision=decision)))
            return decision

    class Seen(SimulatedWorld):
        def observe(self, now_s):
            observation = super().observe(now_s)
            return observation if see is None else see(now_s, observation)

        set_price = _until(mute_s, SimulatedWorld.set_price)
        apply = _until(mute_s, SimulatedWorld.apply)
        probe = _until(mute_s, SimulatedWorld.probe)

    with mock.patch.object(scenario, "Daemon", Beside), mock.patch.object(scenario, "SimulatedWorld", Seen):
        result = scenario.Scenario(settings, schedule, duration_s, **options).play()
    return Watched(result, tuple(ticks))


def _until(end_s, act):
    """Return what acts until a run time (s), and does nothing later."""

    def acts(world, *values, **named):
        if world._timeline.now_s < end_s:
            act(world, *values, **named)

    return acts
