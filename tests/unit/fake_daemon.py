"""A daemon that gives a test's answers, and the document of one that is busy."""

from __future__ import annotations

import threading
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import MappingProxyType

from arpd.adapters.sim.demo import demo_topics
from arpd.model.allocation import Allocation, AllocationStatus, Binding, TopicAllocation
from arpd.model.endpoints import RefusalReason
from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.link import CapacityKind, LinkEstimate, LinkState
from arpd.model.observation import MemoryState, Observation
from arpd.model.plan import Decision, QosPlan, TopicPlan
from arpd.report.snapshot import Snapshot, Totals
from arpd.report.status import status_document
from tests.sample_publishers import publisher

HISTORY = {
    "api_version": "v1",
    "link": {
        "capacity_bytes_per_second": [None] * 100 + [2.5e6] * 250 + [6e5] * 250,
        "queue_delay_seconds": [0.0] * 349 + [0.35] + [0.0] * 250,
    },
    "gate": [1.0] * 350 + [0.5] + [1.0] * 249,
}


@contextmanager
def serving(body, code=200, *, history=None):
    """Answer a status document, and a history where there is one; a function is asked each time."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            found = {"/api/v1/status": (code, body), "/api/v1/history": (200, history)}.get(self.path, (404, ""))
            answer = found[1]() if callable(found[1]) else found[1]
            self.send_response(found[0] if answer is not None else 404)
            self.end_headers()
            self.wfile.write((answer or "").encode())

        def log_message(self, *_arguments):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def document(**changes):
    """Return the status of a daemon in trouble: a congested link, and a plan that gave something up, unconfirmed."""
    camera = publisher(
        "/camera",
        "/image",
        source_rate_hz=30.0,
        offered=200,
        published=150,
        withheld=50,
        rate_hz=37.5,
        paced_rate_hz=12.5,
        depth=7,
        deadline_ns=100_000_000,
        generation=3,
        refusal=changes.pop("refusal", ""),
        refusal_reason=changes.pop("refusal_reason", RefusalReason.NONE),
    )
    is_calm = changes.pop("is_calm", False)
    plan = TopicPlan(rate_hz=37.5, min_rate_hz=1.0, deadline_ns=100_000_000, depth=8)
    allocation = TopicAllocation(
        name="/image",
        share=0.5,
        max_rate_hz=25.0,
        rate_hz=12.5,
        depth=8.2,
        deadline_ns=80_000_000,
        depth_applied=8,
        binding=Binding.LINK,
        depth_binding=Binding.LATENCY_BUDGET,
    )
    snapshot = Snapshot(
        version="1.2.3",
        interface="wlan0",
        finished_at_s=10.0,
        unix_time_s=1e9,
        tick_s=0.002,
        observation=Observation(
            now_s=10.0,
            counters=LinkCounters(
                interface="wlan0",
                rx_bytes=0,
                tx_bytes=0,
                rx_packets=0,
                tx_packets=0,
                tx_dropped=0,
                state=changes.pop("interface_state", InterfaceState.UP),
            ),
            reports=(),
            publishers=changes.pop("publishers", (camera,)),
            memory=MemoryState(total_bytes=2**30, available_bytes=2**29),
            sensing_topics=1,
            actuation_topics=0,
            rmw="rmw_x",
            rmw_refusal=changes.pop("rmw_refusal", ""),
            active_daemon=changes.pop("active_daemon", ""),
            relay=changes.pop("relay", None),
            is_relay_silent=changes.pop("is_relay_silent", False),
            peer_ages_s=changes.pop("peer_ages_s", {"laptop": 0.5}),
        ),
        link=LinkEstimate(
            capacity_bytes_per_second=625_000.0,
            kind=CapacityKind.PEER,
            state=changes.pop("link_state", LinkState.CONGESTED),
            queue_delay_s=0.12,
            delivery_rate_bytes_per_second=600_000.0,
            age_s=0.1,
            evidence="down: the queue grew",
        ),
        allocation=Allocation(
            topics=(allocation,),
            status=AllocationStatus.OPTIMAL if is_calm else AllocationStatus.DEGRADED,
            binding=Binding.LINK,
            capacity_bytes_per_second=5e5,
            degradation="" if is_calm else "reserve of depth",
            backend="osqp",
            solve_s=0.0004,
        ),
        decision=Decision(
            gate=0.5,
            plan=QosPlan(generation=3, topics=MappingProxyType({"/image": plan}), level_bytes_per_second=531_250.0),
            level_changed=False,
            reason="held: dwell",
            refusals=("up: dwell",),
        ),
        totals=Totals(),
        config_error=changes.pop("config_error", ""),
        keys_awaiting_restart=changes.pop("keys_awaiting_restart", ()),
        lease_s=changes.pop("lease_s", 0.0),
    )
    if is_calm:
        snapshot = replace(snapshot, confirmed=snapshot.managed)
    return status_document(snapshot, now_s=changes.pop("now_s", 10.05), **changes)


def calm(**changes):
    """Return the status of a daemon with nothing to complain about."""
    return document(is_calm=True, **changes)


def demo_robot():
    """Return the publishers of the demo's robot."""
    return tuple(
        publisher(
            "/arpd_relay",
            topic.prefix + topic.name,
            source_rate_hz=topic.rate_hz,
            rate_hz=topic.rate_hz,
            published_rate_hz=topic.rate_hz,
            deadline_ns=int(1.25e9 / topic.rate_hz),
            offered=1000,
        )
        for topic in demo_topics()
    )


def event(number, text, *, kind="plan", severity="info", at_s=1e9):
    """Return a line of the decision log."""
    return {
        "number": number,
        "unix_time_seconds": at_s,
        "event": kind,
        "severity": severity,
        "text": text,
        "topic": "",
        "node": "",
        "details": {},
    }


def busy():
    """Return the demo's robot behind a slow link: the camera is slowed most, one topic refuses, three are late."""
    answered = calm(publishers=demo_robot())
    by_name = {topic["topic"]: topic for topic in answered["topics"]}
    for name, ratio in (("/link/camera/image/compressed", 0.08), ("/link/points", 0.4)):
        topic = by_name[name]
        topic |= {"binding": "link", "share": 0.3, "kept_ratio": ratio}
        topic["planned"] = {"rate_hz": topic["source_rate_hz"] * ratio, "depth": 10, "deadline_ns": None}
    by_name["/link/odom"] |= {"refusal": "depth 16: no match", "refusal_lasts": False}
    by_name["/link/imu"]["deadlines_missed"] = 3
    answered["verdict"] = {"severity": "warning", "text": "The link is the limit: so", "wrong": False}
    answered["events"] = [event(number, f"event {number}") for number in range(30)]
    return answered
