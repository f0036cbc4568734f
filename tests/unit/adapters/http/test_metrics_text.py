"""Metrics as text: the bytes of prometheus_client, for all labels and formats."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st
from prometheus_client import CollectorRegistry, exposition
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    StateSetMetricFamily,
    SummaryMetricFamily,
    UnknownMetricFamily,
)

from arpd.adapters.http.exposition import Exposition, choose_encoder
from arpd.adapters.http.families import counter_by, gauge_by
from arpd.adapters.http.metrics import make_registry
from tests.sample_publishers import publisher

ACCEPTS = (
    "",
    "text/plain",
    "text/plain;version=0.0.4",
    "text/plain;version=1.0.0;escaping=allow-utf-8",
    "application/openmetrics-text",
    "application/openmetrics-text;version=1.0.0,application/openmetrics-text;version=0.0.1;q=0.75,text/plain;q=0.5",
    "application/openmetrics-text;version=1.0.0;escaping=allow-utf-8",
    "application/openmetrics-text;version=1.0.0;escaping=values",
    "application/openmetrics-text;version=1.0.0;escaping=dots",
    "text/plain;version=1.0.0;escaping=dots",
)


class Collected:
    """A registry that always holds the same families."""

    def __init__(self, families):
        self._families = families

    def collect(self):
        return iter(self._families)


def assert_same(registry):
    for accept in ACCEPTS:
        encode, content_type = choose_encoder(accept)
        theirs, their_type = exposition.choose_encoder(accept)
        assert (encode(registry).decode(), content_type) == (theirs(registry).decode(), their_type)


@given(
    text=st.text() | st.sampled_from(["a\\b", 'say "so"', "two\nlines", "Ωß\u2028"]),
    values=st.lists(st.text(), min_size=1, max_size=3),
    number=st.floats().map(lambda number: number + 0.0) | st.integers(-(10**20), 10**20) | st.booleans(),
)
def test_every_kind_of_family_reads_as_prometheus_client_writes_it(text, values, number):
    """Quotes, backslashes, newlines, infinities and large numbers are written alike, with and without labels."""
    families = [
        GaugeMetricFamily("a_gauge", text, value=number),
        CounterMetricFamily("a_counter", text, value=number),
        UnknownMetricFamily("unknown", text, value=number),
        InfoMetricFamily("about", text, value={"version": values[0], "name": text}),
        GaugeMetricFamily("a_size", text, value=number, unit="bytes"),
        HistogramMetricFamily("spans", text, buckets=[("1.0", 1), ("+Inf", 2)], sum_value=3.5),
        SummaryMetricFamily("sums", text, count_value=3, sum_value=2.5),
        StateSetMetricFamily("state", text, value={"on": True, "off": False}),
        GaugeMetricFamily("nothing", text, labels=("one",)),
    ]
    for family in (
        GaugeMetricFamily("labelled", text, labels=("zone", "one")),
        CounterMetricFamily("labelled_counter", text, labels=("one",)),
    ):
        for value in values:
            family.add_metric([value, text][: len(family._labelnames)], number)
        families.append(family)
    assert_same(Collected(families))


def test_arpds_own_registry_reads_as_prometheus_client_writes_it(sample_snapshot):
    """The metrics of the daemon, of the process and of Python are written alike."""
    registry = make_registry(lambda: sample_snapshot)
    collected = Collected(list(registry.collect()))
    assert_same(collected)


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


@pytest.mark.parametrize("accept", ["", "application/openmetrics-text;version=1.0.0"])
def test_a_label_is_escaped_once_however_many_metrics_a_topic_has(sample_snapshot, accept):
    """The work grows with the label sets instead of the samples, which makes a thousand topics cheap."""
    crowd = tuple(publisher("/node", f"/topic{number}") for number in range(20))
    crowded = replace(sample_snapshot, observation=replace(sample_snapshot.observation, publishers=crowd))
    encode, _ = choose_encoder(accept)
    with patch("arpd.adapters.http.exposition._escaped", side_effect=lambda text: text) as escaped:
        text = encode(make_registry(lambda: crowded)).decode()
    written = sum(call.args[0].startswith("/topic") for call in escaped.call_args_list)
    assert written < 0.75 * text.count('topic="/topic')


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
    exposition.answer("")
    exposition.answer("application/openmetrics-text;version=1.0.0")
    assert registry.collected == before + 2
