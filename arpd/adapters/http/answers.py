"""The answer for each path; knows no sockets."""

from __future__ import annotations

import gzip
import json
from dataclasses import dataclass, field, replace
from http import HTTPStatus
from importlib.resources import files
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from arpd.adapters.http.bundle import ASSETS_PATH, Bundle
from arpd.adapters.http.page import render_page
from arpd.report.history import History, history_json
from arpd.report.status import API_VERSION, status_document

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from arpd.adapters.http.exposition import Exposition
    from arpd.report.snapshot import Snapshot

_NAMES = ("status-v1.json", "history-v1.json")
SCHEMAS_BY_PATH = {
    f"/api/v1/schema/{name}": files("arpd.adapters.http").joinpath("schema", name).read_bytes() for name in _NAMES
}
HEALTHY_S = 10.0  # a daemon without a tick for longer hangs; the watchdog of systemd has the same limit
PATHS = frozenset({"/", "/metrics", "/-/healthy", "/-/ready", "/api/v1/status", "/api/v1/history", *SCHEMAS_BY_PATH})
_IMMUTABLE = MappingProxyType({"Cache-Control": "private, max-age=31536000, immutable", "Vary": "Accept-Encoding"})
_SCHEMA = "application/schema+json"
_TEXT = "text/plain; charset=utf-8"
_JSON = "application/json"
_HTML = "text/html; charset=utf-8"


@dataclass(frozen=True, kw_only=True, slots=True)
class Answer:
    """One response.

    Parameters
    ----------
    headers : those that other answers do not have
    """

    status: HTTPStatus
    content_type: str
    body: bytes
    headers: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True, kw_only=True, slots=True)
class Answers:
    """The daemon's answers.

    Parameters
    ----------
    snapshot : returns the last snapshot, None before the first tick finished
    is_ready : returns True while the daemon governs
    exposition : the metrics
    clock : monotonic clock of the snapshots (s)
    started_at_s : when serving began, on that clock (s)
    history : the last ten minutes
    assets : scripts and styles of the page
    """

    snapshot: Callable[[], Snapshot | None]
    is_ready: Callable[[], bool]
    exposition: Exposition
    clock: Callable[[], float]
    started_at_s: float
    history: History = field(default_factory=History)
    assets: Bundle = field(default_factory=Bundle)

    def answer(self, path: str, accept: str) -> Answer:
        """Return the answer for a path.

        Parameters
        ----------
        accept : the request's Accept header, which chooses the format of the metrics
        """
        answers = {
            "/": self._page,
            "/metrics": lambda: self._metrics(accept),
            "/-/healthy": self._healthy,
            "/-/ready": self._ready,
            "/api/v1/status": self._status_answer,
            "/api/v1/history": self._history,
        }
        if path in answers:
            return answers[path]()
        return self._file(path)

    def _page(self) -> Answer:
        return _ok(_HTML, render_page(self._status(), assets=self.assets.base))

    def _metrics(self, accept: str) -> Answer:
        body, content_type = self.exposition.answer(accept)
        return Answer(status=HTTPStatus.OK, content_type=content_type, body=body)

    def _history(self) -> Answer:
        snapshot = self.snapshot()
        body = history_json(self.history.samples, () if snapshot is None else snapshot.events)
        return Answer(status=HTTPStatus.OK, content_type=_JSON, body=body)

    def _file(self, path: str) -> Answer:
        if (schema := SCHEMAS_BY_PATH.get(path)) is not None:
            return Answer(status=HTTPStatus.OK, content_type=_SCHEMA, body=schema)
        if (asset := self.assets.get(path)) is not None:
            body, kind = asset.body, asset.content_type
            return Answer(status=HTTPStatus.OK, content_type=kind, body=body, headers=_IMMUTABLE)
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
        # Before the first tick the start counts, so that a slow start is no hang.
        since_s = self.clock() - (self.started_at_s if snapshot is None else snapshot.finished_at_s)
        if since_s < HEALTHY_S:
            return _ok(_TEXT, "healthy\n")
        what = "no tick has finished since the start" if snapshot is None else "the last tick finished"
        return _unavailable(f"unhealthy: {what} {since_s:.1f} s ago; the limit is {HEALTHY_S:.0f} s\n")

    def _ready(self) -> Answer:
        if self.snapshot() is None:
            return _unavailable("not ready: no tick has finished yet\n")
        return _ok(_TEXT, "ready\n") if self.is_ready() else _unavailable("not ready: the daemon does not govern\n")


def label(path: str) -> str:
    """Return the label of a path in metrics: one of few for any path."""
    if path in PATHS:
        return path
    return ASSETS_PATH if path.startswith(ASSETS_PATH) else "other"


def bare(status: HTTPStatus, explanation: str = "") -> Answer:
    """Return an answer with its code and phrase, and nothing of the request."""
    text = f"{status.value} {status.phrase}"
    body = f"{text}: {explanation}\n" if explanation else f"{text}\n"
    return Answer(status=status, content_type=_TEXT, body=body.encode())


def _ok(content_type: str, text: str) -> Answer:
    return Answer(status=HTTPStatus.OK, content_type=content_type, body=text.encode())


def _unavailable(text: str) -> Answer:
    return Answer(status=HTTPStatus.SERVICE_UNAVAILABLE, content_type=_TEXT, body=text.encode())


_LEAST_BYTES = 1024  # a packet holds that much anyway
_LEVEL = 1  # already a tenth of the size; higher levels cost the robot more time than they save the link


def compressed(answer: Answer) -> Answer:
    """Return the answer in gzip, or unchanged where gzip does not pay."""
    if len(answer.body) < _LEAST_BYTES:
        return answer
    body = gzip.compress(answer.body, compresslevel=_LEVEL, mtime=0)
    return replace(answer, body=body, headers={**answer.headers, "Content-Encoding": "gzip"})
