"""The HTTP server: ``/``, ``/metrics``, ``/-/healthy``, ``/-/ready``, ``/api/v1/status``; it only ever reads."""

from __future__ import annotations

import json
import logging
import socket
import socketserver
import sys
import threading
import time
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any

from prometheus_client.exposition import choose_encoder

from arpd.errors import ArpdError
from arpd.web.page import render_page
from arpd.web.status import API_VERSION, status_document

if TYPE_CHECKING:
    from collections.abc import Callable

    from prometheus_client import CollectorRegistry

    from arpd.snapshot import Snapshot

log = logging.getLogger(__name__)

HEALTHY_S = 10.0
_REQUEST_TIMEOUT_S = 5.0
_MAX_CONCURRENT = 16
_BUSY = b"HTTP/1.0 503 Service Unavailable\r\nContent-Type: text/plain\r\nConnection: close\r\n\r\n503 busy\n"
_TEXT = "text/plain; charset=utf-8"
_JSON = "application/json"
_HTML = "text/html; charset=utf-8"


class HttpAddressError(ArpdError):
    """The HTTP server cannot listen where it is told to."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Answer:
    """One response."""

    status: HTTPStatus
    content_type: str
    body: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class Site:
    """What each path answers; knows no sockets.

    Parameters
    ----------
    snapshot : returns the last snapshot, None before the first tick finished
    is_ready : whether the daemon governs
    registry : what ``/metrics`` exposes
    clock : monotonic clock the snapshots are stamped with (s)
    started_at_s : when the site went up on that clock (s)
    """

    snapshot: Callable[[], Snapshot | None]
    is_ready: Callable[[], bool]
    registry: CollectorRegistry
    clock: Callable[[], float]
    started_at_s: float

    def answer(self, path: str, accept: str) -> Answer | None:
        """Return the answer for a path, None where there is nothing.

        Parameters
        ----------
        accept : the request's Accept header, which chooses the format of the metrics
        """
        match path:
            case "/":
                return _ok(_HTML, render_page(self._status()))
            case "/metrics":
                encode, content_type = choose_encoder(accept)
                return Answer(status=HTTPStatus.OK, content_type=content_type, body=encode(self.registry))
            case "/-/healthy":
                return self._healthy()
            case "/-/ready":
                return self._ready()
            case "/api/v1/status":
                return self._status_answer()
        return None

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


class HttpServer:
    """Serves a site from daemon threads, so that no client can hold up the tick or the exit.

    Parameters
    ----------
    host, port : where to listen; port 0 takes a free one
    snapshot, is_ready, registry, clock : see `Site`
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        snapshot: Callable[[], Snapshot | None],
        registry: CollectorRegistry,
        is_ready: Callable[[], bool] = lambda: True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._host = host
        self._port = port
        self._site = Site(snapshot=snapshot, is_ready=is_ready, registry=registry, clock=clock, started_at_s=clock())
        self._server: _Server | None = None

    @property
    def port(self) -> int:
        """Port in use; the one asked for before `start`."""
        return self._port

    @property
    def url(self) -> str:
        """Base URL without a trailing slash."""
        return f"http://{_bracketed(self._host)}:{self._port}"

    def start(self) -> None:
        """Listen and serve.

        Raises
        ------
        HttpAddressError
            If the address cannot be used.
        """
        where = f"{_bracketed(self._host)}:{self._port}"
        try:
            family, _, _, _, address = socket.getaddrinfo(
                self._host or None, self._port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )[0]
            self._server = _Server(family, address, self._site)
        except (OSError, UnicodeError, OverflowError) as error:
            raise HttpAddressError(
                f"http: cannot listen on {where}: {getattr(error, 'strerror', None) or error}; set http.host and "
                f"http.port in the configuration to a free address of this machine (ss -ltnp shows who listens)"
            ) from error
        self._port = self._server.server_address[1]
        threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, name="arpd-http", daemon=True
        ).start()

    def stop(self) -> None:
        """Stop listening; requests under way end with the process."""
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server = None


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = _MAX_CONCURRENT

    def __init__(self, family: socket.AddressFamily, address: Any, site: Site) -> None:
        self.address_family = family
        self.site = site
        self._slots = threading.BoundedSemaphore(_MAX_CONCURRENT)
        super().__init__(address, _Handler)

    def server_bind(self) -> None:
        # HTTPServer.server_bind looks the host's name up in DNS, which can take many seconds on a robot off the net.
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._slots.acquire(blocking=False):
            request.setblocking(False)  # noqa: FBT003 - the socket module's own signature
            try:
                request.send(_BUSY)
            finally:
                self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:
            self._slots.release()
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._slots.release()

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ARG002 - socketserver's signature
        error = sys.exception()
        if isinstance(error, OSError):
            log.debug("%s went away: %s", client_address[0], error)
        else:
            log.error("a request from %s failed", client_address[0], exc_info=error)


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = _REQUEST_TIMEOUT_S

    def do_GET(self) -> None:
        self._answer()

    def do_HEAD(self) -> None:
        self._answer()

    def _answer(self) -> None:
        answer = self.server.site.answer(self.path.partition("?")[0], self.headers.get("Accept", ""))
        if answer is None:
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            self._send(answer)

    def _send(self, answer: Answer) -> None:
        self.send_response(answer.status)
        self.send_header("Content-Type", answer.content_type)
        self.send_header("Content-Length", str(len(answer.body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header(
            "Content-Security-Policy",
            "default-src 'none'; style-src 'unsafe-inline'; img-src data:; form-action 'none'",
        )
        if answer.status is HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", "GET, HEAD")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(answer.body)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:  # noqa: ARG002
        """Answer with the code and its phrase only; the standard page repeats what the client sent."""
        # The standard library answers 501 to a method without a handler; every path here knows GET and HEAD.
        status = HTTPStatus.METHOD_NOT_ALLOWED if code == HTTPStatus.NOT_IMPLEMENTED else HTTPStatus(code)
        self.close_connection = True
        self._send(Answer(status=status, content_type=_TEXT, body=f"{status.value} {status.phrase}\n".encode()))

    def version_string(self) -> str:
        """Name the program, not its Python."""
        return "arpd"

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the standard library's name
        log.debug(format, *args)


def _ok(content_type: str, text: str) -> Answer:
    return Answer(status=HTTPStatus.OK, content_type=content_type, body=text.encode())


def _unavailable(text: str) -> Answer:
    return Answer(status=HTTPStatus.SERVICE_UNAVAILABLE, content_type=_TEXT, body=text.encode())


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
