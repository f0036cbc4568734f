"""The answer for each path; knows no sockets."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from html import escape
from http import HTTPStatus
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from arpd.report.history import History, history_json
from arpd.report.status import API_VERSION, status_document

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from arpd.report.snapshot import Snapshot
    from arpd.web.exposition import Exposition

SCHEMA_PATHS = MappingProxyType({f"/api/v1/schema/{name}-v1.json": name for name in ("status", "history")})
HEALTHY_S = 10.0  # a daemon without a tick for longer hangs; the watchdog of systemd has the same limit
ASSETS = Path(__file__).parent / "assets"
_PAGE = Path(__file__).with_name("page.html").read_text(encoding="utf-8")
ASSETS_PATH = "/assets/"
PATHS = frozenset(
    {
        "/",
        "/metrics",
        "/-/healthy",
        "/-/ready",
        "/api/v1/status",
        "/api/v1/stream",
        "/api/v1/history",
        *SCHEMA_PATHS,
    }
)
_KEPT = MappingProxyType({"Cache-Control": "no-cache"})  # the client may keep it, and asks each time whether it changed
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
    assets : path of the page's scripts and styles, which changes with their content
    """

    snapshot: Callable[[], Snapshot | None]
    is_ready: Callable[[], bool]
    exposition: Exposition
    clock: Callable[[], float]
    started_at_s: float
    history: History = field(default_factory=History)
    assets: str = field(default_factory=lambda: f"{ASSETS_PATH}{digest_of(ASSETS)}/")

    def answer(self, path: str, accept: str, *, asked_s: float | None = None) -> Answer:
        """Return the answer for a path.

        Parameters
        ----------
        accept : the request's Accept header, which chooses the format of the metrics
        asked_s : see `Exposition.answer`
        """
        answers = {
            "/": self._page,
            "/metrics": lambda: self._metrics(accept, asked_s),
            "/-/healthy": self._healthy,
            "/-/ready": self._ready,
            "/api/v1/status": self._status_answer,
            "/api/v1/history": self._history,
        }
        if path in answers:
            return answers[path]()
        return self._file(path)

    def _page(self) -> Answer:
        status = self.status()
        verdict = "Starting: no tick has finished yet" if status is None else status["verdict"]["text"]
        # Scripts fill in the rest; the verdict comes last, so that nothing in it is a place.
        page = _PAGE.replace("{{assets}}", self.assets.removeprefix("/")).replace("{{verdict}}", escape(verdict))
        return _ok(_HTML, page, _KEPT)

    def _metrics(self, accept: str, asked_s: float | None) -> Answer:
        body, content_type = self.exposition.answer(accept, asked_s=asked_s)
        return Answer(status=HTTPStatus.OK, content_type=content_type, body=body)

    def _history(self) -> Answer:
        snapshot = self.snapshot()
        body = history_json(self.history.samples, () if snapshot is None else snapshot.events)
        return Answer(status=HTTPStatus.OK, content_type=_JSON, body=body)

    def _file(self, path: str) -> Answer:
        if (name := SCHEMA_PATHS.get(path)) is not None:
            from arpd.web.api.schemas import schema_of  # noqa: PLC0415 - few ask

            return Answer(status=HTTPStatus.OK, content_type=_SCHEMA, body=schema_of(name), headers=_KEPT)
        return bare(HTTPStatus.NOT_FOUND)

    def status(self) -> dict[str, Any] | None:
        """Return the status document, None before the first tick."""
        snapshot = self.snapshot()
        if snapshot is None:
            return None
        return status_document(snapshot, is_ready=self.is_ready(), now_s=self.clock())

    def _status_answer(self) -> Answer:
        document = self.status()
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


def digest_of(folder: Path) -> str:
    """Return a name that changes with the content of a folder."""
    digest = hashlib.sha256()
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest.update(f"{file.relative_to(folder)}\0".encode() + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:16]


def bare(status: HTTPStatus, explanation: str = "") -> Answer:
    """Return an answer with its code and phrase, and nothing of the request."""
    text = f"{status.value} {status.phrase}"
    body = f"{text}: {explanation}\n" if explanation else f"{text}\n"
    return Answer(status=status, content_type=_TEXT, body=body.encode())


def _ok(content_type: str, text: str, headers: Mapping[str, str] = MappingProxyType({})) -> Answer:
    return Answer(status=HTTPStatus.OK, content_type=content_type, body=text.encode(), headers=headers)


def _unavailable(text: str) -> Answer:
    return Answer(status=HTTPStatus.SERVICE_UNAVAILABLE, content_type=_TEXT, body=text.encode())
