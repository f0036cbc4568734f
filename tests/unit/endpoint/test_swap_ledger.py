"""Time of a swap, phase by phase."""

import pytest

from arpd.endpoint.writer_swap import SwapState, SwapTiming
from arpd.model.endpoints import SwapPhase, SwapResult
from tests.unit.swap_world import make, qos

TIMING = SwapTiming()
STEP_S = 0.01


def run(swap, start_s, seconds):
    for step in range(round(seconds / STEP_S)):
        swap.step(start_s + step * STEP_S)
    return start_s + seconds


def test_a_swap_that_waits_for_acknowledgements_says_for_how_long():
    """Each phase has its time, watching before and after holding is added up, and draining follows the record."""
    world, swap = make()
    swap.current.acknowledges = False
    swap.request(qos(4))
    now_s = run(swap, 100.0, TIMING.settle_s + TIMING.patience_s + STEP_S)
    assert swap.state is SwapState.PROVING
    assert swap.ledger.begun == 1
    assert not world.results
    now_s = run(swap, now_s, 0.5)
    swap.current.publish("sample")
    swap.wrote(now_s)
    now_s = run(swap, now_s, STEP_S)
    record = swap.ledger.last
    assert record is not None
    assert (record.number, record.result, record.depth) == (1, SwapResult.REORDER_POSSIBLE, 4)
    expected = {
        SwapPhase.MATCHING: TIMING.settle_s,
        SwapPhase.WATCHING: TIMING.patience_s - TIMING.hold_s,
        SwapPhase.HOLDING: TIMING.hold_s,
        SwapPhase.PROVING: 0.5,
    }
    assert record.seconds_by_phase == pytest.approx(expected, abs=4 * STEP_S)
    run(swap, now_s, TIMING.drain_s + STEP_S)
    assert world.results[-1] is SwapResult.UNDELIVERED
    assert swap.ledger.last is record
    drained = {SwapPhase.DRAINING: TIMING.drain_s}
    assert swap.ledger.seconds_by_phase == pytest.approx(expected | drained, abs=4 * STEP_S)
