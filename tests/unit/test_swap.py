"""The make-before-break swap: whatever the writers do, every sample is written once, to a live writer."""

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.swap import SwapResult, SwapState, SwapTiming
from tests.unit.swap_world import FIRST, make, qos

TIMING = SwapTiming()


def run(swap, start_s, seconds):
    for step in range(int(seconds / 0.005)):
        swap.step(start_s + step * 0.005)
    return start_s + seconds


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("request"), st.integers(1, 4)),
        st.tuples(st.just("wait"), st.sampled_from([0.005, 0.05, 0.2, 1.0, 6.0])),
        st.tuples(st.just("publish"), st.integers(1, 3)),
        st.tuples(st.just("acknowledge"), st.booleans()),
        st.tuples(st.just("readers"), st.integers(0, 2)),
        st.tuples(st.just("new readers"), st.integers(0, 2)),
        st.tuples(st.just("refuse"), st.booleans()),
    ),
    max_size=40,
)


@settings(deadline=None, max_examples=300)
@given(STEPS)
def test_every_sample_is_written_once_and_in_order_to_a_live_writer(steps):
    """Requests, silence, lost readers and refusals in any order lose, double and misplace nothing."""
    world, swap = make()
    now_s, written = 0.0, 0
    for what, value in steps:
        if what == "request":
            swap.request(qos(value), hold_s=0.1)
        elif what == "wait":
            now_s += value
        elif what == "publish" and not swap.is_holding:
            for _ in range(value):
                swap.current.publish(written)
                written += 1
        elif what == "acknowledge":
            swap.current.acknowledges = value
        elif what == "readers":
            swap.current.readers = value
        elif what == "new readers":
            world.readers = value
        elif what == "refuse":
            world.refuses = value
        swap.step(now_s)
        assert swap.current.is_alive
        assert swap.current.qos == swap.qos
    samples = [sample for writer in world.writers for sample in writer.written]
    assert samples == list(range(written))
    assert all(before < after for writer in world.writers for before, after in pairwise(writer.written))
    swap.close()
    assert not world.live


@settings(deadline=None)
@given(STEPS)
def test_it_always_comes_to_rest(steps):
    """Once the middleware behaves, the last request is in force, one writer is left and nothing is to do."""
    world, swap = make()
    now_s, wanted = 0.0, FIRST
    for what, value in steps:
        if what == "request":
            wanted = qos(value)
            swap.request(wanted, hold_s=0.1)
        elif what == "wait":
            now_s += value
        elif what == "acknowledge":
            swap.current.acknowledges = value
        swap.step(now_s)
    for writer in world.live:
        writer.readers, writer.acknowledges = 1, True
    run(swap, now_s, 10.0)
    assert not swap.is_busy
    assert swap.qos == wanted
    assert world.live == [swap.current]


def test_a_swap_settles_then_switches_when_acknowledged():
    """The new writer takes over after the settle time, and the old one is gone once it is acknowledged."""
    world, swap = make()
    swap.request(qos(2), hold_s=0.1)
    swap.step(0.0)
    assert swap.state is SwapState.MATCHING
    swap.step(TIMING.settle_s - 0.001)
    assert swap.qos == FIRST
    swap.step(TIMING.settle_s)
    assert swap.qos == qos(2)
    assert world.results == [SwapResult.OK]
    swap.step(TIMING.settle_s + 0.005)
    assert world.live == [swap.current]


def test_an_unacknowledged_writer_is_held_for_then_drains_beside():
    """Holding ends after the hold time, the swap says that reordering is possible, the old writer drains."""
    world, swap = make()
    swap.current.acknowledges = False
    swap.request(qos(2), hold_s=0.2)
    swap.step(0.0)
    swap.step(0.1)
    assert swap.is_holding
    swap.step(0.29)
    assert swap.is_holding
    swap.step(0.31)
    assert world.results == [SwapResult.REORDER_POSSIBLE]
    assert len(world.live) == 2
    swap.step(0.31 + TIMING.drain_s)
    assert world.live == [swap.current]
    assert world.results[-1] is SwapResult.UNDELIVERED


def test_holding_is_capped():
    """No topic, however slow, is held longer than the maximum."""
    world, swap = make()
    swap.current.acknowledges = False
    swap.request(qos(2), hold_s=60.0)
    run(swap, 0.0, TIMING.settle_s + TIMING.hold_max_s + 0.05)
    assert world.results == [SwapResult.REORDER_POSSIBLE]


def test_readers_that_do_not_match_leave_the_old_writer():
    """A new writer nobody matches is given up, and the old one never stopped."""
    world, swap = make()
    world.readers = 0
    swap.request(qos(2), hold_s=0.1)
    run(swap, 0.0, TIMING.match_timeout_s + 0.1)
    assert world.results == [SwapResult.UNMATCHED]
    assert swap.qos == FIRST
    assert not swap.is_busy


def test_without_readers_a_swap_needs_no_acknowledgement():
    """Nobody listens, so nobody is waited for."""
    world, swap = make()
    swap.current.readers, swap.current.acknowledges = 0, False
    swap.request(qos(2), hold_s=0.3)
    run(swap, 0.0, 0.2)
    assert world.results == [SwapResult.OK]


def test_a_newer_request_supersedes_one_that_waits_for_readers():
    """The newest request wins, and the one it replaces is reported."""
    world, swap = make()
    world.readers = 0
    swap.request(qos(2), hold_s=0.1)
    swap.step(0.0)
    world.readers = 1
    swap.request(qos(3), hold_s=0.1)
    run(swap, 0.01, 1.0)
    assert world.results == [SwapResult.SUPERSEDED, SwapResult.OK]
    assert swap.qos == qos(3)


