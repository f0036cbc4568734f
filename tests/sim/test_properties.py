"""Properties of arpd on any link: bounds, dwell and rest, over random links with fixed seeds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise
from random import Random

import pytest

from arpd.model.endpoints import Direction
from arpd.model.link import LinkState
from arpd.model.settings import Settings, TopicSettings
from arpd.sim.link import LinkModel
from arpd.sim.result import SimTopic
from arpd.sim.schedule import RateSchedule, RateStep, outages
from tests.sim.watched import MBIT, Tick, watch

PAST_S, REST_S, WATCH_S = 25.0, 75.0, 15.0  # a rise counts when it has held for 30 s, and waits for three dwells
SEEDS = range(5)
CONSTANTS = ((1, 0.5), (2, 6.0), (4, 50.0))
ROBOT = (
    SimTopic(name="/camera", payload_bytes=20_000, rate_hz=15.0),
    SimTopic(name="/scan", payload_bytes=5_000, rate_hz=10.0),
    SimTopic(name="/imu", payload_bytes=330, rate_hz=20.0),
    SimTopic(name="/battery", payload_bytes=250, rate_hz=1.0),
    SimTopic(name="/cmd_vel", payload_bytes=80, rate_hz=10.0, direction=Direction.ACTUATION),
)
SETTINGS = Settings(
    topics=(
        TopicSettings(name="/cmd_vel", weight=10.0, min_rate_hz=10.0),
        TopicSettings(name="/imu", weight=4.0),
    ),
)


def watched(schedule: RateSchedule, duration_s: float, model: LinkModel, *, seed: int) -> tuple[Tick, ...]:
    """Run the robot under arpd and return every tick of the daemon."""
    return watch(SETTINGS, schedule, duration_s, seed=seed, model=model, topics=ROBOT).ticks


def random_rates(random: Random, until_s: float) -> list[RateStep]:
    """Draw steps of 0.1 s to 10 s between 0.3 and 50 Mbit/s, with a stall now and then."""
    steps, t_s = [], 0.0
    while t_s < until_s:
        stalls = random.random() < 0.1
        rate = 0.0 if stalls and t_s > 0 else 0.3 * (50 / 0.3) ** random.random() * MBIT
        steps.append(RateStep(start_s=t_s, rate_bytes_per_second=rate))
        t_s += 0.1 * (30.0 if stalls else 100.0) ** random.random()
    return steps if steps[-1].rate_bytes_per_second else steps[:-1]


def random_model(random: Random, until_s: float) -> LinkModel:
    """Draw delay, queue, loss and overhead; outages end before ``until_s``."""
    spans_s, t_s = [], 0.0
    while random.random() < 0.4 and (t_s := t_s + random.uniform(1.0, 20.0)) < until_s - 4.0:
        spans_s.append((t_s, t_s + random.uniform(0.1, 4.0)))
        t_s = spans_s[-1][1]
    has_overhead = random.random() < 0.5
    return LinkModel(
        delay_s=random.choice([0.001, 0.005, 0.03]),
        queue_bytes=random.choice([30_000, 256_000, 1_000_000]),
        loss=random.choice([0.0, 0.0, 0.01]),
        losses=outages(*spans_s),
        packet_overhead_s=random.choice([50e-6, 200e-6]) if has_overhead else 0.0,
        aggregate_packets=random.choice([1, 16, 64]) if has_overhead else 1,
        firmware_bytes=random.choice([0, 0, 20_000, 100_000]),
    )


@cache
def anywhere(seed):
    """Play a link that changes until the end."""
    random = Random(f"anywhere {seed}")
    steps = tuple(random_rates(random, PAST_S))
    return watched(RateSchedule(steps=steps), PAST_S, random_model(random, PAST_S), seed=seed)


@cache
def settling(seed, mbits):
    """Play a link with a random past that is constant and loses nothing later."""
    random = Random(f"settling {seed}")
    last = RateStep(start_s=PAST_S, rate_bytes_per_second=mbits * MBIT)
    steps = [step for step in random_rates(random, PAST_S) if step.start_s < PAST_S]
    model = replace(random_model(random, PAST_S), loss=0.0, aggregate_packets=1)
    return watched(RateSchedule(steps=(*steps, last)), PAST_S + REST_S + WATCH_S, model, seed=seed)


def plans(ticks):
    return [(tick.t_s, tick.decision.reason) for tick in ticks if tick.decision.reason]


# -- on any link, at every tick


@pytest.mark.parametrize("seed", SEEDS)
def test_the_solver_answers_nearly_every_plan(seed):
    """OSQP is asked on every link, and leaves at most one answer in a hundred to the closed form."""
    solves = anywhere(seed)[-1].snapshot.totals.solves_by_outcome
    assert solves["osqp", "solved"] >= 10
    assert solves.get(("closed_form", "solved"), 0) <= 0.01 * solves["osqp", "solved"]


@pytest.mark.parametrize("seed", SEEDS)
def test_no_plan_for_the_link_comes_sooner_than_the_dwell(seed):
    """No plan for a change of the link follows another plan sooner than the dwell, and an outage makes no plan."""
    ticks = anywhere(seed)
    for (before_s, _), (at_s, cause) in pairwise(plans(ticks)):
        assert cause not in ("up", "down", "budget") or at_s - before_s >= SETTINGS.governor.dwell_s - 1e-6
    silent = [tick for tick in ticks if tick.snapshot.link.state is LinkState.OUTAGE and tick.t_s > 0]
    assert not [plan for plan in plans(silent) if plan[1] != "start"]


def test_these_links_are_hard():
    """The random links have outages, queues and falls, and starve every topic, so the tests above mean something."""
    ticks = [tick for seed in SEEDS for tick in anywhere(seed)]
    assert {LinkState.OUTAGE, LinkState.DRAINING, LinkState.STEADY} <= {tick.snapshot.link.state for tick in ticks}
    assert {"start", "down"} <= {cause for _, cause in plans(ticks)}
    assert min(tick.decision.allowed for tick in ticks) == 0.0
    assert max(tick.snapshot.link.queue_delay_s for tick in ticks) > 0.5


# -- on a constant link


@pytest.mark.parametrize(("seed", "mbits"), CONSTANTS)
def test_on_a_constant_link_plans_end(seed, mbits):
    """From 75 s after the last change of the link no plan is made."""
    ticks = settling(seed, mbits)
    assert not [plan for plan in plans(ticks) if PAST_S + REST_S <= plan[0] < PAST_S + REST_S + WATCH_S]


@pytest.mark.parametrize(("seed", "mbits"), CONSTANTS)
def test_on_a_constant_link_the_truth_is_found(seed, mbits):
    """Half a minute after the last change of the link the capacity is known within a quarter nearly all the time."""
    ticks = [tick for tick in settling(seed, mbits) if PAST_S + 30.0 <= tick.t_s < PAST_S + REST_S + WATCH_S]
    errors = [abs(tick.snapshot.link.capacity_bytes_per_second / (mbits * MBIT) - 1.0) for tick in ticks]
    assert sum(each < 0.25 for each in errors) > 0.9 * len(errors)
