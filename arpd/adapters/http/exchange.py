"""Serves one connection: handshake, request, credentials, answer."""

from __future__ import annotations

import logging
import socket
import ssl
from contextlib import suppress
from dataclasses import dataclass
from email.utils import formatdate
from http import HTTPStatus
from typing import TYPE_CHECKING

from arpd.adapters.http.answers import bare, compressed, label
from arpd.adapters.http.http_metrics import HttpRefusal
from arpd.adapters.http.passwords import PasswordVerdict
from arpd.adapters.http.request import RequestRefusedError, read_request
from arpd.adapters.http.tls import has_allowed_name

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.adapters.http.access import Access
    from arpd.adapters.http.answers import Answer, Answers
    from arpd.adapters.http.connection_limit import Connection
    from arpd.adapters.http.http_metrics import HttpCounts
    from arpd.adapters.http.passwords import Passwords
    from arpd.adapters.http.request import Request
    from arpd.adapters.http.web_config import Protection

log = logging.getLogger(__name__)

REQUEST_S = 5.0  # for handshake and request together
ANSWER_S = 10.0
_LINGER_S = 1.0
_LINGER_BYTES = 65_536
_CHUNK_BYTES = 65_536
_PLAIN_TO_TLS = "this port speaks HTTPS"
_HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    # Nothing from elsewhere, nothing inline, and no text that becomes markup.
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'"
    ),
    "Referrer-Policy": "no-referrer",
}
_OF_STATUS = {
    HTTPStatus.METHOD_NOT_ALLOWED: {"Allow": "GET, HEAD"},
    HTTPStatus.UNAUTHORIZED: {"WWW-Authenticate": 'Basic realm="arpd", charset="UTF-8"'},
    HTTPStatus.TOO_MANY_REQUESTS: {"Retry-After": "1"},
    HTTPStatus.SERVICE_UNAVAILABLE: {"Retry-After": "1"},
}
_OF_VERDICT = {
    PasswordVerdict.MISSING: HTTPStatus.UNAUTHORIZED,
    PasswordVerdict.WRONG: HTTPStatus.UNAUTHORIZED,
    PasswordVerdict.THROTTLED: HTTPStatus.TOO_MANY_REQUESTS,
    PasswordVerdict.BUSY: HTTPStatus.SERVICE_UNAVAILABLE,
}


class Stream:
    """Receives and sends under one deadline; with a timeout per call, a trickle of bytes could hold the connection.

    Parameters
    ----------
    connection : socket, plain or TLS
    clock : monotonic clock (s)
    """

    def __init__(self, connection: socket.socket, *, clock: Callable[[], float]) -> None:
        self._connection = connection
        self._clock = clock
        self._deadline_s = clock()

    def allow(self, seconds: float) -> None:
        """Set the deadline this far ahead (s)."""
        self._deadline_s = self._clock() + seconds

    def receive(self, most: int) -> bytes:
        """Return at most that many bytes, none at the end of the stream.

        Raises
        ------
        TimeoutError
            After the deadline.
        """
        self._arm()
        return self._connection.recv(most)

    def send(self, data: bytes) -> None:
        """Send all bytes.

        Raises
        ------
        TimeoutError
            After the deadline.
        """
        rest = memoryview(data)
        while rest:
            self._arm()
            rest = rest[self._connection.send(rest[:_CHUNK_BYTES]) :]

    def _arm(self) -> None:
        left_s = self._deadline_s - self._clock()
        if left_s <= 0.0:
            raise TimeoutError
        self._connection.settimeout(left_s)


