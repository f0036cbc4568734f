"""Metrics, documents and the HTTP server, over loopback."""

import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest
from prometheus_client import CollectorRegistry
from prometheus_client.parser import text_string_to_metric_families
from tornado.netutil import bind_sockets

from arpd.model.relay import RelaySummary, RelayTopics
from arpd.model.settings import HttpSettings
from arpd.report.situation import judge
from arpd.web.metrics import SnapshotCollector
from tests.golden.sample import changed
from tests.unit.web_world import running, server_of
from tests.waiting import eventually

NOW_S = 1000.25


@pytest.fixture
def daemon(sample_snapshot):
    """Return snapshot and clock, as the test sets them."""
    return SimpleNamespace(snapshot=sample_snapshot, now_s=NOW_S)


@pytest.fixture
def world(daemon):
    with running(snapshot=lambda: daemon.snapshot, clock=lambda: daemon.now_s) as world:
        yield world


def families(snapshot):
    return {family.name: family for family in SnapshotCollector(lambda: snapshot, clock=lambda: NOW_S).collect()}


def value(snapshot, name, **labels):
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(lambda: snapshot, clock=lambda: NOW_S))
    return registry.get_sample_value(name, labels)


# -- metrics; tests/golden has all of them once


def test_a_topic_that_vanishes_leaves_no_series(sample_snapshot):
    """A publisher that is gone from the observation is gone from every family."""
    kept = tuple(p for p in sample_snapshot.observation.publishers if p.topic != "/imu")
    exposed = families(changed(observation={"publishers": kept})).values()
    assert not [sample for family in exposed for sample in family.samples if sample.labels.get("topic") == "/imu"]


def test_what_is_not_known_has_no_series(sample_snapshot):
    """What cannot be read or measured is absent: zero would look like a reset, a bound, or a link that is well."""
    unknown = {"observation": {"radio_bytes_per_second": None, "counters": None, "peer_ages_s": {}}}
    without = changed(link={"loss_ratio": None, "return_delay_s": None}, **unknown)
    absent = {f"arpd_link_{name}" for name in ("radio_bytes_per_second", "loss_ratio", "return_delay_seconds")}
    absent.add("arpd_interface_transmit_bytes")
    assert absent <= set(families(sample_snapshot))
    assert not absent & set(families(without))
    assert value(without, "arpd_link_interface_state", interface="wlan0", state="gone") == 1
    assert value(without, "arpd_peers") == 0


def test_a_publisher_announced_twice_does_not_break_the_scrape(sample_snapshot):
    """Two announcements of one publisher give one series."""
    doubled = sample_snapshot.observation.publishers * 2
    samples = families(changed(observation={"publishers": doubled}))["arpd_topic_source_rate_hertz"].samples
    assert len(samples) == len({tuple(sample.labels.items()) for sample in samples}) == 4


@pytest.mark.parametrize(
    ("relay", "is_silent", "found"),
    [
        (None, False, {}),
        (None, True, {"relay_end_up": 0}),  # its last counts would look as if they were new
        (RelaySummary(is_reachable=True), False, {"relay_end_up": 1, "relay_other_end_up": 1}),
        (RelaySummary(is_reachable=True, fault="another version"), False, {"relay_other_end_up": 0}),
        (RelaySummary(other_host="base"), False, {"relay_other_end_up": 0}),
    ],
)
def test_an_end_is_up_while_it_is_heard_and_understood(relay, is_silent, found):
    """Without two ends there is no series, and of a silent end nothing but that."""
    snapshot = changed(observation={"relay": relay, "is_relay_silent": is_silent})
    assert {name: value(snapshot, f"arpd_{name}") for name in found} == found
    assert {name.startswith("arpd_relay") for name in families(snapshot)} == ({True, False} if found else {False})
    assert ("arpd_relay_topics" in families(snapshot)) is (relay is not None)


def test_no_message_adds_a_label():
    """Refused topics are counted by direction, and an unknown reason of failed calls has no series."""
    refused = RelayTopics(refused={"/a": "b", "/c": "d"})
    relay = RelaySummary(to_robot=refused, calls_failed={"timeout": 2, "invented": 9})
    snapshot = changed(observation={"relay": relay})
    assert value(snapshot, "arpd_relay_topics", direction="to_robot", state="refused") == 2
    assert value(snapshot, "arpd_relay_calls_failed_total", reason="timeout") == 2
    assert value(snapshot, "arpd_relay_calls_failed_total", reason="invented") is None


