"""Rates under the price in virtual time: they follow the link at once, by weight, and need no plan."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from random import Random

import pytest

from arpd.adapters.sim.link import LinkModel
from arpd.adapters.sim.robot import SimTopic
from arpd.adapters.sim.schedule import RateSchedule, RateStep
from arpd.model.endpoints import Direction
from arpd.model.settings import Settings, TopicSettings
from tests.sim.watched import watch

MBIT = 125_000.0
QUEUE = LinkModel(queue_bytes=1_500_000)  # a thousand full packets: the queue is never limited by room
ROBOT = (  # wants 27 Mbit/s
    SimTopic(name="/camera", payload_bytes=20_000, rate_hz=100.0),
    SimTopic(name="/points", payload_bytes=30_000, rate_hz=30.0),
    SimTopic(name="/scan", payload_bytes=5_000, rate_hz=20.0),
    SimTopic(name="/imu", payload_bytes=330, rate_hz=100.0),
    SimTopic(name="/cmd_vel", payload_bytes=80, rate_hz=10.0, direction=Direction.ACTUATION),
)
SETTINGS = Settings(topics={"/imu": TopicSettings(weight=4.0), "/cmd_vel": TopicSettings(weight=10.0)})
FALLS_S, LASTS_S = 12.0, 32.0


def at(*marks):
    """Return a schedule of (run time s, Mbit/s)."""
    return RateSchedule(steps=tuple(RateStep(start_s=at_s, rate_bytes_per_second=rate * MBIT) for at_s, rate in marks))


def play(schedule, duration_s, *, settings=SETTINGS, **options):
    options = {"model": QUEUE, "topics": ROBOT, **options}
    return watch(settings, schedule, duration_s, **options)


@cache
def falling(mbits=5.0):
    return play(at((0, 20), (FALLS_S, mbits)), LASTS_S)


def goodput(played, start_s, end_s):
    """Return the payload that arrived in a span (bytes/s)."""
    moments = [moment for moment in played.result.moments if start_s <= moment.t_s <= end_s]
    first, last = moments[0], moments[-1]
    return (last.delivered_bytes - first.delivered_bytes) / (last.t_s - first.t_s)


def queues(played, start_s, end_s):
    return sorted(moment.queue_delay_s for moment in played.result.moments if start_s <= moment.t_s < end_s)


# -- a link that falls


def test_a_fall_cuts_the_budget_within_a_second_and_long_before_a_plan():
    """The budget is below what the link carries within a second, and the plan for it comes seconds later."""
    ticks = falling().between(FALLS_S, LASTS_S)
    cut_s = next(tick.t_s for tick in ticks if tick.snapshot.allocation.capacity_bytes_per_second < 5.0 * MBIT)
    planned_s = next(tick.t_s for tick in ticks if tick.decision.level_changed)
    assert cut_s < FALLS_S + 1.0 < FALLS_S + 2.0 < planned_s
    assert falling().plans(FALLS_S, LASTS_S)[0] == "down"


def test_small_topics_of_weight_keep_their_rates_through_a_fall():
    """The IMU needs a tenth of what is left, so it sends as before, while the camera gives up most of its rate."""
    assert falling().sent_hz("/imu", FALLS_S + 3.0, LASTS_S) > 0.95 * 100.0
    assert falling().sent_hz("/camera", FALLS_S + 3.0, LASTS_S) < 0.3 * 100.0


def test_large_topics_of_one_weight_get_equal_parts_of_the_link():
    """Camera and point cloud have one weight and different sizes; each sends as many bytes."""
    camera, points = (
        topic.payload_bytes * falling().sent_hz(topic.name, FALLS_S + 3.0, LASTS_S) for topic in ROBOT[:2]
    )
    assert camera == pytest.approx(points, rel=0.15)


def test_after_a_fall_the_link_is_used_and_its_queue_is_short():
    """From three seconds after a fall on, payload fills two thirds of the link, and half of all waits are short."""
    assert goodput(falling(), FALLS_S + 3.0, LASTS_S) > 0.67 * 5.0 * MBIT
    waits = queues(falling(), FALLS_S + 3.0, LASTS_S)
    assert waits[len(waits) // 2] < 0.1
    assert waits[-1] < 0.4


# -- a link that swings


SWING_S, SWINGS_FROM_S, SWINGS_TO_S = 4.0, 12.0, 72.0


@cache
def swinging():
    count = round((SWINGS_TO_S - SWINGS_FROM_S) / SWING_S)
    marks = [(SWINGS_FROM_S + k * SWING_S, 20.0 if k % 2 else 5.0) for k in range(count)]
    return play(at((0, 20), *marks), SWINGS_TO_S), marks


def test_rates_follow_a_swing_both_ways():
    """In the second half of every swing the payload on the fast link is more than twice that on the slow one."""
    played, marks = swinging()
    by_rate = {
        rate: [goodput(played, at_s + SWING_S / 2, at_s + SWING_S - 0.1) for at_s, r in marks if r == rate]
        for rate in (5.0, 20.0)
    }
    assert min(by_rate[20.0]) > 2.0 * max(by_rate[5.0])
    assert max(by_rate[5.0]) < 5.0 * MBIT


def test_a_swing_makes_no_plan_and_no_swap():
    """Once the plan is made for what lasts, eight swings more neither make a plan nor swap a writer."""
    played, _ = swinging()
    assert len(played.plans(SWINGS_FROM_S, SWINGS_TO_S)) <= 2
    assert played.plans(SWINGS_TO_S - 32.0, SWINGS_TO_S) == []
    assert len({moment.swaps for moment in played.result.moments if moment.t_s > SWINGS_TO_S - 30.0}) == 1


# -- floors that the link cannot carry


FLOORS = replace(
    SETTINGS,
    topics={
        **SETTINGS.topics,
        "/scan": TopicSettings(weight=4.0, min_rate_hz=15.0),  # 0.7 Mbit/s
        "/camera": TopicSettings(min_rate_hz=10.0),  # 1.8 Mbit/s
    },
)
STARVED_S, FREED_S = 12.0, 32.0


@cache
def starved():
    return play(at((0, 20), (STARVED_S, 1.5), (FREED_S, 20)), 45.0, settings=FLOORS)


def test_floors_that_do_not_fit_give_way_by_weight():
    """Where the link carries 1.5 of 2.8 Mbit/s of floors, the heavy topic keeps its floor, the light one does not."""
    span = (STARVED_S + 4.0, FREED_S)
    assert starved().sent_hz("/scan", *span) > 0.9 * 15.0
    assert starved().sent_hz("/camera", *span) < 0.6 * 10.0
    price = starved().between(FREED_S - 5.0, FREED_S)[-1].decision.price
    assert price.yielding_weight == 1.0
    assert price.kept_floor < 1.0
    assert queues(starved(), *span)[-1] < 1.0


def test_floors_are_back_when_the_link_is():
    """Within three seconds of the rise the light topic sends at its floor and more, and the price keeps all floors."""
    assert starved().sent_hz("/camera", FREED_S + 3.0, 45.0) > 1.5 * 10.0
    assert {tick.decision.price.yielding_weight for tick in starved().between(FREED_S + 3.0, 45.0)} == {0.0}


# -- a link near 0


DIES_S, RETURNS_S = 13.0, 48.0


@cache
def dying(seed):
    """Fall within 4 s to between 0.01 and 0.25 Mbit/s, another rate every second, and return."""
    random = Random(f"near zero {seed}")
    leaving = [(DIES_S + 0.2 * k, 20.0 / 80.0 ** (k / 20)) for k in range(20)]
    low = [(DIES_S + 4.0 + k, 0.01 * 25.0 ** random.random()) for k in range(round(RETURNS_S - DIES_S - 4.0))]
    return play(at((0, 20), *leaving, *low, (RETURNS_S, 20)), RETURNS_S + 12.0, settings=FLOORS, seed=seed)


@pytest.mark.parametrize("seed", [1, 2])
def test_floors_do_not_flood_a_dying_link(seed):
    """At up to 0.25 Mbit/s, with floors of 2.8, less than four seconds of the latter ever wait."""
    # The wait of a packet is no measure where the rate itself goes to 0, so this counts what waits.
    waiting = [
        tick.snapshot.observation.counters.backlog_bytes for tick in dying(seed).between(DIES_S + 6.0, RETURNS_S)
    ]
    assert max(waiting) < 4.0 * 0.25 * MBIT


@pytest.mark.parametrize("seed", [1, 2])
def test_traffic_returns_with_a_dying_link(seed):
    """Five seconds after the return the payload is more than half of what the link carries."""
    assert goodput(dying(seed), RETURNS_S + 5.0, RETURNS_S + 11.0) > 0.5 * 20.0 * MBIT


# -- what is promised at every tick


@pytest.mark.parametrize(
    ("course", "until_s"), [(falling, LASTS_S), (lambda: swinging()[0], SWINGS_TO_S), (starved, 45.0)]
)
def test_a_price_admits_no_more_than_the_budget(course, until_s):
    """The rates that a price gives all topics together fit into the budget of its tick, floors included."""
    judged = 0
    for tick in course().between(0.0, until_s):
        price, rows = tick.decision.price, tick.decision.plan.topics.values()
        if price is not None and rows:
            judged += 1
            wanted = (replace(row, rate_hz=row.rate_hz / 1.25) for row in rows)  # the ceiling leaves room for jitter
            wire = sum(price.rate_hz(row) * row.wire_bytes for row in wanted)
            assert wire <= 1.02 * tick.snapshot.allocation.capacity_bytes_per_second, tick.t_s
    assert judged > 100
