"""The HTTP server: Tornado in a thread of its own, which no client can make wait."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import ssl
import threading
import time
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from tornado.iostream import IOStream, SSLIOStream
from tornado.netutil import ssl_wrap_socket

from arpd.model.errors import ArpdError
from arpd.report.history import History
from arpd.web.access import Access, exposure
from arpd.web.answers import Answers
from arpd.web.connection_limit import MAX_HEAD_BYTES, ConnectionLimit, client_of
from arpd.web.exposition import Exposition
from arpd.web.handlers import Site
from arpd.web.http_metrics import HttpCounts, HttpRefusal
from arpd.web.passwords import Passwords

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from prometheus_client import CollectorRegistry

    from arpd.report.snapshot import Snapshot

log = logging.getLogger(__name__)

_BACKLOG = 128  # when the queue is full, the client's kernel tries again after a second
_PAUSE_S = 0.05  # without a free descriptor, accept() fails at once every time
_STOP_S = 2.0
_BUSY = b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\nRetry-After: 1\r\n\r\n"
_PLAIN_TO_TLS = (
    b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\nContent-Type: text/plain; charset=utf-8\r\n\r\n"
    b"400 Bad Request: this port speaks HTTPS\n"
)


class HttpAddressError(ArpdError):
    """The HTTP server cannot listen on its address."""


class HttpServer:
    """Serves answers from threads of its own, so that no client can delay the tick.

    Parameters
    ----------
    host, port : address to listen on; port 0 takes a free one
    snapshot, is_ready : see `Answers`
    registry, resting : see `Exposition`
    history : the last ten minutes, None = empty
    web_config : file with TLS and users, None = neither
    counts : counts of the server itself
    clock : monotonic clock of the snapshots' times (s)

    Raises
    ------
    ConfigError
        If the web-config cannot be used.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        snapshot: Callable[[], Snapshot | None],
        registry: CollectorRegistry,
        resting: threading.Event | None = None,
        is_ready: Callable[[], bool] = lambda: True,
        history: History | None = None,
        web_config: Path | None = None,
        counts: HttpCounts | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._host = host
        self._port = port
        self._counts = counts or HttpCounts()
        self._access = Access(web_config, counts=self._counts, clock=time.monotonic)
        self._answers = Answers(
            snapshot=snapshot,
            is_ready=is_ready,
            exposition=Exposition(registry, resting=resting),
            clock=clock,
            started_at_s=clock(),
            history=history or History(),
        )
        self._end: Callable[[], object] = lambda: None
        self._thread: threading.Thread | None = None

    @property
    def port(self) -> int:
        """Port in use; before `start`, the port asked for."""
        return self._port

    @property
    def url(self) -> str:
        """Base URL without a trailing slash."""
        scheme = "http" if self._access.current().tls is None else "https"
        return f"{scheme}://{_bracketed(self._host)}:{self._port}"

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
            listener = socket.create_server(address, family=family, backlog=_BACKLOG)
        except (OSError, UnicodeError, OverflowError) as error:
            raise HttpAddressError(
                f"http: cannot listen on {where}: {getattr(error, 'strerror', None) or error}; set http.host and "
                f"http.port in the configuration to a free address of this machine (ss -ltnp shows who listens)"
            ) from error
        listener.setblocking(False)  # noqa: FBT003 - the socket module's own signature
        self._port = listener.getsockname()[1]
        if amiss := exposure(listener.getsockname()[0], self._access.current()):
            log.warning("http: %s is open to the network, and %s", self.url, amiss)
        logging.getLogger("tornado.general").setLevel(logging.CRITICAL)  # it warns of each handshake that fails
        started = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(listener, started), name="arpd-http", daemon=True)
        self._thread.start()
        started.wait()

    def stop(self) -> None:
        """Close the port and all connections."""
        thread, self._thread = self._thread, None
        if thread is not None:
            with suppress(RuntimeError):  # it has failed: its loop is closed
                self._end()
            thread.join(_STOP_S)

    def _run(self, listener: socket.socket, started: threading.Event) -> None:
        try:
            with listener:
                asyncio.run(self._serve(listener, started))
        except Exception:
            log.exception("the HTTP server has failed; no metrics until arpd restarts")
        finally:
            started.set()

    async def _serve(self, listener: socket.socket, started: threading.Event) -> None:
        """Accept connections until `stop`."""
        site = Site(
            answers=self._answers,
            access=self._access,
            passwords=Passwords(clock=time.monotonic, secret=os.urandom(32)),
            counts=self._counts,
        )
        limit = ConnectionLimit(site, counts=self._counts, clock=time.monotonic)
        accepting = asyncio.create_task(self._accept(listener, limit))
        self._end = partial(asyncio.get_running_loop().call_soon_threadsafe, accepting.cancel)
        started.set()
        with suppress(asyncio.CancelledError):
            await accepting
        limit.close()
        site.close()

    async def _accept(self, listener: socket.socket, limit: ConnectionLimit) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                connection, address = await loop.sock_accept(listener)
            except OSError:
                await asyncio.sleep(_PAUSE_S)
                continue
            try:
                self._admit(connection, client_of(str(address[0])), limit)
            except Exception:
                log.exception("a connection failed")
                connection.close()

    def _admit(self, connection: socket.socket, client: str, limit: ConnectionLimit) -> None:
        protection = self._access.current()
        if protection.tls is None:
            stream = IOStream(connection)
        else:
            try:
                sealed = ssl_wrap_socket(connection, protection.tls, server_side=True, do_handshake_on_connect=False)
            except OSError:  # gone before its handshake
                self._counts.count_refused(HttpRefusal.TLS)
                connection.close()
                return
            stream = _TlsStream(sealed)
        if not limit.serve(stream, client, protection):
            if protection.tls is None:
                stream.write(_BUSY)
            stream.close()


class _TlsStream(SSLIOStream):
    """Tells a client that speaks plain HTTP what is wrong."""

    def close(self, exc_info: Any = False) -> None:  # noqa: FBT002 - Tornado's signature
        if isinstance(exc_info, ssl.SSLError) and exc_info.reason == "HTTP_REQUEST":
            with suppress(OSError):
                socket.socket.send(self.socket, _PLAIN_TO_TLS)
                socket.socket.recv(self.socket, MAX_HEAD_BYTES)  # unread bytes would reset the connection
        super().close(exc_info)


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
