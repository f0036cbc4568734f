"""Metrics, status document and the HTTP server, over loopback."""

from __future__ import annotations

import json
import math
import socket
import threading
import urllib.error
import urllib.request
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from http.client import HTTPConnection
from types import SimpleNamespace

import pytest
from prometheus_client import CollectorRegistry
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from arpd.adapters.http.answers import HEALTHY_S
from arpd.adapters.http.connection_limit import MAX_PLACES
from arpd.adapters.http.metrics import SnapshotCollector, make_registry
from arpd.adapters.http.server import HttpAddressError, HttpServer
from arpd.model.allocation import AllocationStatus
from arpd.model.endpoints import RefusalReason, SwapPhase, WithheldCause
from arpd.model.interface import InterfaceState
from arpd.model.link import EstimatorEvent
from arpd.report.events import EventKind
from arpd.report.snapshot import Totals
from arpd.report.status import status_document
from tests.unit.drawn import printed


@dataclass
class World:
    """Snapshot, readiness and clock, as a test sets them."""

    snapshot: object = None
    is_ready: bool = True
    now_s: float = 1000.25
    server: HttpServer = field(init=False)

    def get(self, path, method="GET", **headers):
        connection = HTTPConnection("127.0.0.1", self.server.port, timeout=5.0)
        try:
            connection.request(method, path, headers=headers)
            answer = connection.getresponse()
            return SimpleNamespace(status=answer.status, headers=answer.headers, text=answer.read().decode())
        finally:
            connection.close()


@contextmanager
def serving(world, collector=None):
    registry = CollectorRegistry()
    registry.register(collector or SnapshotCollector(lambda: world.snapshot, clock=lambda: world.now_s))
    world.server = HttpServer(
        "127.0.0.1",
        0,
        snapshot=lambda: world.snapshot,
        registry=registry,
        is_ready=lambda: world.is_ready,
        clock=lambda: world.now_s,
    )
    world.server.start()
    try:
        yield world
    finally:
        world.server.stop()


@pytest.fixture
def world(sample_snapshot):
    with serving(World(snapshot=sample_snapshot)) as running:
        yield running


def families(snapshot):
    collector = SnapshotCollector(lambda: snapshot, clock=lambda: 1000.25)
    return {family.name: family for family in collector.collect()}


def value(snapshot, name, **labels):
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(lambda: snapshot, clock=lambda: 1000.25))
    return registry.get_sample_value(name, labels)


def observe(snapshot, **changes):
    return replace(snapshot, observation=replace(snapshot.observation, **changes))


# -- metrics


def test_before_the_first_tick_only_the_build_and_readiness_are_exposed():
    """Without a snapshot there are two families, and the daemon is not ready."""
    assert set(families(None)) == {"arpd_build", "arpd_ready"}
    assert value(None, "arpd_ready") == 0


def test_a_topic_that_vanishes_leaves_no_series(sample_snapshot):
    """A publisher that is gone from the observation is gone from every family."""
    kept = tuple(p for p in sample_snapshot.observation.publishers if p.topic != "/imu")
    exposed = families(observe(sample_snapshot, publishers=kept)).values()
    assert not [sample for family in exposed for sample in family.samples if sample.labels.get("topic") == "/imu"]


def test_a_publisher_announced_twice_does_not_break_the_scrape(sample_snapshot):
    """Two announcements of one publisher give one series."""
    doubled = sample_snapshot.observation.publishers * 2
    samples = families(observe(sample_snapshot, publishers=doubled))["arpd_topic_source_rate_hertz"].samples
    assert len(samples) == len({tuple(sample.labels.items()) for sample in samples}) == 4


def test_an_unreadable_interface_is_down_and_has_no_counters(sample_snapshot):
    """A counter that cannot be read is absent, never zero: zero would look like a reset."""
    gone = observe(sample_snapshot, counters=None)
    assert value(gone, "arpd_interface_up", interface="wlan0") == 0
    assert "arpd_interface_receive_bytes" not in families(gone)


