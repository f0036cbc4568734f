"""The flow: queue, swaps and the wait for a plan together, in virtual time."""

import math
from collections import Counter
from contextlib import suppress
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.endpoint.flow import Flow
from arpd.endpoint.lane import SMALL_BYTES
from arpd.endpoint.queue import PacedQueue
from arpd.model.endpoints import Overflow, WithheldCause, WriterQos
from arpd.model.price import Price
from arpd.model.wire import wire_size
from tests.examples import examples
from tests.unit import swap_world

STEP_S = 0.005
TERMS = {"weight": 1.0, "wire_bytes": 1.0, "packets": 1}
SMALL, LARGE = bytes(SMALL_BYTES), bytes(SMALL_BYTES + 1)


class Writer(swap_world.Writer):
    """A writer with one reader that acknowledges only when the test says so, and that may be broken."""

    def __init__(self, qos, world):
        super().__init__(qos, world)
        self.acknowledges = self.is_broken = False

    def is_acknowledged(self):
        return super().is_acknowledged() or not self.written

    def publish(self, sample):
        if self.is_broken:
            raise RuntimeError("no room")
        super().publish(sample)


class World(swap_world.World):
    def __init__(self, *, depth=10, overflow=Overflow.LATEST):
        super().__init__()
        self.now_s = 100.0
        self.flow = Flow(
            create=self.create,
            qos=WriterQos(depth=depth, deadline_ns=0),
            overflow=overflow,
            clock=lambda: self.now_s,
        )
        self.queue = PacedQueue()
        self.queue.add(self.flow.lane)
        self.price = None

    def create(self, qos):
        self.writers.append(Writer(qos, self))
        return self.writers[-1]

    def retune(self, **changes):
        plan = replace(self.flow.lane.plan, **changes)
        self.flow.swap.request(WriterQos(depth=plan.depth, deadline_ns=plan.deadline_ns))
        self.queue.retune(self.flow.lane, plan, self.price)

    def set_price(self, price):
        self.price = price
        self.queue.retune(self.flow.lane, self.flow.lane.plan, price)

    def publish(self, sample):
        """Do as a thread that publishes: write at once what may leave, and leave the rest to the other thread."""
        if self.queue.admit(self.flow.lane, sample, self.now_s):
            self.flow.write(sample)
            return
        self.queue.offer(self.flow.lane, sample, self.now_s)
        if (ready := self.queue.take_of(self.flow.lane, self.now_s)) is not None:
            self.flow.write(ready)

    def serve(self):
        """Do as the participant's thread."""
        while (ready := self.queue.take(self.now_s)) is not None:
            ready.lane.write(ready.sample)
        self.flow.service(self.now_s)

    def wait(self, seconds):
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            self.serve()


def price(rate_hz):
    """Return the price at which a topic of these terms, without a floor, gets this rate."""
    return Price(share_per_weight=rate_hz, capacity_bytes_per_second=1.0)


def name(number):
    return number.to_bytes(4, "big")


