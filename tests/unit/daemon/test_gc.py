"""Garbage collection of the daemon: between ticks, and before there is too much."""

import gc
import weakref

import pytest

from arpd.daemon.gc import EVERY_S, MOST_NEW, Garbage


class Loop:
    """An object that refers to itself, so that only a collection frees it."""

    def __init__(self):
        self.itself = self


@pytest.fixture
def now_s():
    return [100.0]


@pytest.fixture
def garbage(now_s):
    garbage = Garbage(clock=lambda: now_s[0])
    garbage.take_over()
    yield garbage
    gc.unfreeze()
    gc.enable()


def test_nothing_is_collected_before_it_is_due(garbage, now_s):
    """Allocations start no collection before 30 s have passed, and again after each."""
    for _ in range(2):
        lost = weakref.ref(Loop())
        for _ in range(50):
            [[] for _ in range(1000)]
        garbage.collect_if_due()
        assert lost() is not None
        now_s[0] += EVERY_S
        garbage.collect_if_due()
        assert lost() is None


def test_much_garbage_is_collected_early(garbage):
    """Many new objects are collected before the time is over."""
    lost = [weakref.ref(Loop()) for _ in range(MOST_NEW // 2)]
    garbage.collect_if_due()
    assert lost[0]() is None