@pytest.mark.parametrize("state", InterfaceState)
def test_what_the_interface_can_do_shows_everywhere(sample_snapshot, state):
    """Metric, status, verdict and terminal name the state of the interface; the latter two only when it is amiss."""
    counters = sample_snapshot.observation.counters
    is_gone = state is InterfaceState.GONE
    seen = observe(sample_snapshot, counters=None if is_gone else replace(counters, interface="wlan7", state=state))
    marks = families(seen)["arpd_link_interface_state"].samples
    assert [sample.labels["state"] for sample in marks if sample.value] == [state]
    assert {sample.labels["interface"] for sample in marks} == {"wlan0"}
    assert value(seen, "arpd_interface_up", interface="wlan0") == (state is InterfaceState.UP)
    document = json.loads(json.dumps(status_document(seen, now_s=1000.25)))
    assert document["interface_state"] == state
    assert (document["interface_counters"] is None) is is_gone
    words = {"up": "", "no_carrier": "has no carrier", "down": "is switched off", "gone": "is gone"}[state]
    for text in (document["verdict"]["text"], "\n".join(printed(document))):
        found = [said for said in ("has no carrier", "is switched off", "is gone") if said in text]
        assert found == ([words] if words else [])


def test_a_radio_and_a_queue_that_tell_have_a_series_and_others_have_none(sample_snapshot):
    """A bound that is not known is absent: zero would be a bound."""
    name = "arpd_link_radio_bytes_per_second"
    assert value(sample_snapshot, name, interface="wlan0") == 8_125_000
    assert status_document(sample_snapshot)["link"]["radio_bytes_per_second"] == 8_125_000
    counters = replace(sample_snapshot.observation.counters, backlog_bytes=None)
    without = observe(sample_snapshot, radio_bytes_per_second=None, counters=counters)
    assert name not in families(without)
    assert "arpd_interface_backlog_bytes" not in families(without)
    assert status_document(without)["interface_counters"]["backlog_bytes"] is None
    assert status_document(without)["link"]["radio_bytes_per_second"] is None


def test_every_peer_shows_with_the_age_of_its_last_report(sample_snapshot):
    """Each live peer has a series and a line in the document; without any, the count is 0."""
    assert value(sample_snapshot, "arpd_peers") == 2
    assert value(sample_snapshot, "arpd_peer_report_age_seconds", peer="edge-c001") == 12.5
    assert status_document(sample_snapshot)["peers"] == [
        {
            "peer": "ceddp-3f2a",
            "report_age_seconds": 0.06,
            "clock_offset_seconds": -0.75,
            "clock_uncertainty_seconds": 0.0039062,
        },
        {
            "peer": "edge-c001",
            "report_age_seconds": 12.5,
            "clock_offset_seconds": None,
            "clock_uncertainty_seconds": None,
        },
    ]
    nobody = observe(sample_snapshot, peer_ages_s={})
    assert (value(nobody, "arpd_peers"), status_document(nobody)["peers"]) == (0, [])


def test_exactly_one_state_of_every_set_holds(sample_snapshot):
    """State sets sum to one, also for a solver this version does not know."""
    odd = replace(
        sample_snapshot,
        allocation=replace(sample_snapshot.allocation, backend="other", status=AllocationStatus.DEGRADED),
    )
    exposed = families(odd)
    for name in ("link_state", "link_capacity_kind", "allocation_status", "allocation_binding", "allocation_backend"):
        assert sum(sample.value for sample in exposed[f"arpd_{name}"].samples) == 1
    assert value(odd, "arpd_allocation_backend", backend="other") == 1


def test_what_is_not_known_of_the_link_has_no_series(sample_snapshot):
    """Loss and return delay are absent while nobody measures them; zero would say that all is well."""
    names = ("arpd_link_loss_ratio", "arpd_link_return_delay_seconds")
    assert [value(sample_snapshot, name) for name in names] == [0.015625, 0.0078125]
    unknown = replace(sample_snapshot.link, loss_ratio=None, return_delay_s=None)
    assert not {*names} & {*families(replace(sample_snapshot, link=unknown))}


def test_label_values_known_beforehand_start_at_zero(sample_snapshot):
    """A counter that appears with its first event has no increase to alert on."""
    fresh = families(replace(sample_snapshot, totals=Totals()))
    for name, label, known in (
        ("arpd_events", "event", EventKind),
        ("arpd_estimator_events", "event", EstimatorEvent),
        ("arpd_topic_withheld_messages", "cause", WithheldCause),
        ("arpd_topic_swap_phase_seconds", "phase", SwapPhase),
        ("arpd_swap_phase_duration_seconds", "phase", SwapPhase),
    ):
        assert {sample.labels[label] for sample in fresh[name].samples} == {*known}
    assert sum(sample.value for sample in fresh["arpd_events"].samples) == 0


