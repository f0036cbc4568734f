"""Properties of arpd on any link: bounds, dwell and rest, over random links with fixed seeds."""

from dataclasses import replace
from itertools import pairwise
from random import Random

import pytest

from arpd.model.endpoints import Direction
from arpd.model.link import LinkState
from arpd.model.settings import Settings, TopicSettings
from arpd.sim.link import LinkModel
from arpd.sim.result import SimTopic
from arpd.sim.schedule import RateSchedule, RateStep, outages
from tests.sim.watched import MBIT, watch

PAST_S, REST_S, WATCH_S = 25.0, 75.0, 15.0  # a rise counts when it has held for 30 s, and waits for three dwells
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


def watched(steps, duration_s, model, *, seed):
    """Run the robot under arpd and return every tick of the daemon."""
    return watch(SETTINGS, RateSchedule(steps=tuple(steps)), duration_s, seed=seed, model=model, topics=ROBOT).ticks


def random_rates(random, until_s):
    """Draw steps of 0.1 s to 10 s between 0.3 and 50 Mbit/s, with a stall now and then."""
    steps, t_s = [], 0.0
    while t_s < until_s:
        stalls = random.random() < 0.1
        rate = 0.0 if stalls and t_s > 0 else 0.3 * (50 / 0.3) ** random.random() * MBIT
        steps.append(RateStep(start_s=t_s, rate_bytes_per_second=rate))
        t_s += 0.1 * (30.0 if stalls else 100.0) ** random.random()
    return steps if steps[-1].rate_bytes_per_second else steps[:-1]


def random_model(random, until_s):
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


def plans(ticks):
    return [(tick.t_s, tick.decision.reason) for tick in ticks if tick.decision.reason]


# -- on any link, at every tick


@pytest.mark.parametrize("seed", range(5))
def test_plans_keep_the_dwell_and_are_the_solvers(seed):
    """No plan for the link follows another sooner than the dwell, an outage makes none, and OSQP answers nearly all."""
    random = Random(f"anywhere {seed}")
    ticks = watched(random_rates(random, PAST_S), PAST_S, random_model(random, PAST_S), seed=seed)
    solves = ticks[-1].snapshot.totals.solves_by_outcome
    assert solves["osqp", "solved"] >= 10
    assert solves.get(("closed_form", "solved"), 0) <= 0.01 * solves["osqp", "solved"]
    for (before_s, _), (at_s, cause) in pairwise(plans(ticks)):
        assert cause not in ("up", "down", "budget") or at_s - before_s >= SETTINGS.governor.dwell_s - 1e-6
    silent = [tick for tick in ticks if tick.snapshot.link.state is LinkState.OUTAGE and tick.t_s > 0]
    assert not [plan for plan in plans(silent) if plan[1] != "start"]


# -- on a constant link


@pytest.mark.parametrize(("seeds", "mbits"), [((1, 2, 3, 4), 0.5), ((2,), 6.0), ((4,), 50.0)])
def test_on_a_constant_link_the_truth_is_found_and_plans_end(seeds, mbits):
    """The capacity is known within a quarter nearly all the time 30 s after the last change; after 75 s no plan comes.

    The past of the link is random; later it loses nothing. At 0.5 Mbit/s one past in ten costs a tenth of the time.
    """
    last, is_right = RateStep(start_s=PAST_S, rate_bytes_per_second=mbits * MBIT), []
    for seed in seeds:
        random = Random(f"settling {seed}")
        steps = [step for step in random_rates(random, PAST_S) if step.start_s < PAST_S]
        model = replace(random_model(random, PAST_S), loss=0.0, aggregate_packets=1)
        ticks = watched([*steps, last], PAST_S + REST_S + WATCH_S, model, seed=seed)
        found = [tick.snapshot.link.capacity_bytes_per_second for tick in ticks if tick.t_s >= PAST_S + 30.0]
        is_right += [abs(each / (mbits * MBIT) - 1.0) < 0.25 for each in found]
        assert not [plan for plan in plans(ticks) if plan[0] >= PAST_S + REST_S]
    assert sum(is_right) > 0.9 * len(is_right)