@examples(100)
@given(
    st.lists(
        st.one_of(
            st.tuples(st.just("publish"), st.integers(1, 8)),
            st.tuples(st.just("depth"), st.integers(1, 8)),
            st.tuples(st.just("rate"), st.sampled_from([0.0, 1.0, 20.0, float("inf")])),
            st.tuples(st.just("price"), st.sampled_from([0.0, 0.5, 10.0, 1000.0, math.inf])),
            st.tuples(st.just("wait"), st.sampled_from([0.005, 0.1, 0.5, 2.0])),
            st.tuples(st.just("acknowledge"), st.booleans()),
            st.tuples(st.just("break"), st.booleans()),
        ),
        max_size=40,
    ),
    st.sampled_from(Overflow),
)
def test_every_sample_is_written_withheld_or_waiting(steps, overflow):
    """Any sequence of swaps, plans and prices accounts for each sample, and none leaves twice."""
    world = World(overflow=overflow)
    offered = 0
    is_broken = False
    for what, value in steps:
        before = Counter(world.flow.state().withheld_by_cause)
        for writer in world.writers:
            writer.is_broken = is_broken
        if what == "publish":
            for number in range(offered, offered + value):
                with suppress(RuntimeError):
                    world.publish(name(number))
            offered += value
        elif what == "depth":
            world.retune(depth=value)
        elif what == "rate":
            world.retune(rate_hz=value, **TERMS)
        elif what == "price":
            world.set_price(price(value))
        elif what == "wait":
            with suppress(RuntimeError):
                world.wait(value)
        elif what == "break":
            is_broken = value
        else:
            world.writers[-1].acknowledges = value
        now = world.flow.state()
        assert sum(now.withheld_by_cause.values()) == now.withheld
        assert set(Counter(now.withheld_by_cause) - before) <= possible_causes(world, is_broken=is_broken)
    state = world.flow.state()
    assert len(set(world.log)) == len(world.log) == state.published
    assert world.log == sorted(world.log)
    assert offered == state.offered == state.published + state.withheld + state.queued
    world.queue.remove(world.flow.lane)
    world.flow.close()
    assert not any(writer.is_alive for writer in world.writers)
    closed = world.flow.state()
    assert closed.withheld == sum(closed.withheld_by_cause.values()) == offered - closed.published
    assert closed.withheld_by_cause.get(WithheldCause.CLOSED, 0) == state.queued


def possible_causes(world, *, is_broken):
    """Return the causes for which a sample may be withheld now."""
    plan_hz = world.flow.lane.plan.rate_hz
    priced = {WithheldCause.PRICE} if world.flow.state().paced_rate_hz < plan_hz else set()
    paced = {WithheldCause.RATE} if not priced and plan_hz < math.inf else set()
    return {WithheldCause.BLOCKED} | priced | paced | ({WithheldCause.FAILED} if is_broken else set())


@examples(50)
@given(
    st.lists(
        st.tuples(st.one_of(st.just(math.inf), st.floats(0.0, 100.0)), st.sampled_from([0.05, 0.3, 1.5])),
        min_size=1,
        max_size=12,
    ),
    st.sampled_from(Overflow),
)
def test_the_rate_follows_the_price_at_once_and_no_window_sees_more(steps, overflow):
    """Up and down, the rate in force is the price's; every window sees at most its integral and one burst.

    Where no price holds it back, what may not be lost catches up at twice its ceiling.
    """
    world = World(overflow=overflow)
    world.retune(rate_hz=80.0, min_rate_hz=5.0, max_rate_hz=80.0, **TERMS)
    allowed = 0.0
    departures: list[float] = []
    for wanted_hz, seconds in steps:
        world.set_price(price(wanted_hz))
        rate_hz = min(80.0, max(5.0, wanted_hz))
        assert world.flow.state().paced_rate_hz == rate_hz
        sent = len(departures)
        for _ in range(round(seconds / STEP_S)):
            world.now_s += STEP_S
            allowed += STEP_S * (160.0 if overflow is Overflow.QUEUE and rate_hz == 80.0 else rate_hz)
            before = len(world.log)
            world.publish(name(world.flow.lane.offered_rate.samples))
            world.serve()
            departures += [allowed] * (len(world.log) - before)
        assert len(departures) - sent >= math.floor(rate_hz * seconds) - 1
    for first, start in enumerate(departures):
        for last in range(first, len(departures)):
            assert last - first + 1 <= departures[last] - start + 24.0 + 2.5  # 0.3 s at the ceiling


def begin(world, seconds, *, price=None, sample=LARGE, acknowledges=True):
    """Publish at 50 Hz while a daemon sends this price at 10 Hz, or none; return the number of samples written."""
    world.writers[-1].acknowledges = acknowledges
    before = len(world.log)
    for number in range(round(seconds * 50)):
        if number % 5 == 0:
            world.set_price(price)
        world.publish(sample)
        world.wait(0.02)
    return len(world.log) - before