def test_a_refused_reload_shows(sample_snapshot):
    """While a reload stands refused the success gauge is 0."""
    assert value(sample_snapshot, "arpd_config_last_reload_successful") == 1
    assert value(replace(sample_snapshot, config_error="line 3"), "arpd_config_last_reload_successful") == 0


def test_the_full_registry_adds_process_and_python():
    """The registry of the daemon also holds process_* and python_info."""
    names = {family.name for family in make_registry(lambda: None).collect()}
    assert {"arpd_build", "process_cpu_seconds", "python_info"} <= names


# -- the status document


def test_the_status_document_says_infinite_as_null(sample_snapshot):
    """The document is strict JSON; unpaced rates and infinite deadlines are null."""
    document = json.loads(json.dumps(status_document(sample_snapshot), allow_nan=False))
    topics = {topic["topic"]: topic for topic in document["topics"]}
    assert list(topics) == ["/camera/image", "/cmd_vel", "/diagnostics", "/imu"]
    assert (topics["/imu"]["planned"]["rate_hz"], topics["/imu"]["planned"]["deadline_ns"]) == (None, None)
    assert (topics["/imu"]["confirmed"]["paced_rate_hz"], topics["/imu"]["confirmed"]["rate_hz"]) == (None, None)
    assert topics["/camera/image"]["confirmed"]["paced_rate_hz"] == 12.5
    assert topics["/camera/image"]["planned"] == {
        "rate_hz": 37.5,
        "min_rate_hz": 2.0,
        "depth": 10,
        "deadline_ns": 100_000_000,
        "weight": 1.0,
        "wire_bytes": 24000.0,
        "packets": 17,
    }
    assert document["price"]["share_per_weight"] == 0.5
    assert topics["/camera/image"]["binding"] == "link"
    assert topics["/cmd_vel"]["refusal"].startswith("depth 16")
    assert (topics["/diagnostics"]["planned"], topics["/diagnostics"]["share"]) == (None, None)
    assert (document["plan"]["publishers"], document["plan"]["confirmed"]) == (3, 2)
    assert document["totals"]["solves"] == {"exact": {"solved": 10}, "osqp": {"failed": 9, "solved": 8990}}


def test_a_price_without_a_limit_is_null(sample_snapshot):
    """Null is a share without a limit, and a tick that divides nothing."""
    free = replace(sample_snapshot.decision.price, share_per_weight=math.inf)
    for price, said in ((free, None), (None, None)):
        document = status_document(replace(sample_snapshot, decision=replace(sample_snapshot.decision, price=price)))
        json.dumps(document, allow_nan=False)
        assert (document["price"] or {}).get("share_per_weight") is said
    assert document["price"] is None


def test_a_refusal_shows_its_reason_and_whether_it_lasts(sample_snapshot):
    """Metric and status count refusals by reason, and name publishers that arpd only paces."""
    publishers = tuple(
        replace(p, refusal="it is TRANSIENT_LOCAL", refusal_reason=RefusalReason.TRANSIENT_LOCAL)
        if p.topic == "/imu"
        else p
        for p in sample_snapshot.observation.publishers
    )
    refused = observe(sample_snapshot, publishers=publishers)
    for reason, count in (("transient_local", 1), ("unmatched", 1), ("middleware", 0)):
        assert value(refused, "arpd_publishers_refused", reason=reason) == count
    document = status_document(refused)
    topics = {topic["topic"]: topic for topic in document["topics"]}
    assert document["plan"]["paced_only"] == 1
    assert (topics["/imu"]["refusal_reason"], topics["/imu"]["refusal_lasts"]) == ("transient_local", True)
    assert (topics["/cmd_vel"]["refusal_reason"], topics["/cmd_vel"]["refusal_lasts"]) == ("unmatched", False)


