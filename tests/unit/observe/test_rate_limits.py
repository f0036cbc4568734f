"""Admission of messages from the network: rates, entries and refusals."""

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.adapters.ros.refused_messages import RefusedMessages
from arpd.model.observation import MessageKind, MessageRefusal
from arpd.model.probing import PeerReport, Train
from arpd.observe.peer_reports import Ceiling, PeerAdmission
from arpd.observe.rate_limits import SourceRateLimiter, TokenBucket
from arpd.observe.registry import MOST, MOST_OF_NODE, Endpoints
from tests.examples import examples
from tests.sample_publishers import publisher

REPORT = PeerReport(peer="ceddp", received_at_s=0.0, interval_s=0.1, rx_bytes=1000, rx_packets=2, last_probe=0)
HIGH = 1e12


def everybody(_node, _topic):
    return True


# -- rates


@examples(50)
@given(st.lists(st.floats(0, 100), max_size=60), st.floats(0.1, 20), st.integers(1, 10))
def test_a_bucket_lets_its_rate_and_its_burst_through(times, rate_hz, burst):
    """At any pattern of times, no more passes than burst and rate allow, and the burst always does."""
    bucket = TokenBucket(rate_hz, burst)
    passed = sum(bucket.take(now_s) for now_s in sorted(times))
    assert passed <= burst + rate_hz * (max(times, default=0.0) - min(times, default=0.0)) + 1e-6
    assert passed >= min(len(times), burst)


def test_a_flood_of_names_takes_nothing_from_those_that_are_known():
    """Invented names share one rate; the known node keeps its own."""
    limiter = SourceRateLimiter(rate_hz=2.0, burst=2.0, strangers_hz=5.0, strangers_burst=5.0)
    limiter.know(["/honest"])
    passed = 0
    for tick in range(100):
        now_s = tick / 10
        passed += sum(limiter.lets_pass(f"/invented{tick}_{k}", now_s) for k in range(100))
        if tick % 10 == 0:
            assert limiter.lets_pass("/honest", now_s)
    assert passed <= 5 + 5 * 10


def test_a_refusal_is_said_once_a_minute_and_always_counted(caplog):
    """Each source is logged once a minute; invented ones cannot fill the log."""
    now_s = 0.0
    refusals = RefusedMessages(clock=lambda: now_s)
    for now_s in (0.0, 1.0, 59.0, 61.0, 62.0):
        refusals.note(MessageKind.HEARTBEATS, MessageRefusal.RATE, f"at {now_s:g} s")
    assert [message.rpartition(": ")[2] for message in caplog.messages] == ["at 0 s", "at 61 s"]
    for k in range(10_000):
        refusals.note(MessageKind.REPORTS, MessageRefusal.QUOTA, "a lie", source=f"liar-{k}")
    assert len(caplog.messages) < 50
    assert refusals.counts == {
        (MessageKind.HEARTBEATS, MessageRefusal.RATE): 5,
        (MessageKind.REPORTS, MessageRefusal.QUOTA): 10_000,
    }


# -- endpoints


def test_an_endpoint_counts_once_the_graph_shows_it():
    """An endpoint is pending until the graph shows it, or until it falls silent."""
    endpoints = Endpoints(3.5)
    endpoints.note(publisher("/n", "/real"), 0.0)
    endpoints.note(publisher("/n", "/invented"), 0.0)
    assert (endpoints.live(0.1), endpoints.pending) == ((), 2)
    endpoints.see(lambda _node, topic: topic == "/real", 0.5)
    assert [state.topic for state in endpoints.live(0.6)] == ["/real"]
    assert endpoints.pending == 1
    assert (endpoints.live(4.0), endpoints.pending) == ((), 0)


def test_a_shown_endpoint_outlives_a_flood():
    """While a flood displaces announcements, shown endpoints are kept for longer, and invented ones are not."""
    endpoints = Endpoints(3.5)
    endpoints.see(lambda node, _topic: node == "/honest", 0.0)
    endpoints.note(publisher("/honest", "/t"), 0.0)
    endpoints.note(publisher("/invented", "/t"), 0.0)
    assert len(endpoints.live(9.0, is_flooded=True)) == 1
    assert endpoints.pending == 0
    assert not endpoints.live(9.1)


def test_a_node_has_a_bounded_number_of_entries():
    """A node that announces without end takes no entry of others, and keeps its own."""
    endpoints = Endpoints(3.5)
    endpoints.see(everybody, 0.0)
    noted = [endpoints.note(publisher("/loud", f"/t{k}"), 0.0) for k in range(2 * MOST_OF_NODE)]
    assert noted == [True] * MOST_OF_NODE + [False] * MOST_OF_NODE
    assert endpoints.note(publisher("/loud", "/t0"), 1.0)
    assert endpoints.note(publisher("/quiet", "/t"), 1.0)
    assert endpoints.note(publisher("/loud", "/late"), 1.0) is False
    endpoints.live(4.0)  # forgets what was not repeated
    assert endpoints.note(publisher("/loud", "/late"), 4.0)


