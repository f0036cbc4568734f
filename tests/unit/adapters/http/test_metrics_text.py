"""Metrics as text: made once for all who ask, and beside the tick."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from prometheus_client import CollectorRegistry
from prometheus_client.core import GaugeMetricFamily

from arpd.adapters.http.exposition import Exposition, choose_encoder
from arpd.adapters.http.families import counter_by, gauge_by


def test_an_accept_header_that_prometheus_client_trips_over_is_answered():
    """A version that is no number is no reason to answer nothing; an older prometheus_client does not look at it."""
    encode, content_type = choose_encoder("application/openmetrics-text;version=x")
    ends = {"text/plain": b"", "application/openmetrics-text": b"# EOF\n"}
    assert encode(CollectorRegistry()) == ends[content_type.split(";")[0]]


def test_an_unknown_value_of_a_label_is_shown_beside_the_known_ones():
    """A value that a newer node announces is kept, and known values start at zero."""
    family = counter_by("swaps", "Swaps.", "result", ("ok", "failed"), [({"topic": "/a"}, {"ok": 2, "odd": 1})])
    assert [(each.labels["result"], each.value) for each in family.samples] == [("failed", 0), ("odd", 1), ("ok", 2)]
    states = gauge_by("state", "State.", "state", ("b", "a"), [({}, "a")])
    assert [(each.labels["state"], each.value) for each in states.samples] == [("a", 1), ("b", 0)]


# -- beside the tick


class Slow:
    """A registry of many samples that counts its collections and calls the test at every family."""

    def __init__(self, at_family=lambda: None):
        self.collected = 0
        self._at_family = at_family

    def collect(self):
        self.collected += 1
        for name in ("one", "two", "three"):
            family = GaugeMetricFamily(name, "Some.", labels=("number",))
            for number in range(1200):
                family.add_metric([str(number)], number)
            self._at_family()
            yield family


class Resting:
    """An event that is set after a number of waits, and a clock that moves with them."""

    def __init__(self, waits):
        self.now_s, self.waits, self.waited = 0.0, waits, 0

    def is_set(self):
        return self.waited >= self.waits

    def wait(self, timeout):
        self.waited += 1
        self.now_s += min(0.4, timeout)

    def clock(self):
        return self.now_s


@pytest.mark.parametrize("accept", ["", "application/openmetrics-text;version=1.0.0"])
def test_nothing_is_written_while_a_tick_runs(accept):
    """A client that asks during a tick gets the answer after it, and a tick that begins interrupts the work."""
    resting, seen = threading.Event(), []
    exposition = Exposition(Slow(lambda: seen.append(resting.is_set())), resting=resting)
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(exposition.answer, accept)
        while not seen:  # the first family is collected, and none of its samples may be written
            pass
        assert not asked.done()
        resting.set()
        text, content_type = asked.result(10.0)
    assert (text, content_type) == Exposition(Slow()).answer(accept)


def test_a_tick_that_hangs_does_not_keep_the_metrics_from_whoever_needs_them_now():
    """All waits of one answer together take a second at most."""
    resting: Any = Resting(waits=1000)
    text, _ = Exposition(Slow(), resting=resting, clock=resting.clock).answer("")
    assert text == Exposition(Slow()).answer("")[0]
    assert resting.now_s == pytest.approx(1.0)
    patient: Any = Resting(waits=2)
    Exposition(Slow(), resting=patient, clock=patient.clock).answer("")
    assert patient.waited == 2


def test_who_asks_at_the_same_time_gets_the_same_text():
    """Four clients that ask while one text is made cost one more at most; a later client gets a new text."""
    go, begun, asked = threading.Event(), threading.Event(), threading.Semaphore(0)

    def at_family():
        begun.set()
        assert go.wait(10.0)

    def clock():
        asked.release()  # a client looks at the clock when it asks
        return time.monotonic()

    registry = Slow(at_family)
    exposition = Exposition(registry, clock=clock)
    with ThreadPoolExecutor(5) as pool:
        first = pool.submit(exposition.answer, "")
        assert begun.wait(10.0)
        others = [pool.submit(exposition.answer, "") for _ in range(4)]
        assert all(asked.acquire(timeout=10.0) for _ in range(5))
        go.set()
        answers = {each.result(10.0) for each in (first, *others)}
    assert len(answers) == 1
    assert registry.collected <= 2
    before = registry.collected
    exposition.answer("", asked_s=0.0)  # it waited for a thread meanwhile
    assert registry.collected == before
    exposition.answer("")
    exposition.answer("application/openmetrics-text;version=1.0.0")
    assert registry.collected == before + 2
