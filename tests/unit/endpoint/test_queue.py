"""The paced queue of a participant whose samples cross whole, in virtual time; test_link_queue.py has the relay's."""

import math
from collections import defaultdict
from dataclasses import replace
from itertools import pairwise

import pytest

from arpd.endpoint.lane import Lane
from arpd.endpoint.queue import PacedQueue
from arpd.model.plan import TopicPlan
from arpd.model.price import Price
from arpd.model.wire import wire_size

CAPACITY = 1e6
LARGE, SMALL = 50_000, 500


def plan(rate_hz, size=LARGE, **changes):
    wire_bytes, packets = wire_size(size, rate_hz=math.inf)
    row = TopicPlan(
        rate_hz=rate_hz, min_rate_hz=0.0, deadline_ns=0, depth=1, weight=1.0, wire_bytes=wire_bytes, packets=packets
    )
    return replace(row, **changes)


class Participant:
    """Its topics, each with a source, and when their samples left, and how old."""

    def __init__(self, price=None):
        self.now_s = 100.0
        self.price = price or Price(share_per_weight=math.inf, capacity_bytes_per_second=CAPACITY)
        self.queue = PacedQueue()
        self.lanes, self.left = {}, defaultdict(list)

    def topic(self, name, row, **options):
        self.lanes[name] = lane = Lane(lambda sample: self.left[name].append((self.now_s, sample)), **options)
        self.queue.add(lane)
        self.queue.retune(lane, row or lane.plan, self.price)

    def offer(self, name, size=LARGE):
        self.queue.offer(self.lanes[name], repr(self.now_s).encode().ljust(size), self.now_s)

    def serve(self):
        while (ready := self.queue.take(self.now_s)) is not None:
            ready.lane.write(ready.sample)

    def play(self, sources, for_s):
        """Let sources of (rate, size) publish by name, all at the same moment first."""
        end_s, due_s = self.now_s + for_s, dict.fromkeys(sources, self.now_s)
        while self.now_s < end_s:
            for name, (rate_hz, size) in sources.items():
                if self.now_s >= due_s[name]:
                    due_s[name] += 1.0 / rate_hz
                    self.offer(name, size)
            self.serve()
            next_s = min(end_s, self.queue.due_s(self.now_s), *due_s.values())
            self.now_s = max(next_s, self.now_s + 1e-4)

    def ages(self, name):
        return [at_s - float(sample[:20]) for at_s, sample in self.left[name]]


@pytest.mark.parametrize("level", [math.inf, 0.5])
def test_a_small_topic_that_grows_after_its_plan_loses_nothing(level):
    """A joystick goes from 5 to 25 Hz, and eight log messages come at once; a picture keeps the ceiling of its plan."""
    world = Participant(Price(share_per_weight=level, capacity_bytes_per_second=CAPACITY))
    for name, size in (("joystick", SMALL), ("log", SMALL), ("image", LARGE)):
        world.topic(name, plan(6.25, size))
    world.topic("events", plan(6.25, SMALL, depth=10), is_ordered=True)
    for _ in range(8):
        world.offer("log", SMALL)
    world.play({"joystick": (25.0, SMALL), "events": (25.0, SMALL), "image": (20.0, LARGE)}, 4.0)
    assert len(world.left["joystick"]) == len(world.left["events"]) == 100
    assert len(world.left["log"]) == 8
    assert len(world.left["image"]) <= 27


def test_cameras_that_coincide_leave_one_by_one_and_fresh():
    """Samples of three cameras leave as far apart as the link needs, each the newest of its source."""
    robot = Participant()
    for name in "abc":
        robot.topic(name, plan(5.0))
    robot.play(dict.fromkeys("abc", (20.0, LARGE)), 4.0)
    times = sorted(at_s for name in "abc" for at_s, _ in robot.left[name] if at_s > 101.0)
    crosses_s = plan(5.0).wire_bytes / CAPACITY
    assert min(after - before for before, after in pairwise(times)) > 0.8 * crosses_s
    assert max(age_s for name in "abc" for age_s in robot.ages(name)) <= 1.0 / 20.0 + 0.001


def test_small_samples_wait_for_no_large_one():
    """While a picture crosses, an IMU's samples leave as they come, and the next picture waits."""
    robot = Participant()
    robot.topic("camera", plan(30.0))
    robot.topic("imu", plan(200.0, SMALL))
    robot.play({"camera": (30.0, LARGE), "imu": (200.0, SMALL)}, 3.0)
    assert len(robot.left["imu"]) >= 600
    assert max(robot.ages("imu")) == 0.0
    carried = sum(len(sample) for name in ("camera", "imu") for _, sample in robot.left[name]) / 3.0
    assert 0.8 * CAPACITY < carried < CAPACITY


@pytest.mark.parametrize("size", [SMALL, LARGE])
def test_without_receipts_no_topic_exceeds_its_rate_at_the_price(size):
    """What others leave is nobody's: no receipt would tell that the link takes more."""
    row = plan(100.0, size)
    price = Price(share_per_weight=5.0 * row.wire_bytes / CAPACITY, capacity_bytes_per_second=CAPACITY, spare_share=0.0)
    robot = Participant(price)
    for name in "ab":
        robot.topic(name, row)
    robot.play({"a": (50.0, size)}, 10.0)
    assert len(robot.left["a"]) == pytest.approx(51, abs=2)


def test_a_sample_that_left_in_a_fade_holds_up_none_after_it():
    """What is still to pass of it takes the time of the link as it is now, not as it was."""
    faded = Price(share_per_weight=math.inf, capacity_bytes_per_second=CAPACITY / 1000.0)
    robot = Participant(faded)
    robot.topic("camera", plan(5.0))
    robot.play({"camera": (5.0, LARGE)}, 1.0)
    assert len(robot.left["camera"]) == 1
    robot.queue.retune(robot.lanes["camera"], plan(5.0), replace(faded, capacity_bytes_per_second=CAPACITY))
    robot.play({"camera": (5.0, LARGE)}, 2.0)
    assert len(robot.left["camera"]) > 8


def test_a_lane_that_a_thread_is_at_delays_no_other_one():
    """While one topic's writer blocks, the others leave, and its own next sample waits."""
    robot = Participant()
    for name in "ab":
        robot.topic(name, plan(100.0, SMALL))
    robot.lanes["a"].claimant = 1
    for name in "ab":
        robot.offer(name, SMALL)
        assert robot.queue.take_of(robot.lanes[name], robot.now_s) is None or name == "b"
    robot.now_s += 1.0
    robot.serve()
    assert not robot.left["a"]
    robot.lanes["a"].claimant = None
    robot.serve()
    assert len(robot.left["a"]) == 1


@pytest.mark.parametrize(("lifespan_s", "left"), [(math.inf, 6), (0.3, 2)])
def test_what_has_waited_longer_than_its_lifespan_does_not_leave(lifespan_s, left):
    """Of a burst that its rate of 1 Hz holds up, the samples that are still worth something leave."""
    robot = Participant()
    robot.topic("a", plan(1.0, size=SMALL, depth=10, max_rate_hz=1.0), is_ordered=True)
    robot.lanes["a"].lifespan_s = lifespan_s
    for _ in range(6):
        robot.offer("a", SMALL)
    robot.play({}, 10.0)
    assert len(robot.left["a"]) == left
