"""Rates under the price in virtual time: they follow the link at once, by weight, and need no plan."""

from dataclasses import replace
from random import Random

from arpd.model.endpoints import Direction
from arpd.model.settings import Settings, TopicSettings
from arpd.sim.link import LinkModel
from arpd.sim.result import SimTopic
from arpd.sim.schedule import RateSchedule, RateStep
from tests.sim.watched import MBIT, goodput, queues, watch

QUEUE = LinkModel(queue_bytes=1_500_000)  # a thousand full packets: the queue is never limited by room
ROBOT = (  # wants 27 Mbit/s
    SimTopic(name="/camera", payload_bytes=20_000, rate_hz=100.0),
    SimTopic(name="/points", payload_bytes=30_000, rate_hz=30.0),
    SimTopic(name="/scan", payload_bytes=5_000, rate_hz=20.0),
    SimTopic(name="/imu", payload_bytes=330, rate_hz=100.0),
    SimTopic(name="/cmd_vel", payload_bytes=80, rate_hz=10.0, direction=Direction.ACTUATION),
)
SETTINGS = Settings(topics=(TopicSettings(name="/imu", weight=4.0), TopicSettings(name="/cmd_vel", weight=10.0)))


def at(*marks):
    """Return a schedule of (run time s, Mbit/s)."""
    return RateSchedule(steps=tuple(RateStep(start_s=at_s, rate_bytes_per_second=rate * MBIT) for at_s, rate in marks))


def play(schedule, duration_s, *, settings=SETTINGS, **options):
    options = {"model": QUEUE, "topics": ROBOT, **options}
    return watch(settings, schedule, duration_s, **options)


# -- floors that the link cannot carry


FLOORS = replace(
    SETTINGS,
    topics=(
        *SETTINGS.topics,
        TopicSettings(name="/scan", weight=4.0, min_rate_hz=15.0),  # 0.7 Mbit/s
        TopicSettings(name="/camera", min_rate_hz=10.0),  # 1.8 Mbit/s
    ),
)
STARVED_S, FREED_S = 12.0, 32.0


def test_floors_that_do_not_fit_give_way_by_weight_and_return_with_the_link():
    """Of 2.8 Mbit/s of floors on 1.5 the heavy topic keeps its own; 3 s after the rise the light one has it again."""
    played = play(at((0, 20), (STARVED_S, 1.5), (FREED_S, 20)), 45.0, settings=FLOORS)
    span, after = (STARVED_S + 4.0, FREED_S), (FREED_S + 3.0, 45.0)
    assert played.sent_hz("/scan", *span) > 0.9 * 15.0
    assert played.sent_hz("/camera", *span) < 0.6 * 10.0
    price = played.between(FREED_S - 5.0, FREED_S)[-1].snapshot.allocation.price
    assert price.yielding_weight == 1.0
    assert price.kept_minimum < 1.0
    assert queues(played.result, *span)[-1] < 1.0
    assert played.sent_hz("/camera", *after) > 1.5 * 10.0
    assert {tick.snapshot.allocation.price.yielding_weight for tick in played.between(*after)} == {0.0}


# -- a link near 0


DIES_S, RETURNS_S = 13.0, 48.0


def test_floors_do_not_flood_a_dying_link_and_traffic_returns_with_it():
    """At up to 0.25 Mbit/s less than 3 s of it ever wait; 5 s after the return payload fills half of the link."""
    random = Random("near zero")
    leaving = [(DIES_S + 0.2 * k, 20.0 / 80.0 ** (k / 20)) for k in range(20)]
    low = [(DIES_S + 4.0 + k, 0.01 * 25.0 ** random.random()) for k in range(round(RETURNS_S - DIES_S - 4.0))]
    schedule = at((0, 20), *leaving, *low, (RETURNS_S, 20))
    played = play(schedule, RETURNS_S + 12.0, settings=FLOORS)
    # The wait of a packet is no measure where the rate itself goes to 0, so this counts what waits.
    waiting = [tick.snapshot.observation.counters.backlog_bytes for tick in played.between(DIES_S + 6.0, RETURNS_S)]
    assert max(waiting) < 3.0 * 0.25 * MBIT
    assert goodput(played.result, RETURNS_S + 5.0, RETURNS_S + 11.0) > 0.5 * 20.0 * MBIT
