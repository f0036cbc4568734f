"""What each path answers; knows no sockets."""

from __future__ import annotations

import json
from dataclasses import dataclass
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

from prometheus_client.exposition import choose_encoder

from arpd.web.page import render_page
from arpd.web.status import API_VERSION, status_document

if TYPE_CHECKING:
    from collections.abc import Callable

    from prometheus_client import CollectorRegistry

    from arpd.snapshot import Snapshot

HEALTHY_S = 10.0
PATHS = frozenset({"/", "/metrics", "/-/healthy", "/-/ready", "/api/v1/status"})
_TEXT = "text/plain; charset=utf-8"
_JSON = "application/json"
_HTML = "text/html; charset=utf-8"


@dataclass(frozen=True, kw_only=True, slots=True)
class Answer:
    """One response."""

    status: HTTPStatus
    content_type: str
    body: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class Answers:
    """What each path answers; knows no sockets.

    Parameters
    ----------
    snapshot : returns the last snapshot, None before the first tick finished
    is_ready : whether the daemon governs
    registry : what ``/metrics`` exposes
    clock : monotonic clock the snapshots are stamped with (s)
    started_at_s : when serving began on that clock (s)
    """

    snapshot: Callable[[], Snapshot | None]
    is_ready: Callable[[], bool]
    registry: CollectorRegistry
    clock: Callable[[], float]
    started_at_s: float

    def answer(self, path: str, accept: str) -> Answer:
        """Return the answer for a path.

        Parameters
        ----------
        accept : the request's Accept header, which chooses the format of the metrics
        """
        match path:
            case "/":
                return _ok(_HTML, render_page(self._status()))
            case "/metrics":
                encode, content_type = _encoder(accept)
                return Answer(status=HTTPStatus.OK, content_type=content_type, body=encode(self.registry))
            case "/-/healthy":
                return self._healthy()
            case "/-/ready":
                return self._ready()
            case "/api/v1/status":
                return self._status_answer()
        return bare(HTTPStatus.NOT_FOUND)

    def _status(self) -> dict[str, Any] | None:
        snapshot = self.snapshot()
        if snapshot is None:
            return None
        return status_document(snapshot, is_ready=self.is_ready(), now_s=self.clock())

    def _status_answer(self) -> Answer:
        document = self._status()
        if document is None:
            text = json.dumps({"api_version": API_VERSION, "ready": False})
            return Answer(status=HTTPStatus.SERVICE_UNAVAILABLE, content_type=_JSON, body=f"{text}\n".encode())
        return _ok(_JSON, json.dumps(document, allow_nan=False) + "\n")

    def _healthy(self) -> Answer:
        snapshot = self.snapshot()
        # Before the first tick the start counts, so that a slow start is not taken for a hang.
        since_s = self.clock() - (self.started_at_s if snapshot is None else snapshot.finished_at_s)
        if since_s < HEALTHY_S:
            return _ok(_TEXT, "healthy\n")
        what = "no tick has finished since the start" if snapshot is None else "the last tick finished"
        return _unavailable(f"unhealthy: {what} {since_s:.1f} s ago; the limit is {HEALTHY_S:.0f} s\n")

    def _ready(self) -> Answer:
        if self.snapshot() is None:
            return _unavailable("not ready: no tick has finished yet\n")
        return _ok(_TEXT, "ready\n") if self.is_ready() else _unavailable("not ready: the daemon does not govern\n")


def bare(status: HTTPStatus, explanation: str = "") -> Answer:
    """Return an answer that says its code and its phrase, and repeats nothing of the request."""
    text = f"{status.value} {status.phrase}"
    body = f"{text}: {explanation}\n" if explanation else f"{text}\n"
    return Answer(status=status, content_type=_TEXT, body=body.encode())


def _encoder(accept: str) -> tuple[Callable[[CollectorRegistry], bytes], str]:
    try:
        return choose_encoder(accept)
    except (TypeError, ValueError):  # prometheus_client compares versions without looking: "version=x"
        return choose_encoder("")


def _ok(content_type: str, text: str) -> Answer:
    return Answer(status=HTTPStatus.OK, content_type=content_type, body=text.encode())


def _unavailable(text: str) -> Answer:
    return Answer(status=HTTPStatus.SERVICE_UNAVAILABLE, content_type=_TEXT, body=text.encode())
