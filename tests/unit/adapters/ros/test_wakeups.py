"""Publishers that are due for the pacing thread, and their order."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.adapters.ros.wakeups import Wakeups

SIZES = {"a": 300.0, "b": 20.0, "c": 30_000.0, "d": 300_000.0}
NAMES = st.sampled_from(sorted(SIZES))


def taken(wakeups, now_s):
    """Take all that are due."""
    wakeups.look(now_s)
    return list(iter(lambda: wakeups.take(now_s), None))


@pytest.fixture
def wakeups():
    return Wakeups(SIZES.__getitem__)


@given(st.lists(st.one_of(NAMES, st.tuples(NAMES, st.floats(0.0, 10.0) | st.just(math.inf)), st.floats(0.0, 10.0))))
def test_only_those_that_are_due_are_taken(events):
    """In any order of calls, those that are due are taken once, and no others."""
    wakeups: Wakeups[str] = Wakeups(SIZES.__getitem__)
    due_s = {}
    for event in events:
        if isinstance(event, str):
            wakeups.wake(event)
            due_s[event] = -math.inf
        elif isinstance(event, tuple):
            if event[0] not in due_s:  # only a taken one is given a time
                wakeups.set(*event)
                due_s[event[0]] = event[1]
        else:
            wakeups.look(event)
            due = {name for name, at_s in due_s.items() if at_s <= event}
            assert wakeups.next_s() == (-math.inf if due else min(due_s.values(), default=math.inf))
            assert sorted(taken(wakeups, event)) == sorted(due)
            due_s = {name: at_s for name, at_s in due_s.items() if event < at_s < math.inf}


def test_one_that_becomes_due_meanwhile_comes_before_larger_ones(wakeups):
    """Between two large ones a small one is found and taken."""
    wakeups.wake("c")
    wakeups.wake("d")
    wakeups.look(0.0)
    assert wakeups.take(0.0) == "c"
    wakeups.set("a", 0.05)
    wakeups.wake("b")
    wakeups.look(0.1)
    assert [wakeups.take(0.1) for _ in range(4)] == ["b", "a", "d", None]


def test_a_large_one_is_taken_in_the_end(wakeups):
    """Beside small ones that are always due, large ones are taken too, once a second at most."""
    wakeups.wake("c")
    wakeups.wake("d")
    served = []
    for step in range(1000):
        now_s = step * 0.01
        wakeups.wake("a")
        wakeups.look(now_s)
        served.append(wakeups.take(now_s))
        if served[-1] != "a":
            wakeups.wake(served[-1])
    at_s = [step * 0.01 for step, name in enumerate(served) if name != "a"]
    assert 7 <= len(at_s) <= 10
    assert all(later - earlier > 1.0 for earlier, later in itertools.pairwise(at_s))
    assert {"c", "d"} < set(served)


def test_one_that_is_woken_while_it_is_served_is_due_again(wakeups):
    """One that is woken while it is served is due again, regardless of its next time."""
    wakeups.wake("a")
    assert taken(wakeups, 0.0) == ["a"]
    wakeups.wake("a")
    wakeups.set("a", 100.0)
    wakeups.wait(0.0)
    assert taken(wakeups, 0.0) == ["a"]
