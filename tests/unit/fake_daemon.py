"""A daemon that gives a test's answers, and the document of one that is busy."""

import threading
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from arpd.report.conditions import Severity
from arpd.sim.demo import demo_topics
from arpd.web.json_text import plain
from tests.golden.sample import EVENT, FINISHED_AT_S, changed, held, status_of
from tests.sample_publishers import publisher

HISTORY = {
    "api_version": "v1",
    "unix_time_s": 1e9,
    "times": [1e9 - age for age in range(600)],
    "states": ["steady"] * 600,
    "link": {
        "capacity_bytes_per_second": [None] * 100 + [2.5e6] * 250 + [6e5] * 250,
        "queue_delay_s": [0.0] * 349 + [0.35] + [0.0] * 250,
        "allowed_ratio": [1.0] * 350 + [0.5] + [1.0] * 249,
    },
    "events": [],
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


def document(*, now_s=FINISHED_AT_S + 0.05, held_s=0.0, **parts):
    """Return the status of a daemon that copes with a slow link, with other values in its parts."""
    return status_of(held(changed(**parts), for_s=held_s), now_s=now_s)


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


def event(number, text):
    """Return a line of the decision log."""
    return plain(replace(EVENT, number=number, text=text, severity=Severity.INFO, unix_time_s=1e9))


def busy():
    """Return the demo's robot behind a slow link."""
    answered = document(observation={"publishers": demo_robot(), "relay": None})
    answered["verdict"] |= {"severity": "warning", "text": "The link is the limit: so", "wrong": False}
    answered["events"] = [event(number, f"event {number}") for number in range(30)]
    return answered