def test_inventions_give_way_to_what_the_graph_shows():
    """When invented endpoints fill all entries, a real one replaces one of them; real ones stay."""
    endpoints = Endpoints(3.5)
    endpoints.see(lambda node, _topic: node == "/honest", 0.0)
    assert endpoints.note(publisher("/honest", "/first"), 0.0)
    taken = sum(endpoints.note(publisher(f"/invented{k}", "/t"), 0.1) for k in range(2 * MOST))
    assert taken == MOST - 1
    assert endpoints.note(publisher("/honest", "/second"), 0.2)
    assert [state.topic for state in endpoints.live(0.3)] == ["/first", "/second"]


@examples(40)
@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 4), st.booleans(), st.floats(0, 4)), max_size=60))
def test_nothing_lives_that_is_not_both_shown_and_announced(events):
    """At any order of events, a live endpoint was shown in the last 10 s and announced itself lately."""
    endpoints = Endpoints(3.5)
    now_s, shown_s, announced_s = 0.0, {}, {}
    shown: frozenset[Any] = frozenset()
    for node, topic, is_graph, pause_s in events:
        now_s += pause_s
        key = (f"/n{node}", f"/t{topic}")
        shown_s.update(dict.fromkeys(shown, now_s))
        if is_graph:
            shown = shown ^ {key}
            endpoints.see(lambda *known, shown=shown: known in shown, now_s)
        else:
            endpoints.note(publisher(*key), now_s)
            announced_s[key] = now_s
        live = {(state.node, state.topic) for state in endpoints.live(now_s)}
        for key in live:
            assert now_s - announced_s[key] <= 3.5
            assert key in shown or now_s - shown_s[key] <= 10.0
        assert {key for key in shown if now_s - announced_s.get(key, -9.0) <= 3.5} <= live


# -- reports


def answering(admission, probe, **fields):
    return replace(REPORT, last_probe=admission.number(probe), **fields)


@pytest.mark.parametrize("base", [0, 1, 2**31, 2**32 - 1])
def test_a_report_must_answer_a_probe_that_was_sent(base):
    """Only the number of a recent probe is an answer; it comes back as our own number."""
    admission: Any = PeerAdmission(base)
    admission.see(1)
    for probe in range(1, 4):
        admission.number(probe)
    answer = answering(admission, 3)
    assert admission.check(answer, 0.0, ceiling=HIGH).last_probe == 3
    for guess in (0, (base + 4) % 2**32, base, (base - 5) % 2**32, 4711):
        if (guess - base) % 2**32 not in (1, 2, 3) or guess == 0:
            assert admission.check(replace(REPORT, last_probe=guess), 0.0, ceiling=HIGH) is MessageRefusal.UNANSWERED
    admission.number(5000)
    assert admission.check(answer, 0.0, ceiling=HIGH) is MessageRefusal.UNANSWERED  # too old


def test_no_more_peers_are_believed_than_there_are():
    """Invented peers get at most as many entries as the graph shows, and never that of a known peer."""
    admission: Any = PeerAdmission(9)
    admission.see(2)
    for tick in range(200):
        now_s = tick / 10
        assert isinstance(admission.check(answering(admission, 1), now_s, ceiling=HIGH), PeerReport)
        results = [
            admission.check(answering(admission, 1, peer=f"liar-{tick}-{k}"), now_s, ceiling=HIGH) for k in range(5)
        ]
        assert sum(isinstance(result, PeerReport) for result in results) <= 1


def test_a_peer_that_floods_is_held_to_its_rate():
    """Of ten thousand reports in a second about ninety are read."""
    admission: Any = PeerAdmission(9)
    admission.see(1)
    results = [admission.check(answering(admission, 1), k / 10_000, ceiling=HIGH) for k in range(10_000)]
    assert 60 <= sum(isinstance(result, PeerReport) for result in results) <= 95
    assert results[-1] is MessageRefusal.RATE


def test_no_report_exceeds_what_the_link_can_do():
    """Bytes and trains above the upper bound count as the bound."""
    admission: Any = PeerAdmission(9)
    fast = Train(payload_bytes=1_000_000, duration_s=1e-6, packets=24)
    slow = Train(payload_bytes=1000, duration_s=0.5, packets=24)
    admitted = admission.check(answering(admission, 1, rx_bytes=2**32 - 1, trains=(fast, slow)), 0.0, ceiling=2e6)
    assert admitted.rx_bytes == 200_000
    assert admitted.trains[0].rate_bytes_per_second == pytest.approx(2_000_000.0)
    assert admitted.trains[1] == slow


def test_the_ceiling_is_the_lowest_bound():
    """The speed of a wired interface, twice the best recent rate of the radio, and 100 Gbit/s in any case."""
    ceiling = Ceiling()
    assert ceiling.bytes_per_second == 12.5e9
    ceiling.note(0.0, interface=125e6, radio=None)
    assert ceiling.bytes_per_second == 125e6
    ceiling.note(1.0, interface=None, radio=8e6)
    ceiling.note(30.0, interface=None, radio=1e6)  # it idles
    assert ceiling.bytes_per_second == 16e6
    ceiling.note(80.0, interface=None, radio=1e6)
    assert ceiling.bytes_per_second == 2e6
