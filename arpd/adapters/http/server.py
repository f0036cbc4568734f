"""The HTTP server: listens, serves each connection in a thread, and never waits for a client."""

from __future__ import annotations

import logging
import os
import socket
import threading
import time
from contextlib import suppress
from http import HTTPStatus
from typing import TYPE_CHECKING

from arpd.adapters.http.access import Access, exposure
from arpd.adapters.http.answers import Answers, bare
from arpd.adapters.http.connection_limit import ConnectionLimit, client_of
from arpd.adapters.http.exchange import Exchange, encode
from arpd.adapters.http.exposition import Exposition
from arpd.adapters.http.http_metrics import HttpCounts, HttpRefusal
from arpd.adapters.http.passwords import Passwords
from arpd.adapters.http.web_config import Protection
from arpd.model.errors import ArpdError
from arpd.report.history import History

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from prometheus_client import CollectorRegistry

    from arpd.adapters.http.connection_limit import Connection
    from arpd.report.snapshot import Snapshot

log = logging.getLogger(__name__)

_BACKLOG = 128  # when the queue is full, the client's kernel tries again after a second
_PAUSE_S = 0.05  # without a free descriptor, accept() fails at once every time


class HttpAddressError(ArpdError):
    """The HTTP server cannot listen on its address."""


class HttpServer:
    """Serves answers from daemon threads, so that no client can delay the tick or the exit.

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
        self._exchange = Exchange(
            answers=Answers(
                snapshot=snapshot,
                is_ready=is_ready,
                exposition=Exposition(registry, resting=resting),
                clock=clock,
                started_at_s=clock(),
                history=history or History(),
            ),
            access=self._access,
            passwords=Passwords(clock=time.monotonic, secret=os.urandom(32)),
            counts=self._counts,
            clock=time.monotonic,
        )
        self._limit = ConnectionLimit()
        self._listener: socket.socket | None = None

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
            self._listener = socket.create_server(address, family=family, backlog=_BACKLOG)
        except (OSError, UnicodeError, OverflowError) as error:
            raise HttpAddressError(
                f"http: cannot listen on {where}: {getattr(error, 'strerror', None) or error}; set http.host and "
                f"http.port in the configuration to a free address of this machine (ss -ltnp shows who listens)"
            ) from error
        self._port = self._listener.getsockname()[1]
        if amiss := exposure(self._listener.getsockname()[0], self._access.current()):
            log.warning("http: %s is open to the network, and %s", self.url, amiss)
        threading.Thread(target=self._accept, args=(self._listener,), name="arpd-http", daemon=True).start()

    def stop(self) -> None:
        """Stop listening; open requests end with the process."""
        listener, self._listener = self._listener, None
        if listener is not None:
            with suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)  # wakes accept(); close() alone does not
            listener.close()

    def _accept(self, listener: socket.socket) -> None:
        while self._listener is listener:
            try:
                connection, address = listener.accept()
            except OSError:
                if self._listener is listener:
                    time.sleep(_PAUSE_S)
                continue
            self._admit(connection, client_of(str(address[0])))

    def _admit(self, raw: socket.socket, client: str) -> None:
        connection, evicted = self._limit.enter(raw, client)
        if evicted is not None:
            self._counts.count_refused(HttpRefusal.EVICTED)
        if connection is None:
            self._turn_away(raw)
            return
        try:
            threading.Thread(target=self._attend, args=(connection,), name="arpd-http-request", daemon=True).start()
        except RuntimeError:  # the process has reached its limit of threads
            self._limit.leave(connection)
            self._turn_away(raw)

    def _attend(self, connection: Connection) -> None:
        try:
            self._exchange.run(connection)
        finally:
            self._limit.leave(connection)

    def _turn_away(self, connection: socket.socket) -> None:
        self._counts.count_refused(HttpRefusal.BUSY)
        with connection, suppress(OSError):
            if self._access.current().tls is None:
                connection.setblocking(False)  # noqa: FBT003 - the socket module's own signature
                connection.send(encode(bare(HTTPStatus.SERVICE_UNAVAILABLE), Protection(), wants_body=True))


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
