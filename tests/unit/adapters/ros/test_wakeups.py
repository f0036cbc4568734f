"""Publishers that are due for the pacing thread."""

import math
import threading
import time

from hypothesis import given
from hypothesis import strategies as st

from arpd.adapters.ros.node_publishers import Wakeups

NAMES = st.sampled_from("abcd")


@given(st.lists(st.one_of(NAMES, st.tuples(NAMES, st.floats(0.0, 10.0) | st.just(math.inf)), st.floats(0.0, 10.0))))
def test_only_those_that_are_due_are_taken(events):
    """In any order of calls, those that are due are taken once, and no others."""
    wakeups: Wakeups[str] = Wakeups()
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
            wakeups.wait(0.0)
            assert wakeups.next_s() == min(due_s.values(), default=math.inf)
            assert set(wakeups.take_due(event)) == {name for name, at_s in due_s.items() if at_s <= event}
            due_s = {name: at_s for name, at_s in due_s.items() if event < at_s < math.inf}


def test_one_that_is_woken_while_it_is_served_is_due_again():
    """One that is woken while it is served is due again, regardless of its next time."""
    wakeups: Wakeups[str] = Wakeups()
    wakeups.wake("a")
    wakeups.wait(0.0)
    assert wakeups.take_due(0.0) == ["a"]
    wakeups.wake("a")
    wakeups.set("a", 100.0)
    wakeups.wait(0.0)
    assert wakeups.take_due(0.0) == ["a"]


def test_no_wake_is_lost_among_threads():
    """When many threads wake at once, each woken one is taken after its last wake."""
    wakeups: Wakeups[int] = Wakeups()
    asked = dict.fromkeys(range(8), 0)
    seen: dict[int, int] = {}

    def ask(name):
        for _ in range(2000):
            asked[name] += 1
            wakeups.wake(name)

    threads = [threading.Thread(target=ask, args=(name,)) for name in asked]
    for thread in threads:
        thread.start()
    until_s = time.monotonic() + 20
    while seen != dict.fromkeys(asked, 2000) and time.monotonic() < until_s:
        wakeups.wait(1.0)
        for name in wakeups.take_due(0.0):
            seen[name] = asked[name]
    assert seen == dict.fromkeys(asked, 2000)


def test_waiting_ends_when_told():
    """`end` lets a wait return at once, with none due."""
    wakeups: Wakeups[str] = Wakeups()
    waiter = threading.Thread(target=wakeups.wait, args=(1000.0,), daemon=True)
    waiter.start()
    wakeups.end()
    waiter.join(timeout=20)
    assert not waiter.is_alive()
    assert wakeups.take_due(math.inf) == []
