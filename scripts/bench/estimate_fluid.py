"""A delay-target controller on a fluid: the total that a textbook rate control could carry over a link.

It has neither samples nor floors nor topics. From time to time it learns how much waited, and how fast the link
carried, a moment ago:

    something waits:  rate = carried · (1 + (target - wait) / T)        else:  rate = 1.25 · max(carried, rate)

where ``wait`` is what waited, over what the link carried. The rate is never above the demand.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

from arpd.adapters.sim.service import Service
from arpd.daemon.scenario import Moment, ScenarioResult

if TYPE_CHECKING:
    from arpd.adapters.sim.schedule import RateSchedule
    from scripts.bench.estimate_scenarios import Scenario

_STEP_S = 0.01
_MOMENT_S = 0.1
_START = 50e3  # first rate (bytes/s)
_LEAST = 3e3  # least rate (bytes/s)
_LEAST_CARRIED = 20e3  # in ``wait``, so that an outage is no endless queue (bytes/s)
_GROWTH = 1.25
_PACKET_BYTES = 1500.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Feedback:
    """Sight of the controller.

    Parameters
    ----------
    every_s : time between two looks (s)
    age_s : age of what a look shows (s)
    over_s : time over which the carried rate is averaged (s)
    """

    every_s: float = 0.1
    age_s: float = 0.1
    over_s: float = 0.1


@dataclass(frozen=True, kw_only=True, slots=True)
class FluidRun:
    """Course of one run in steps of 0.01 s.

    Parameters
    ----------
    carried_bytes : what left in each step (bytes)
    queue_delays_s : time that the last byte to come in each step waits; ``inf`` = it never leaves (s)
    """

    carried_bytes: tuple[float, ...]
    queue_delays_s: tuple[float, ...]

    def carried_between(self, start_s: float, end_s: float) -> float:
        """Return the bytes carried in a span (bytes)."""
        return sum(self.carried_bytes[_index(start_s) : _index(end_s)])

    def delays_between(self, start_s: float, end_s: float) -> tuple[float, ...]:
        """Return the delays of a span (s)."""
        return self.queue_delays_s[_index(start_s) : _index(end_s)]


def control(
    schedule: RateSchedule,
    duration_s: float,
    *,
    demand_bytes_per_second: float,
    feedback: Feedback = Feedback(),
    target_s: float = 0.03,
    gain_s: float = 0.3,
) -> FluidRun:
    """Run the controller over a link.

    Parameters
    ----------
    schedule, duration_s : rate of the link over run time, and the length of the run (s)
    demand_bytes_per_second : most that it may send (bytes/s)
    feedback : sight of the controller
    target_s, gain_s : target and T (s)
    """
    service = Service(schedule, 0.0)
    looks, age, over = (_index(span_s) for span_s in (feedback.every_s, feedback.age_s, feedback.over_s))
    seen: deque[tuple[float, float]] = deque(maxlen=age + over)  # waiting and carried bytes, newest last
    rate, waiting = _START, 0.0
    came: list[float] = []
    carried: list[float] = []
    for step in range(_index(duration_s)):
        waiting += rate * _STEP_S
        out = min(waiting, service.by((step + 1) * _STEP_S) - service.by(step * _STEP_S))
        waiting -= out
        came.append(rate * _STEP_S)
        carried.append(out)
        seen.append((waiting, out))
        if step % looks == 0 and len(seen) == seen.maxlen:
            known = list(seen)[:over]
            rate = _next_rate(rate, known[-1][0], sum(each for _, each in known) / feedback.over_s, target_s, gain_s)
            rate = min(demand_bytes_per_second, rate)
    return FluidRun(carried_bytes=tuple(carried), queue_delays_s=tuple(_delays_s(service, came)))


def flow(scenario: Scenario, seed: int) -> ScenarioResult:
    """Run the controller with a scenario's demand over its link; return the moments of a run, without topics."""
    rates, duration_s = scenario.schedule(seed), scenario.duration_s
    service = Service(rates, 0.0)
    run = control(rates, duration_s, demand_bytes_per_second=scenario.demand_bytes_per_second)
    so_far = list(accumulate(run.carried_bytes, initial=0.0))
    moments = []
    for k in range(round(duration_s / _MOMENT_S)):
        step = _index(k * _MOMENT_S)
        t_s = round(k * _MOMENT_S, 6)
        moments.append(
            Moment(
                t_s=t_s,
                truth_bytes_per_second=(service.by(t_s + _MOMENT_S) - service.by(t_s)) / _MOMENT_S,
                queue_delay_s=run.queue_delays_s[step],
                carried_bytes=so_far[step],
            )
        )
    return ScenarioResult(topics=(), moments=tuple(moments))


def _next_rate(rate: float, waiting: float, carried: float, target_s: float, gain_s: float) -> float:
    base = carried if waiting > _PACKET_BYTES else _GROWTH * max(carried, rate)
    wait_s = waiting / max(base, _LEAST_CARRIED)
    return max(_LEAST, base * (1.0 + (target_s - wait_s) / gain_s))


def _delays_s(service: Service, came: list[float]) -> list[float]:
    """Return when what came by the end of each step has left, less that end (s)."""
    delays_s, cleared = [], 0.0  # bytes of service used up when everything so far has left
    for step, size in enumerate(came):
        cleared = max(cleared, service.by(step * _STEP_S)) + size
        delays_s.append(max(0.0, service.when(cleared) - (step + 1) * _STEP_S))
    return delays_s


def _index(time_s: float) -> int:
    return round(time_s / _STEP_S)
