"""Course of single writer swaps; test_writer_swap_machine.py has the invariants over any sequence of events."""

import threading

import pytest

from arpd.model.endpoints import SwapResult, SwapState, SwapTiming
from tests.unit.swap_world import FIRST, make, qos

TIMING = SwapTiming()


def run(swap, start_s, seconds, *, publishing=False):
    """Let time pass; with ``publishing``, an application publishes at 200 Hz."""
    for step in range(round(seconds / 0.005)):
        swap.step(start_s + step * 0.005)
        if publishing and not swap.is_holding:
            publish(swap, start_s + step * 0.005)
    return start_s + seconds


def publish(swap, now_s, sample="sample"):
    swap._clock = lambda: now_s
    swap.write(sample)


def acknowledge(world, *, is_acknowledging=True):
    for writer in world.live:
        writer.acknowledges = is_acknowledging


@pytest.mark.parametrize(
    ("loss_ratio", "is_reliable", "settle_s"),
    [
        (0.0, True, 0.2),
        (0.0049, True, 0.2),
        (0.0, False, 1.5),
        (0.005, True, 3.0),
        (None, True, 3.0),
    ],
)
def test_on_a_clean_link_a_swap_settles_soon(loss_ratio, is_reliable, settle_s):
    """The settle time is short while the link is known to lose next to nothing, and shortest if a proof is possible."""
    world, swap = make()
    world.has_reliable_readers = is_reliable
    swap.loss_ratio = loss_ratio
    swap.request(qos(2))
    swap.step(0.0)
    swap.step(settle_s - 0.001)
    assert (swap.state, swap.qos) == (SwapState.MATCHING, FIRST)
    run(swap, settle_s, 0.05, publishing=True)
    assert world.results == [SwapResult.OK]


@pytest.mark.parametrize("is_matching", [True, False])
def test_who_hears_of_a_result_holds_up_nobody(is_matching):
    """It may wait for a thread that a signal has interrupted, and whose function destroys the writers."""
    world, swap = make()
    swap.lock, locked = threading.Lock(), []
    swap._on_result = lambda _result, _qos: locked.append(swap.lock.locked())
    swap.request(qos(2))
    swap.step(0.0)
    world.writers[1].readers = int(is_matching)
    world.writers[0].readers = 1
    run(swap, 0.0, TIMING.match_timeout_s + 0.1)
    assert locked == [False]


def settled(world, swap, wanted=None):
    """Bring a swap to WATCHING; return the time."""
    acknowledge(world, is_acknowledging=False)
    swap.request(wanted or qos(2))
    now_s = run(swap, 0.0, TIMING.settle_s + 0.01)
    assert swap.state is SwapState.WATCHING
    return now_s


def test_patience_ends_and_the_old_writer_drains_beside():
    """A writer that is never fully acknowledged is replaced too; result and record say so, and the old one drains."""
    world, swap = make()
    now_s = run(swap, settled(world, swap), TIMING.patience_s)
    world.writers[1].acknowledges = True
    publish(swap, now_s)
    now_s = run(swap, now_s, 0.01)
    assert world.results == [SwapResult.REORDER_POSSIBLE]
    assert len(world.live) == 2
    record = swap.last
    assert record is not None
    assert (record.number, record.result, record.depth) == (1, SwapResult.REORDER_POSSIBLE, 2)
    took_s = {
        SwapState.MATCHING: TIMING.settle_s,
        SwapState.WATCHING: TIMING.patience_s - TIMING.hold_s,
        SwapState.HOLDING: TIMING.hold_s,
        SwapState.PROVING: 0.0,
    }
    assert record.seconds_by_phase == pytest.approx(took_s, abs=0.04)
    run(swap, now_s, TIMING.drain_s + 0.01)
    assert world.live == [swap.current]
    assert world.results[-1] is SwapResult.UNDELIVERED


def test_what_was_held_leaves_at_twice_the_rate_at_which_it_came():
    """Without a burst, and also when no other sample follows: the last command of a robot may be among them."""
    world, swap = make()
    now_s, held_s, left_s = settled(world, swap) + TIMING.watch_s, [], []
    while (number := len(held_s)) < 25:
        publish(swap, now_s, sample=number)
        held_s.append(now_s)
        now_s += 0.01
    assert swap.is_holding
    while len(left_s) < len(held_s):
        before = len(world.log)
        swap.step(now_s := now_s + 0.001)
        left_s += [now_s] * (len(world.log) - before)
        assert len(world.log) - before <= TIMING.burst
    assert world.log == list(range(25))
    assert left_s[-1] - left_s[0] == pytest.approx((held_s[-1] - held_s[0]) / 2.0, abs=0.02)


def test_a_late_step_lets_a_few_samples_leave_at_once():
    """More would push others out of a small history."""
    world, swap = make()
    now_s = settled(world, swap) + TIMING.watch_s
    for number in range(25):
        publish(swap, now_s + 0.01 * number, sample=number)
    for late_s in (0.31, 0.61):
        swap._clock = lambda step_s=now_s + late_s: step_s
        swap.step(swap._clock())
    assert len(world.log) == 1 + TIMING.burst


def test_what_was_held_of_samples_that_come_in_pairs_is_gone_soon():
    """Also where nothing but the next pair lets it leave, as at the far end of a relay."""
    world, swap = make()
    start_s = settled(world, swap) + TIMING.watch_s
    for number in range(100):
        acknowledge(world, is_acknowledging=number > 25)
        for late_s in (0.0, 2e-5):
            publish(swap, start_s + 0.004 * number + late_s, sample=number)
        assert not swap.is_holding or number <= 26
    assert not swap.held