# -- the server


def test_nothing_is_promised_before_the_first_tick(world, daemon):
    """Before the first snapshot: no status, and a page all the same."""
    daemon.snapshot = None
    paths = ("/api/v1/status", "/", "/api/v1/history")
    assert [world.get(path).status for path in paths] == [503, 200, 200]


def test_who_asks_at_the_same_time_shares_one_document(sample_snapshot, monkeypatch):
    """Twelve requests that wait for a tick are answered by one document, and no piece of it is made in the tick."""
    asked, judged, resting = [], [], threading.Event()

    def judge_between_ticks(*arguments, **options):
        judged.append(resting.is_set())
        return judge(*arguments, **options)

    monkeypatch.setattr("arpd.web.api.judge", judge_between_ticks)
    with (
        running(snapshot=lambda: asked.append(1) or sample_snapshot, resting=resting) as world,
        ThreadPoolExecutor(12) as threads,
    ):
        answers = [threads.submit(world.get, "/api/v1/status") for _ in range(12)]
        eventually("the server has begun", lambda: asked)
        resting.set()
        assert len({answer.result().text for answer in answers}) < 12
    assert len(asked) < 12
    assert judged
    assert all(judged)


def test_a_tick_that_hangs_does_not_keep_the_metrics_back(sample_snapshot):
    """The server waits for a running tick for a second in all, not for good; every family is there once."""
    with running(snapshot=lambda: sample_snapshot, resting=threading.Event()) as world:
        answer = world.get("/metrics?x=1")
    assert answer.headers["Content-Type"] == "text/plain; version=0.0.4; charset=utf-8"
    names = [family.name for family in text_string_to_metric_families(answer.text)]
    assert len(names) == len(set(names))
    assert {"arpd_allowed_ratio", "arpd_http_requests", "process_cpu_seconds"} <= set(names)


def test_a_fault_while_answering_leaks_nothing_and_is_logged(caplog):
    """An answer that raises becomes a bare 500, and the traceback goes to the log."""
    caplog.set_level("ERROR", "tornado.application")  # which `arpd status` silences in its own process
    broken = SimpleNamespace(finished_at_s=NOW_S)
    with running(snapshot=lambda: broken, clock=lambda: NOW_S) as world:
        answer = world.get("/metrics")
        assert (answer.status, answer.text) == (500, "500 Internal Server Error\n")
        assert world.get().status == 200
    assert "AttributeError" in caplog.text


def test_a_name_server_that_is_silent_keeps_no_daemon_from_its_first_tick(monkeypatch):
    """While ``http.host`` is looked up the daemon goes on, and the server listens later."""
    answers = threading.Event()
    monkeypatch.setattr("arpd.web.server._WAIT_S", 0.02)
    monkeypatch.setattr("arpd.web.server.bind_sockets", lambda *at, **_: answers.wait(60.0) and bind_sockets(*at))
    server = server_of(HttpSettings(port=0))
    with server.up():
        assert not server.port
        answers.set()
        eventually("it serves", lambda: server.port)


def test_a_port_that_is_taken_is_tried_again(caplog, monkeypatch):
    """The daemon goes on without metrics, logs once which keys to change, and serves as soon as the port is free."""
    monkeypatch.setattr("arpd.web.server._LOOK_S", 0.02)
    caplog.set_level("INFO", "arpd.web.server")
    with socket.create_server(("127.0.0.1", 0)) as other:
        port, tries = other.getsockname()[1], []
        monkeypatch.setattr(
            "arpd.web.server.bind_sockets", lambda *at, **options: tries.append(at) or bind_sockets(*at, **options)
        )
        server = server_of(HttpSettings(port=port))
        with server.up():
            eventually("it has tried again", lambda: len(tries) > 2)
            assert f"cannot listen on 127.0.0.1:{port}" in server.fault
            other.close()
            eventually("it serves", lambda: not server.fault)
            assert server.port == port
    assert [record.levelname for record in caplog.records] == ["ERROR", "INFO"]
    assert "Set http.host and http.port" in caplog.text
