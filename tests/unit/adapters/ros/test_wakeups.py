"""Whom the pacing thread visits, and when."""

import math
import threading
import time

from hypothesis import given
from hypothesis import strategies as st

from arpd.adapters.ros.node_publishers import Wakeups

NAMES = st.sampled_from("abcd")


@given(st.lists(st.one_of(NAMES, st.tuples(NAMES, st.floats(0.0, 10.0) | st.just(math.inf)), st.floats(0.0, 10.0))))
def test_who_is_due_is_visited_and_nobody_else(events):
    """Whatever is woken, timed and visited, in whatever order: the due ones come once, the others not."""
    visits: Wakeups[str] = Wakeups()
    due_s = {}
    for event in events:
        if isinstance(event, str):
            visits.wake(event)
            due_s[event] = -math.inf
        elif isinstance(event, tuple):
            if event[0] not in due_s:  # only one that was taken is given a time
                visits.set(*event)
                due_s[event[0]] = event[1]
        else:
            visits.wait(0.0)
            assert visits.next_s() == min(due_s.values(), default=math.inf)
            assert set(visits.take_due(event)) == {name for name, at_s in due_s.items() if at_s <= event}
            due_s = {name: at_s for name, at_s in due_s.items() if event < at_s < math.inf}


def test_a_wake_during_the_visit_means_another_one():
    """One that is woken while it is visited is visited again, whatever time its visit ends with."""
    visits: Wakeups[str] = Wakeups()
    visits.wake("a")
    visits.wait(0.0)
    assert visits.take_due(0.0) == ["a"]
    visits.wake("a")
    visits.set("a", 100.0)
    visits.wait(0.0)
    assert visits.take_due(0.0) == ["a"]


def test_no_wake_is_lost_among_threads():
    """However many threads wake at once, everyone who was woken is visited after its last wake."""
    visits: Wakeups[int] = Wakeups()
    asked = dict.fromkeys(range(8), 0)
    seen: dict[int, int] = {}

    def ask(name):
        for _ in range(2000):
            asked[name] += 1
            visits.wake(name)

    threads = [threading.Thread(target=ask, args=(name,)) for name in asked]
    for thread in threads:
        thread.start()
    until_s = time.monotonic() + 20
    while seen != dict.fromkeys(asked, 2000) and time.monotonic() < until_s:
        visits.wait(1.0)
        for name in visits.take_due(0.0):
            seen[name] = asked[name]
    assert seen == dict.fromkeys(asked, 2000)


def test_waiting_ends_when_told():
    """`end` lets a wait return at once, with nobody to visit."""
    visits: Wakeups[str] = Wakeups()
    waiter = threading.Thread(target=visits.wait, args=(1000.0,), daemon=True)
    waiter.start()
    visits.end()
    waiter.join(timeout=20)
    assert not waiter.is_alive()
    assert visits.take_due(math.inf) == []