def proving(world, swap, wanted=None):
    """Bring a swap to PROVING; return the time."""
    now_s = settled(world, swap, wanted)
    world.writers[0].acknowledges, world.writers[1].acknowledges = True, False
    swap.step(now_s)
    assert swap.state is SwapState.PROVING
    assert swap.current is world.writers[1]
    return now_s


def test_a_new_writer_whose_readers_are_late_is_not_trusted_yet():
    """Samples leave by the old writer until those on trial are acknowledged; then the new one takes over."""
    world, swap = make()
    now_s = proving(world, swap)
    publish(swap, now_s)
    assert swap.is_holding
    now_s = run(swap, now_s, TIMING.hold_s + 0.01)
    assert swap.state is SwapState.DOUBTING
    assert swap.current is world.writers[0]
    assert swap.qos == FIRST
    now_s = run(swap, now_s, 1.0, publishing=True)
    assert len(world.writers[0].written) == 200
    acknowledge(world)
    run(swap, now_s, 0.02)
    assert world.results == [SwapResult.REORDER_POSSIBLE]
    assert world.live == [swap.current] == [world.writers[1]]


@pytest.mark.parametrize(("depth", "doubted_after_s"), [(2, TIMING.hold_s), (8, TIMING.match_timeout_s)])
def test_a_new_writer_that_proves_nothing_is_given_up(depth, doubted_after_s):
    """A sample on trial that is never acknowledged ends the swap, and is counted, whether others are held or not."""
    world, swap = make()
    now_s = proving(world, swap, qos(depth))
    publish(swap, now_s)
    run(swap, now_s, doubted_after_s + TIMING.match_timeout_s + 0.02)
    assert world.results == [SwapResult.UNMATCHED, SwapResult.UNDELIVERED]
    assert world.results_of == [qos(depth)] * 2
    assert world.live == [swap.current] == [world.writers[0]]


def test_requests_that_never_cease_do_not_starve_each_other():
    """With another request every 500 ms the writer still changes, each time to the newest one."""
    world, swap = make()
    now_s = 0.0
    for depth in range(2, 200):
        swap.request(qos(depth))
        now_s = run(swap, now_s, 0.5, publishing=True)
    in_force = [writer.qos.depth for writer in world.writers[1:]]
    assert len(in_force) > 30
    assert in_force == sorted(in_force)
    assert set(world.results) == {SwapResult.OK}
    run(swap, now_s, 5.0, publishing=True)
    assert swap.qos == qos(199)


@pytest.mark.parametrize(
    ("fault", "result"),
    [
        ({"refuses": True}, SwapResult.FAILED),
        ({"loses_readers": True}, SwapResult.INCOMPATIBLE),
        ({"readers": 0}, SwapResult.UNMATCHED),
    ],
)
def test_a_new_writer_that_cannot_take_over_leaves_the_old_one(fault, result):
    """A writer that is not made, that loses a reader or that none matches is a result, and the old one stays."""
    world, swap = make()
    vars(world).update(fault)
    swap.request(qos(2))
    run(swap, 0.0, TIMING.match_timeout_s + 0.1)
    assert world.results == [result]
    assert world.live == [swap.current] == world.writers[:1]
    assert not swap.is_busy


@pytest.mark.parametrize("is_on_trial", [False, True])
def test_a_reader_that_joins_while_the_new_writer_proves_itself_is_waited_for(is_on_trial):
    """The old writer stays until both serve that reader and the new one has proved itself again."""
    world, swap = make()
    now_s = proving(world, swap, qos(8))
    if is_on_trial:
        publish(swap, now_s)
    world.writers[0].readers = 2
    now_s = run(swap, now_s, 0.01)
    assert swap.current is world.writers[0]
    acknowledge(world)
    now_s = run(swap, now_s, 1.0, publishing=True)
    assert swap.current is world.writers[0]
    world.writers[1].readers = 2
    now_s = run(swap, now_s, TIMING.settle_s + 0.02)
    assert swap.state is SwapState.PROVING
    run(swap, now_s, 0.05, publishing=True)
    assert world.results == [SwapResult.REORDER_POSSIBLE if is_on_trial else SwapResult.OK]


def test_readers_that_keep_joining_do_not_end_a_swap():
    """Each joining reader delays the switch, all together by at most the match timeout."""
    world, swap = make()
    swap.request(qos(8))
    now_s = 0.0
    for readers in range(2, 30):
        now_s = run(swap, now_s, 0.8 * TIMING.settle_s, publishing=True)
        for writer in world.live:
            writer.readers = readers
    assert world.results == [SwapResult.OK]
    assert swap.qos == qos(8)


def test_old_writers_do_not_pile_up():
    """While a reader never acknowledges, a limited number of old writers drains, and requests coalesce."""
    world, swap = make(SwapTiming(settle_s=0.1, patience_s=0.0, drain_s=10.0))
    now_s = 0.0
    for depth in range(2, 40):
        for writer in world.live:
            writer.acknowledges = writer is not world.writers[0] and writer is swap.current
        swap.request(qos(depth))
        for _ in range(60):
            now_s = run(swap, now_s, 0.01)
            if not swap.is_holding:
                publish(swap, now_s)
            swap.current.acknowledges = swap.state is SwapState.PROVING
        assert len(world.live) <= TIMING.most_draining + 2
    assert SwapResult.UNDELIVERED in world.results
    acknowledge(world)
    run(swap, now_s, 20.0)
    assert swap.qos == qos(39)


def test_a_writer_that_fails_to_close_leaves_no_other_behind():
    """When destroying one writer raises, the others are destroyed too."""
    world, swap = make()
    swap.request(qos(2))
    swap.step(0.0)

    def fail():
        raise RuntimeError("the node is gone")

    world.writers[1].destroy = fail
    with pytest.raises(RuntimeError, match="the node is gone"):
        swap.close()
    assert not world.writers[0].is_alive