def test_readers_show_beside_publishers(sample_snapshot):
    """Metric, status and terminal list readers: planned, announced, and refusing."""
    labels = {"topic": "/camera/image", "node": "/planner"}
    assert value(sample_snapshot, "arpd_readers_managed") == 1
    assert value(sample_snapshot, "arpd_reader_deadline_seconds", **labels) == 0.15
    assert value(sample_snapshot, "arpd_reader_handovers_total", result="ok", **labels) == 1
    document = json.loads(json.dumps(status_document(sample_snapshot, now_s=1000.25)))
    planned, alone = document["readers"]
    assert planned["planned"] == {"depth": 10, "deadline_ns": 150_000_000}
    assert (alone["planned"], alone["refusal_lasts"]) == (None, True)
    lines = [line.split() for line in printed(document)]
    assert ["/camera/image", "10", "150", "ms", "6", "/planner"] in lines


def test_the_lease_shows(sample_snapshot):
    """The time that a plan outlives its daemon is a metric, and in the status; forever is +Inf."""
    assert value(sample_snapshot, "arpd_lease_seconds") == math.inf
    leased = replace(sample_snapshot, lease_s=30.0)
    assert value(leased, "arpd_lease_seconds") == 30.0
    assert status_document(leased)["lease"] == {"on_lost": "baseline", "after_seconds": 30.0}


def test_cross_traffic_shows_wherever_the_capacity_does(sample_snapshot):
    """Metric, status and terminal have the cross traffic and what it leaves."""
    assert value(sample_snapshot, "arpd_link_foreign_bytes_per_second") == 62_500.0
    document = status_document(sample_snapshot, now_s=1000.25)
    assert document["link"]["foreign_bytes_per_second"] == 62_500.0
    assert document["link"]["available_bytes_per_second"] == 437_500.0
    assert any(line.endswith(", 500 kbit/s of cross traffic, 3.5 Mbit/s left") for line in printed(document))
    alone = replace(sample_snapshot, link=replace(sample_snapshot.link, cross_traffic_bytes_per_second=0.0))
    assert "cross traffic" not in "".join(printed(status_document(alone, now_s=1000.25)))


def test_a_value_that_is_not_finite_anywhere_still_gives_json(sample_snapshot):
    """Infinity and NaN from the estimator do not break the document."""
    link = replace(sample_snapshot.link, age_s=math.inf, queue_delay_s=math.nan)
    document = status_document(replace(sample_snapshot, link=link), now_s=1001.0)
    assert (document["link"]["age_seconds"], document["link"]["queue_delay_seconds"]) == (None, None)
    assert document["age_seconds"] == 1.0
    json.dumps(document, allow_nan=False)


# -- the server


def test_metrics_are_served_in_the_format_asked_for(world):
    """Plain text by default, OpenMetrics when the scraper asks for it."""
    plain = world.get("/metrics?x=1")
    assert plain.headers["Content-Type"].startswith("text/plain; version=0.0.4")
    assert "\narpd_gate_ratio 0.75\n" in plain.text
    negotiated = world.get("/metrics", Accept="application/openmetrics-text; version=1.0.0")
    assert negotiated.headers["Content-Type"].startswith("application/openmetrics-text; version=1.0.0")
    assert "arpd_gate_ratio" in {family.name for family in text_string_to_metric_families(negotiated.text)}


def test_status_is_served_as_json(world):
    """The status document carries readiness and its own age."""
    document = json.loads(world.get("/api/v1/status").text)
    assert (document["api_version"], document["ready"], document["age_seconds"]) == ("v1", True, 0.25)


def test_nothing_is_promised_before_the_first_tick(world):
    """Before the first snapshot: healthy, not ready, status 503, and a page all the same."""
    world.snapshot = None
    assert world.get("/-/healthy").status == 200
    assert world.get("/-/ready").text == "not ready: no tick has finished yet\n"
    assert world.get("/api/v1/status").status == 503
    assert "Starting: no tick has finished yet" in world.get("/").text


def test_ready_needs_a_daemon_that_governs(world):
    """Ready follows is_ready once a snapshot exists."""
    assert world.get("/-/ready").status == 200
    world.is_ready = False
    assert world.get("/-/ready").status == 503


@pytest.mark.parametrize("has_snapshot", [False, True])
def test_a_hung_tick_is_unhealthy(world, has_snapshot):
    """When no tick has finished within the limit, health fails with the time."""
    if not has_snapshot:
        world.snapshot = None
    world.now_s += HEALTHY_S
    answer = world.get("/-/healthy")
    assert answer.status == 503
    assert "10 s" in answer.text


