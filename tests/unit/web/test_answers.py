"""Metrics, status document and the HTTP server, over loopback."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
from prometheus_client import CollectorRegistry
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from arpd.report.status import status_document
from arpd.web.answers import HEALTHY_S
from arpd.web.metrics import SnapshotCollector
from arpd.web.server import HttpAddressError, HttpServer
from tests.unit.web_world import running

NOW_S = 1000.25


@pytest.fixture
def daemon(sample_snapshot):
    """Return snapshot, readiness and clock, as the test sets them."""
    return SimpleNamespace(snapshot=sample_snapshot, is_ready=True, now_s=NOW_S)


@pytest.fixture
def world(daemon):
    collector = SnapshotCollector(lambda: daemon.snapshot, clock=lambda: daemon.now_s)
    with running(
        snapshot=lambda: daemon.snapshot,
        collector=collector,
        is_ready=lambda: daemon.is_ready,
        clock=lambda: daemon.now_s,
    ) as world:
        yield world


def families(snapshot):
    collector = SnapshotCollector(lambda: snapshot, clock=lambda: NOW_S)
    return {family.name: family for family in collector.collect()}


def value(snapshot, name, **labels):
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(lambda: snapshot, clock=lambda: NOW_S))
    return registry.get_sample_value(name, labels)


def observe(snapshot, **changes):
    return replace(snapshot, observation=replace(snapshot.observation, **changes))


# -- metrics; tests/golden has all of them once


def test_a_topic_that_vanishes_leaves_no_series(sample_snapshot):
    """A publisher that is gone from the observation is gone from every family."""
    kept = tuple(p for p in sample_snapshot.observation.publishers if p.topic != "/imu")
    exposed = families(observe(sample_snapshot, publishers=kept)).values()
    assert not [sample for family in exposed for sample in family.samples if sample.labels.get("topic") == "/imu"]


def test_what_is_not_known_has_no_series(sample_snapshot):
    """What cannot be read or measured is absent: zero would look like a reset, a bound, or a link that is well."""
    counters = replace(sample_snapshot.observation.counters, backlog_bytes=None)
    link = replace(sample_snapshot.link, loss_ratio=None, return_delay_s=None)
    without = observe(replace(sample_snapshot, link=link), radio_bytes_per_second=None, counters=counters)
    absent = {
        "arpd_link_radio_bytes_per_second",
        "arpd_interface_backlog_bytes",
        "arpd_link_loss_ratio",
        "arpd_link_return_delay_seconds",
    }
    assert absent <= set(families(sample_snapshot))
    assert not absent & set(families(without))
    gone = observe(sample_snapshot, counters=None)
    assert value(gone, "arpd_interface_up", interface="wlan0") == 0
    assert "arpd_interface_receive_bytes" not in families(gone)
    assert value(observe(sample_snapshot, peer_ages_s={}), "arpd_peers") == 0


def test_a_publisher_announced_twice_does_not_break_the_scrape(sample_snapshot):
    """Two announcements of one publisher give one series."""
    doubled = sample_snapshot.observation.publishers * 2
    samples = families(observe(sample_snapshot, publishers=doubled))["arpd_topic_source_rate_hertz"].samples
    assert len(samples) == len({tuple(sample.labels.items()) for sample in samples}) == 4


# -- the status document


def test_the_status_document_says_infinite_as_null(sample_snapshot):
    """The document is strict JSON; unpaced rates, infinite deadlines and what no plan has are null."""
    document = json.loads(json.dumps(status_document(sample_snapshot), allow_nan=False))
    topics = {topic["topic"]: topic for topic in document["topics"]}
    assert list(topics) == ["/camera/image", "/cmd_vel", "/diagnostics", "/imu"]
    assert (topics["/imu"]["planned"]["rate_hz"], topics["/imu"]["planned"]["deadline_ns"]) == (None, None)
    assert (topics["/imu"]["confirmed"]["paced_rate_hz"], topics["/imu"]["confirmed"]["rate_hz"]) == (None, None)
    planned = topics["/camera/image"]["planned"]
    assert (planned["rate_hz"], planned["depth"], planned["deadline_ns"]) == (37.5, 10, 100_000_000)
    assert (topics["/diagnostics"]["planned"], topics["/diagnostics"]["share"]) == (None, None)
    assert (document["plan"]["publishers"], document["plan"]["confirmed"]) == (3, 2)
    assert document["totals"]["solves"] == {"closed_form": {"solved": 10}, "osqp": {"failed": 9, "solved": 8990}}
    assert document["link"]["available_bytes_per_second"] == 437_500.0


# -- the server


def test_metrics_are_served_in_the_format_asked_for(world):
    """Plain text by default, OpenMetrics when the scraper asks for it."""
    plain = world.get("/metrics?x=1")
    assert plain.headers["Content-Type"].startswith("text/plain; version=0.0.4")
    assert "\narpd_gate_ratio 0.75\n" in plain.text
    negotiated = world.get("/metrics", Accept="application/openmetrics-text; version=1.0.0")
    assert negotiated.headers["Content-Type"].startswith("application/openmetrics-text; version=1.0.0")
    assert "arpd_gate_ratio" in {family.name for family in text_string_to_metric_families(negotiated.text)}


def test_nothing_is_promised_before_the_first_tick(world, daemon):
    """Before the first snapshot: healthy, not ready, status 503, and a page all the same."""
    daemon.snapshot = None
    paths = ("/-/healthy", "/-/ready", "/api/v1/status", "/")
    assert [world.get(path).status for path in paths] == [200, 503, 503, 200]


def test_ready_needs_a_daemon_that_governs(world, daemon):
    """Ready follows is_ready once a snapshot exists."""
    assert world.get("/-/ready").status == 200
    daemon.is_ready = False
    assert world.get("/-/ready").status == 503


@pytest.mark.parametrize("has_snapshot", [False, True])
def test_a_hung_tick_is_unhealthy(world, daemon, has_snapshot):
    """When no tick has finished within the limit, health fails with the time."""
    if not has_snapshot:
        daemon.snapshot = None
    daemon.now_s += HEALTHY_S
    answer = world.get("/-/healthy")
    assert answer.status == 503
    assert "10 s" in answer.text


def test_without_scripts_the_page_has_the_verdict_as_text(world, daemon):
    """Names in the sentence never become markup or a place of the page, and the policy forbids inline scripts."""
    name = "<script>{{assets}}</script>"
    daemon.snapshot = observe(replace(daemon.snapshot, interface=name), counters=None)
    page = world.get("/")
    assert "&lt;script&gt;{{assets}}&lt;/script&gt; is gone" in page.text
    assert 'href="api/v1/status"' in page.text
    assert page.headers["Content-Security-Policy"].startswith(
        "default-src 'none'; script-src 'self'; style-src 'self';"
    )


def test_a_fault_while_answering_leaks_nothing_and_is_logged(caplog):
    """An answer that raises becomes a bare 500, and the traceback goes to the log."""

    class Broken:
        def describe(self):
            return []  # so that registering it collects nothing

        def collect(self):
            raise RuntimeError("secret")

    with running(collector=Broken()) as world:
        answer = world.get("/metrics")
        assert (answer.status, answer.text) == (500, "500 Internal Server Error\n")
        assert world.get().status == 200
    assert "secret" in caplog.text


@pytest.mark.parametrize("host", ["203.0.113.7", "no such host"])
def test_an_address_of_another_machine_is_refused_clearly(host):
    """A host of another machine gives our error, not the library's."""
    server = HttpServer(host, 0, snapshot=lambda: None, registry=CollectorRegistry())
    with pytest.raises(HttpAddressError, match=r"http\.host"):
        server.start()