def spare(share):
    """Return the price of a link that carries a large sample in 20 ms, and has a share to spare."""
    return Price(
        share_per_weight=0.1, capacity_bytes_per_second=50.0 * wire_size(len(LARGE), rate_hz=1.0)[0], spare_share=share
    )


@pytest.mark.parametrize(("share", "rate_hz"), [(0.5, 25.0), (0.1, 5.0), (0.0, 2.5)])
def test_large_samples_have_what_is_spare_until_their_first_plan(share, rate_hz):
    """The first sample leaves at once, then as many as the link has room for; the others count as withheld."""
    world = World()
    assert begin(world, 0.02, price=spare(share)) == 1
    assert begin(world, 2.0, price=spare(share)) == pytest.approx(2.0 * rate_hz, rel=0.1, abs=1)
    assert world.flow.state().withheld > 0


def test_the_wait_for_a_plan_begins_when_the_daemon_is_heard():
    """A camera that started before it waits as long as any other: the plan takes no less time."""
    world = World()
    begin(world, 3.5, price=None)
    assert begin(world, 3.5, price=spare(0.0)) < 15


@pytest.mark.parametrize(
    ("sample", "overflow", "price"),
    [(SMALL, Overflow.LATEST, spare(0.0)), (LARGE, Overflow.QUEUE, spare(0.0)), (LARGE, Overflow.LATEST, None)],
    ids=["small", "not conflated", "no daemon"],
)
def test_what_need_not_wait_does_not(sample, overflow, price):
    """Small samples, those that may not be conflated, and all samples without a daemon leave as they come."""
    assert begin(World(overflow=overflow), 2.0, price=price, sample=sample) == 100


@pytest.mark.parametrize(("seconds", "price"), [(4.2, spare(0.0)), (1.0, None)], ids=["four seconds", "no daemon"])
def test_the_wait_for_a_plan_ends(seconds, price):
    """A topic that gets no plan waits for four seconds, and only while a daemon is there."""
    world = World()
    begin(world, seconds, price=spare(0.0))
    assert begin(world, 2.0, price=price) == pytest.approx(100, abs=1)


def test_at_the_start_a_large_sample_waits_until_the_readers_have_the_one_before():
    """Without a daemon as many wait as DDS would keep, and leave one by one; with one, the newest."""
    world = World(depth=3)
    world.publish(LARGE)
    for k in range(1, 11):
        world.publish(LARGE + name(k))
    assert world.log == [LARGE]
    assert (world.flow.state().queued, world.flow.state().withheld) == (3, 7)
    world.writers[0].acknowledges = True
    world.wait(STEP_S)
    world.writers[0].acknowledges = False
    assert world.log[1] == LARGE + name(8)
    begin(world, 0.5, price=spare(1.0), acknowledges=False)
    assert world.flow.state().queued <= 2  # one here, and one that waits for the link


@pytest.mark.parametrize("plan", [True, False], ids=["plan", "no daemon"])
def test_a_slow_start_ends_with_the_plan_or_after_five_seconds(plan):
    """Where no reader acknowledges, because one is gone, for example, the others hear the topic again."""
    world = World()
    assert begin(world, 0.1 if plan else 4.9, acknowledges=False) < 10
    if plan:
        world.retune(rate_hz=math.inf, **TERMS)
    begin(world, 0.2, acknowledges=False)
    assert begin(world, 1.0, acknowledges=False) == 50


def test_a_link_that_acknowledges_quickly_delays_no_start():
    """What is acknowledged within two heartbeats leaves as it comes."""
    world = World()
    for number in range(50):
        world.publish(LARGE + name(number))
        world.writers[0].acknowledges = number % 2 == 1  # at each second sample a heartbeat is answered
        world.wait(0.033)
    assert len(world.log) == 50