@dataclass(frozen=True, kw_only=True, slots=True)
class Exchange:
    """Serves one connection in a thread of its own; logs or counts its errors and raises none.

    Parameters
    ----------
    answers : answers the paths
    access : protection of connections
    passwords : judges credentials
    counts : counts answers and refusals
    clock : monotonic clock (s)
    """

    answers: Answers
    access: Access
    passwords: Passwords
    counts: HttpCounts
    clock: Callable[[], float]

    def run(self, connection: Connection) -> None:
        """Take one request, answer it, and close the connection."""
        try:
            self._serve(connection)
        except TimeoutError:
            self._refuse(connection, HttpRefusal.TIMEOUT)
        except ssl.SSLError:
            self._refuse(connection, HttpRefusal.TLS)
        except OSError:
            self._refuse(connection, HttpRefusal.GONE)
        except Exception:
            log.exception("a connection from %s failed", connection.client)
        finally:
            with suppress(OSError):
                connection.socket.close()

    def _refuse(self, connection: Connection, reason: HttpRefusal) -> None:
        if not connection.is_evicted:  # an eviction is counted already, and may end in any of these errors
            self.counts.count_refused(reason)

    def _serve(self, connection: Connection) -> None:
        protection = self.access.current()
        stream = Stream(connection.socket, clock=self.clock)
        stream.allow(REQUEST_S)
        if protection.tls is not None:
            stream = self._shake_hands(connection, protection, protection.tls)
        path, wants_body, is_understood = "", True, True
        try:
            request = read_request(stream.receive)
        except RequestRefusedError as refused:
            is_understood = False
            answer = bare(refused.status)
        else:
            path, wants_body = request.path, request.wants_body
            with connection.working():
                answer = self._answer(protection, request, connection.client)
                if request.takes_gzip:
                    answer = compressed(answer)
        stream.allow(ANSWER_S)
        stream.send(encode(answer, protection, wants_body=wants_body))
        self.counts.count_request(label(path), answer.status)
        if not is_understood:
            _linger(connection.socket, stream)

    def _shake_hands(self, connection: Connection, protection: Protection, context: ssl.SSLContext) -> Stream:
        wrapped = context.wrap_socket(connection.socket, server_side=True, do_handshake_on_connect=False)
        connection.become(wrapped)
        wrapped.settimeout(REQUEST_S)
        stream = Stream(wrapped, clock=self.clock)
        stream.allow(REQUEST_S)
        try:
            wrapped.do_handshake()
        except ssl.SSLError as error:
            if error.reason == "HTTP_REQUEST":
                plain = encode(bare(HTTPStatus.BAD_REQUEST, _PLAIN_TO_TLS), protection, wants_body=True)
                socket.socket.send(wrapped, plain)
            raise
        if protection.allowed_sans and not has_allowed_name(wrapped.getpeercert(), protection.allowed_sans):
            raise ssl.SSLError("the client's certificate has no allowed name")
        return stream

    def _answer(self, protection: Protection, request: Request, client: str) -> Answer:
        """Answer a valid request; an error goes to the log only."""
        try:
            if protection.users:
                verdict = self.passwords.judge(protection.users, request.authorization, client)
                self.counts.count_authentication(verdict)
                if verdict in _OF_VERDICT:
                    return bare(_OF_VERDICT[verdict])
            return self.answers.answer(request.path, request.accept)
        except Exception:
            log.exception("a request from %s could not be answered", client)
            return bare(HTTPStatus.INTERNAL_SERVER_ERROR)


def encode(answer: Answer, protection: Protection, *, wants_body: bool) -> bytes:
    """Return the bytes of an answer that closes the connection."""
    headers = {
        "Server": "arpd",
        "Date": formatdate(usegmt=True),
        "Connection": "close",
        "Content-Type": answer.content_type,
        "Content-Length": str(len(answer.body)),
        **_HEADERS,
        **answer.headers,
        **_OF_STATUS.get(answer.status, {}),
        **protection.headers,
    }
    lines = (f"HTTP/1.1 {answer.status.value} {answer.status.phrase}", *(f"{k}: {v}" for k, v in headers.items()))
    head = "\r\n".join(lines).encode("latin-1") + b"\r\n\r\n"
    return head + answer.body if wants_body else head


def _linger(connection: socket.socket, stream: Stream) -> None:
    """Read on for a moment; if bytes are unread, closing resets the connection, and the client may lose the answer."""
    stream.allow(_LINGER_S)
    with suppress(OSError):
        socket.socket.shutdown(connection, socket.SHUT_WR)
        for _ in range(_LINGER_BYTES // 4096):
            if not stream.receive(4096):
                return
