"""A run in virtual time with a test beside the daemon: it sees every tick, and may act and change what is seen."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING
from unittest import mock

from arpd.daemon import scenario
from arpd.daemon.summary import between
from arpd.daemon.tick import Daemon
from arpd.sim.world import SimulatedWorld

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from arpd.daemon.scenario import ScenarioResult
    from arpd.model.allocation import Decision
    from arpd.model.endpoints import PublisherState
    from arpd.model.observation import Observation
    from arpd.model.settings import Settings
    from arpd.report.snapshot import Snapshot
    from arpd.sim.schedule import RateSchedule

MBIT = 125_000.0  # bytes/s


def goodput(result: ScenarioResult, start_s: float, end_s: float) -> float:
    """Return the payload that reached the base computer in a span (bytes/s)."""
    first, *_, last = between(result.moments, start_s, end_s)
    return (last.delivered_bytes - first.delivered_bytes) / (last.t_s - first.t_s)


def queues(result: ScenarioResult, start_s: float, end_s: float) -> list[float]:
    """Return how long what entered the link waited, at each moment of a span, the shortest first (s)."""
    return sorted(moment.queue_delay_s for moment in between(result.moments, start_s, end_s))


@dataclass(frozen=True, kw_only=True, slots=True)
class Tick:
    """Run time and snapshot of one tick."""

    t_s: float
    snapshot: Snapshot

    @property
    def decision(self) -> Decision:
        return self.snapshot.decision


@dataclass(frozen=True, kw_only=True, slots=True)
class Watched:
    """A run, its daemon and every tick."""

    result: ScenarioResult
    daemon: Daemon
    ticks: tuple[Tick, ...]

    def between(self, start_s: float, end_s: float) -> list[Tick]:
        return [tick for tick in self.ticks if start_s <= tick.t_s < end_s]

    def plans(self, start_s: float, end_s: float) -> list[str]:
        """Return the causes of the plans made in a span."""
        return [tick.decision.reason for tick in self.between(start_s, end_s) if tick.decision.reason]

    def sent_hz(self, topic: str, start_s: float, end_s: float) -> float:
        """Return the rate at which samples left in a span, by the first and the last announcement in it (Hz)."""
        seen = [p for tick in self.between(start_s, end_s) if (p := _of(tick, topic)) is not None]
        first, last = seen[0], seen[-1]
        return (last.published - first.published) / (last.announced_at_s - first.announced_at_s)


def watch(
    settings: Settings,
    schedule: RateSchedule,
    duration_s: float,
    *,
    do: Mapping[float, Callable[[Daemon], object]] | None = None,
    see: Callable[[float, Observation], Observation] | None = None,
    mute_s: float = math.inf,
    seed: int = 1,
    **options: object,
) -> Watched:
    """Run a robot under arpd.

    Parameters
    ----------
    do : run time (s) → called with the daemon at that time
    see : changes the daemon's observation, given the run time (s)
    mute_s : run time from which on nothing of the daemon reaches anybody, as if it were dead (s)
    options : further ones of `arpd.daemon.scenario.Scenario`
    """
    orders = sorted((do or {}).items())
    daemons: list[Daemon] = []
    ticks: list[Tick] = []

    class Beside(Daemon):
        def __init__(self, *arguments, **more):
            super().__init__(*arguments, **more)
            daemons.append(self)

        def tick(self, now_s):
            while orders and now_s >= orders[0][0]:
                orders.pop(0)[1](self)
            decision = super().tick(now_s)
            # A tick that rests leaves the snapshot of the one before, whose plan must not count again.
            ticks.append(Tick(t_s=now_s, snapshot=replace(self.snapshot, decision=decision)))
            return decision

    class Seen(SimulatedWorld):
        def observe(self, now_s):
            observation = super().observe(now_s)
            return observation if see is None else see(now_s, observation)

        set_price = _until(mute_s, SimulatedWorld.set_price)
        apply = _until(mute_s, SimulatedWorld.apply)
        probe = _until(mute_s, SimulatedWorld.probe)

    with mock.patch.object(scenario, "Daemon", Beside), mock.patch.object(scenario, "SimulatedWorld", Seen):
        result = scenario.Scenario(settings, schedule, duration_s, seed=seed, **options).play()
    return Watched(result=result, daemon=daemons[0], ticks=tuple(ticks))


def _until(end_s: float, act: Callable[..., None]) -> Callable[..., None]:
    """Return what acts until a run time (s), and does nothing later."""

    def acts(world: SimulatedWorld, *values: object, **named: object) -> None:
        if world._timeline.now_s < end_s:
            act(world, *values, **named)

    return acts


def _of(tick: Tick, topic: str) -> PublisherState | None:
    return next((p for p in tick.snapshot.observation.publishers if p.topic == topic), None)
