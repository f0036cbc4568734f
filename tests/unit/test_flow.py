"""The flow: pacing and swap together, in virtual time."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.flow import Flow
from arpd.settings import Overflow
from arpd.swap import SwapTiming, WriterQos

STEP_S = 0.005


class Writer:
    """Acknowledges only when told to, and one reader matches it at once."""

    def __init__(self, qos, log):
        self.qos = qos
        self.log = log
        self.written = []
        self.is_acknowledging = False
        self.is_alive = True

    def publish(self, sample):
        assert self.is_alive
        self.written.append(sample)
        self.log.append(sample)

    def matched(self):
        return 1

    def is_acknowledged(self):
        return self.is_acknowledging

    def disconnects_readers(self):
        return False

    def destroy(self):
        self.is_alive = False


class World:
    def __init__(self, *, depth=10, overflow=Overflow.LATEST):
        self.now_s = 100.0
        self.writers = []
        self.log = []  # what was written, by whichever writer
        self.flow = Flow(
            create=self.create,
            qos=WriterQos(depth=depth, deadline_ns=0),
            overflow=overflow,
            clock=lambda: self.now_s,
        )

    def create(self, qos):
        self.writers.append(Writer(qos, self.log))
        return self.writers[-1]

    def retune(self, **changes):
        plan = replace(self.flow.plan, **changes)
        self.flow.retune(plan, qos=WriterQos(depth=plan.depth, deadline_ns=plan.deadline_ns))

    def give(self, sample, *, by):
        if by == "publish":
            self.flow.publish(sample)
        elif self.flow.admit(sample):
            self.flow.write(sample)

    def wait(self, seconds):
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            self.flow.service(self.now_s)


def name(number):
    return number.to_bytes(4, "big")


@pytest.mark.parametrize("overflow", Overflow)
@pytest.mark.parametrize("depth", [1, 2, 10])
def test_an_unpaced_swap_loses_nothing_however_small_the_depth(overflow, depth):
    """Where the old writer is never acknowledged, samples are held and let go, all of them, in order."""
    world = World(depth=depth, overflow=overflow)
    for number in range(2000):
        if number == 50:
            world.retune(depth=depth + 1)
        world.flow.publish(name(number))
        world.writers[-1].is_acknowledging = len(world.writers) > 1
        world.wait(STEP_S)
    assert len(world.writers) == 2
    assert world.flow.qos.depth == depth + 1
    assert world.log == [name(number) for number in range(2000)]
    assert world.flow.state().withheld == 0


def test_what_a_swap_held_leaves_at_twice_the_rate_it_came_at():
    """No burst crowds the link or a reader's history, and what comes meanwhile queues behind."""
    world = World()
    departures = []
    number = 0
    while number < 1000:
        if number == 100:
            world.retune(depth=11)
        world.flow.publish(name(number))
        number += 1
        for _ in range(4):
            world.now_s += STEP_S / 2
            before = len(world.log)
            world.flow.service(world.now_s)
            departures.append(len(world.log) - before)
    assert world.log == [name(number) for number in range(len(world.log))]
    assert max(departures) <= 3
    assert world.flow.state().queued <= 30


def test_a_hold_conflates_nothing_that_pacing_lets_through():
    """Held samples wait behind the pacing: a slow conflating topic loses none of them to a swap."""
    world = World()
    world.retune(rate_hz=10.0)
    for number in range(200):
        if number == 20:
            world.retune(depth=11)
        world.flow.publish(name(number))
        world.writers[-1].is_acknowledging = len(world.writers) > 1
        world.wait(0.11)
    assert len(world.writers) == 2
    assert world.log == [name(number) for number in range(200)]


@settings(deadline=None, max_examples=100)
@given(
    st.lists(
        st.one_of(
            st.tuples(st.just("publish"), st.integers(1, 8)),
            st.tuples(st.just("admit"), st.integers(1, 8)),
            st.tuples(st.just("depth"), st.integers(1, 8)),
            st.tuples(st.just("rate"), st.sampled_from([0.0, 1.0, 20.0, float("inf")])),
            st.tuples(st.just("gate"), st.sampled_from([0.1, 0.5, 1.0])),
            st.tuples(st.just("wait"), st.sampled_from([0.005, 0.1, 0.5, 2.0])),
            st.tuples(st.just("acknowledge"), st.booleans()),
        ),
        max_size=40,
    ),
    st.sampled_from(Overflow),
)
def test_every_sample_is_written_withheld_or_waiting(steps, overflow):
    """Through any sequence of swaps, rates and gates each sample is accounted for, and none leaves twice."""
    world = World(overflow=overflow)
    offered = 0
    for what, value in steps:
        if what in {"publish", "admit"}:
            for number in range(offered, offered + value):
                world.give(name(number), by=what)
            offered += value
        elif what == "depth":
            world.retune(depth=value)
        elif what == "rate":
            world.retune(rate_hz=value)
        elif what == "gate":
            world.flow.set_gate(value)
        elif what == "wait":
            world.wait(value)
        else:
            world.writers[-1].is_acknowledging = value
    state = world.flow.state()
    assert len(set(world.log)) == len(world.log) == state.published
    assert world.log == sorted(world.log)
    assert offered == state.offered == state.published + state.withheld + state.queued
    world.flow.close()
    assert not any(writer.is_alive for writer in world.writers)


def test_a_latched_writer_first_gets_what_the_old_one_held():
    """The last samples of the old depth come first, then what is published next; they count once."""
    world = World(depth=3)
    world.flow.keep_history()
    for number in range(5):
        world.flow.publish(name(number))
    world.writers[0].is_acknowledging = True
    world.retune(depth=10)
    world.wait(2 * SwapTiming().settle_s)
    world.flow.publish(name(5))
    assert world.writers[1].written == [name(number) for number in (2, 3, 4, 5)]
    assert world.flow.state().published == 6
    world.writers[1].is_acknowledging = True
    world.retune(depth=2)
    world.wait(2 * SwapTiming().settle_s)
    assert world.writers[2].written == [name(number) for number in (2, 3, 4, 5)]
    world.flow.publish(name(6))
    world.retune(depth=4)
    world.writers[2].is_acknowledging = True
    world.wait(2 * SwapTiming().settle_s)
    assert world.writers[3].written == [name(5), name(6)], "a writer of depth 2 held no more"