def test_requests_that_never_cease_do_not_starve_each_other():
    """Asked for something else every 50 ms, the swap still changes its writer, each time to what was newest then."""
    world, swap = make()
    now_s = 0.0
    for depth in range(2, 200):
        swap.request(qos(depth), hold_s=0.1)
        now_s = run(swap, now_s, 0.05)
    in_force = [writer.qos.depth for writer in world.writers[1:]]
    assert len(in_force) > 50
    assert in_force == sorted(in_force)
    assert set(world.results) == {SwapResult.OK}
    run(swap, now_s, 1.0)
    assert swap.qos == qos(199)


def test_a_request_back_to_what_is_in_force_only_abandons():
    """Changing one's mind costs the unfinished writer and nothing else."""
    world, swap = make()
    swap.request(qos(2), hold_s=0.1)
    swap.step(0.0)
    swap.request(FIRST, hold_s=0.1)
    run(swap, 0.01, 1.0)
    assert world.results == [SwapResult.SUPERSEDED]
    assert world.live == [world.writers[0]]


@pytest.mark.parametrize("is_under_way", [False, True])
def test_a_request_that_changes_nothing_is_no_swap(is_under_way):
    """Asking for what is in force, or already under way, makes no writer."""
    world, swap = make()
    wanted = qos(2) if is_under_way else FIRST
    if is_under_way:
        swap.request(wanted, hold_s=0.1)
        swap.step(0.0)
    writers = len(world.writers)
    swap.request(wanted, hold_s=0.1)
    swap.step(0.01)
    assert len(world.writers) == writers


def test_a_refusing_middleware_leaves_the_old_writer():
    """A writer that cannot be made is reported, and the old one stays."""
    world, swap = make()
    world.refuses = True
    swap.request(qos(2), hold_s=0.1)
    swap.step(0.0)
    assert world.results == [SwapResult.FAILED]
    assert swap.qos == FIRST
    assert not swap.is_busy


def test_a_reader_that_refuses_the_new_qos_ends_the_swap():
    """A reader the new writer would lose is noticed at once, and the old writer stays."""
    world, swap = make()
    swap.request(qos(2), hold_s=0.1)
    swap.step(0.0)
    world.live[-1].loses_readers = True
    swap.step(0.005)
    assert world.results == [SwapResult.INCOMPATIBLE]
    assert world.live == [swap.current] == world.writers[:1]


def test_a_reader_that_joins_while_samples_are_held_is_waited_for():
    """A reader only the old writer serves yet ends the holding, and the switch comes when both serve it."""
    world, swap = make()
    swap.current.acknowledges = False
    swap.request(qos(2), hold_s=0.3)
    swap.step(0.0)
    swap.step(TIMING.settle_s)
    assert swap.is_holding
    swap.current.readers = 2
    swap.step(TIMING.settle_s + 0.01)
    assert swap.state is SwapState.MATCHING
    world.live[-1].readers, swap.current.acknowledges = 2, True
    now_s = run(swap, TIMING.settle_s + 0.02, TIMING.settle_s - 0.01)
    assert swap.qos == FIRST, "the new reader's side has not settled"
    run(swap, now_s, 0.05)
    assert world.results == [SwapResult.OK]


def test_a_reader_that_keeps_coming_and_going_cannot_hold_for_ever():
    """Whatever the readers do, the swap is over when matching times out."""
    world, swap = make()
    swap.current.acknowledges = False
    swap.request(qos(2), hold_s=0.3)
    for step in range(int(1.2 * TIMING.match_timeout_s / 0.05)):
        swap.current.readers = 1 + step // 4 % 2
        swap.step(step * 0.05)
    assert len(world.results) == 1
    assert swap.state is SwapState.IDLE


def test_a_full_queue_ends_the_holding():
    """Samples are let go, by the new writer, before one of them has to be given up."""
    world, swap = make()
    swap.current.acknowledges = False
    swap.request(qos(2), hold_s=0.3)
    run(swap, 0.0, 0.12)
    assert swap.is_holding
    assert swap.most_held == 2
    swap.step(0.12, is_full=True)
    assert world.results == [SwapResult.REORDER_POSSIBLE]


def test_old_writers_do_not_pile_up():
    """While old writers wait for a reader that never acknowledges, only so many are kept; requests coalesce."""
    world, swap = make()
    now_s = 0.0
    for depth in range(2, 40):
        for writer in world.live:
            writer.acknowledges = False
        swap.request(qos(depth), hold_s=0.0)
        now_s = run(swap, now_s, 0.15)
        assert len(world.live) <= TIMING.most_draining + 1
    run(swap, now_s, TIMING.drain_s + 1.0)
    assert swap.qos == qos(39)


@pytest.mark.parametrize("seconds", [0.0, 0.05, 0.15, 0.5])
def test_nothing_happens_after_close(seconds):
    """Closed at any moment of a swap, no writer lives on and none is made, whoever still asks."""
    world, swap = make()
    swap.current.acknowledges = False
    swap.request(qos(2), hold_s=0.2)
    run(swap, 0.0, seconds)
    swap.close()
    swap.close()
    swap.request(qos(3), hold_s=0.2)
    swap.step(seconds + 1.0)
    assert not world.live
    assert not swap.is_busy


def test_a_writer_that_fails_to_close_leaves_no_other_behind():
    """When destroying one writer raises, the others are destroyed all the same."""
    world, swap = make()
    swap.request(qos(2), hold_s=0.1)
    swap.step(0.0)

    def fail():
        raise RuntimeError("the node is gone")

    world.writers[1].destroy = fail
    with pytest.raises(RuntimeError, match="the node is gone"):
        swap.close()
    assert not world.writers[0].is_alive