def test_without_scripts_the_page_has_the_verdict_as_text(world):
    """Names in the sentence never become markup or a place of the page, and the policy forbids inline scripts."""
    name = "<script>{{assets}}</script>"
    world.snapshot = observe(replace(world.snapshot, interface=name), counters=None)
    page = world.get("/")
    assert "&lt;script&gt;{{assets}}&lt;/script&gt; is gone" in page.text
    assert 'href="api/v1/status"' in page.text
    assert page.headers["Content-Security-Policy"].startswith(
        "default-src 'none'; script-src 'self'; style-src 'self';"
    )


def test_head_gives_headers_only(world):
    """HEAD answers like GET without a body."""
    head, full = world.get("/metrics", method="HEAD"), world.get("/metrics")
    assert (head.status, head.text) == (200, "")
    assert head.headers["Content-Length"] == str(len(full.text.encode()))


@pytest.mark.parametrize("path", ["/etc/passwd", "/../etc/passwd", "/metrics/", "/<script>"])
def test_an_unknown_path_is_a_bare_404(world, path):
    """The answer repeats nothing of the request."""
    answer = world.get(path)
    assert (answer.status, answer.text) == (404, "404 Not Found\n")
    assert answer.headers["Server"] == "arpd"


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "BREW"])
def test_other_methods_are_not_allowed(world, method):
    """Only GET and HEAD are allowed."""
    answer = world.get("/metrics", method=method)
    assert (answer.status, answer.headers["Allow"]) == (405, "GET, HEAD")
    assert answer.text == "405 Method Not Allowed\n"


def test_garbage_is_refused_and_the_server_goes_on(world):
    """A malformed request gets a bare 400; the next one is served."""
    with socket.create_connection(("127.0.0.1", world.server.port), timeout=5.0) as raw:
        raw.sendall(b"GET / HTTP/x\r\n\r\n")
        assert raw.makefile("rb").read().startswith(b"HTTP/1.1 400 ")
    assert world.get("/").status == 200


def test_a_fault_while_answering_leaks_nothing_and_is_logged(sample_snapshot, caplog):
    """An answer that raises becomes a bare 500, and the traceback goes to the log."""

    class Broken:
        def collect(self):
            raise RuntimeError("secret")

    with serving(World(snapshot=sample_snapshot), collector=_Late(Broken())) as world:
        answer = world.get("/metrics")
        assert (answer.status, answer.text) == (500, "500 Internal Server Error\n")
        assert world.get("/-/ready").status == 200
    assert "secret" in caplog.text


def test_idle_connections_give_way_to_newcomers(world):
    """An idle connection loses its place to the next one; threads stay bounded."""
    threads = threading.active_count()
    address = ("127.0.0.1", world.server.port)
    idle = [socket.create_connection(address, timeout=5.0) for _ in range(40)]
    try:
        assert idle[0].recv(1) == b""
        assert world.get("/-/ready").status == 200
        assert threading.active_count() <= threads + 2 * MAX_PLACES
    finally:
        for connection in idle:
            connection.close()


def test_a_taken_port_is_named_with_the_way_out(world):
    """A taken port fails with the address and the keys to change."""
    second = HttpServer("127.0.0.1", world.server.port, snapshot=lambda: None, registry=CollectorRegistry())
    with pytest.raises(
        HttpAddressError, match=rf"127\.0\.0\.1:{world.server.port}: Address already in use.*http\.port"
    ):
        second.start()


@pytest.mark.parametrize("host", ["203.0.113.7", "no such host"])
def test_an_address_of_another_machine_is_refused_clearly(host):
    """A host of another machine gives our error, not the library's."""
    server = HttpServer(host, 0, snapshot=lambda: None, registry=CollectorRegistry())
    with pytest.raises(HttpAddressError, match=r"http\.host"):
        server.start()


def test_a_stopped_server_does_not_answer(sample_snapshot):
    """After stop() the port is closed, and a second stop() does no harm."""
    with serving(World(snapshot=sample_snapshot)) as world:
        url = world.server.url
        world.server.stop()
        with pytest.raises(urllib.error.URLError):
            urllib.request.urlopen(url, timeout=5.0)


class _Late:
    """Register without collecting: only a scrape may find a broken collector."""

    def __init__(self, inner):
        self._inner = inner

    def describe(self):
        return []

    def collect(self):
        return self._inner.collect()
