"""Limits connections: a bound for all clients together, a share for each, a deadline, and room for newcomers."""

from __future__ import annotations

import ipaddress
import ssl
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from tornado.http1connection import HTTP1Connection, HTTP1ConnectionParameters, HTTP1ServerConnection
from tornado.httputil import HTTPServerConnectionDelegate

from arpd.web.http_metrics import HttpRefusal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from tornado.httputil import HTTPConnection, HTTPMessageDelegate
    from tornado.iostream import IOStream

    from arpd.web.http_metrics import HttpCounts
    from arpd.web.web_config import Protection

MAX_PLACES = 32  # each may hold a whole answer that its client does not take
MAX_PER_CLIENT = 16  # a browser opens six
MAX_HEAD_BYTES = 16_384
MAX_BODY_BYTES = 65_536  # read and refused; a client whose body is not read may lose the answer
REQUEST_S = 5.0  # from the first packet to the end of the first request, the handshake included
IDLE_S = 75.0  # for each later request; a scrape every minute keeps its connection

_FIRST = HTTP1ConnectionParameters(
    max_header_size=MAX_HEAD_BYTES, header_timeout=REQUEST_S, max_body_size=MAX_BODY_BYTES, body_timeout=REQUEST_S
)
_LATER = HTTP1ConnectionParameters(
    max_header_size=MAX_HEAD_BYTES, header_timeout=IDLE_S, max_body_size=MAX_BODY_BYTES, body_timeout=REQUEST_S
)


@dataclass(eq=False, kw_only=True, slots=True)
class Connection:
    """One connection that counts against the limit; Tornado calls it the context of a request.

    Parameters
    ----------
    stream : plain or TLS
    client : name that it counts for, see `client_of`
    protection : in force when it came
    since_s : when it came, or its last request was answered, on the limit's clock (s)
    is_waiting : True while it waits for its client, so that it may be evicted
    is_evicted : True once it is evicted
    is_answered : True while no request is open after at least one
    """

    stream: IOStream
    client: str
    protection: Protection
    since_s: float
    is_waiting: bool = True
    is_evicted: bool = False
    is_answered: bool = False

    @contextmanager
    def working(self) -> Iterator[None]:
        """Keep the connection from eviction while the daemon works on its answer."""
        self.is_waiting = False
        try:
            yield
        finally:
            self.is_waiting = True


class ConnectionLimit(HTTPServerConnectionDelegate):
    """Serves connections; at the limit, a newcomer evicts another.

    A scrape always gets in: a newcomer may evict any connection that waits for its client, first the oldest one of the
    client that has most, so that a flood of half-open connections evicts its own. Only connections whose answer is in
    work stay, and that takes milliseconds.

    Parameters
    ----------
    application : handles the requests
    counts : counts refusals
    clock : monotonic clock (s)
    """

    def __init__(
        self, application: HTTPServerConnectionDelegate, *, counts: HttpCounts, clock: Callable[[], float]
    ) -> None:
        self._application = application
        self._counts = counts
        self._clock = clock
        self._open: list[Connection] = []

    def serve(self, stream: IOStream, client: str, protection: Protection) -> bool:
        """Serve a new connection; return False, and leave it open, if it cannot enter."""
        if rivals := contested([connection.client for connection in self._open], client):
            evicted = next((self._open[index] for index in rivals if self._open[index].is_waiting), None)
            if evicted is None:
                self._counts.count_refused(HttpRefusal.BUSY)
                return False
            self._counts.count_refused(HttpRefusal.EVICTED)
            self._open.remove(evicted)
            evicted.is_evicted = True
            evicted.stream.close()
        connection = Connection(stream=stream, client=client, protection=protection, since_s=self._clock())
        self._open.append(connection)
        HTTP1ServerConnection(stream, _FIRST, connection).start_serving(self)
        return True

    def close(self) -> None:
        """Close every connection."""
        for connection in self._open:
            connection.stream.close()

    def start_request(self, server_conn: object, request_conn: HTTPConnection) -> HTTPMessageDelegate:
        """Wait for the next request; Tornado calls this before its first byte."""
        connection = connection_of(request_conn)
        if connection.is_answered:
            connection.since_s = self._clock()
            cast("HTTP1Connection", request_conn).params = _LATER
        return self._application.start_request(server_conn, request_conn)

    def on_close(self, server_conn: object) -> None:
        """Forget a connection, and count it if it ended without an answer."""
        connection = cast("Connection", cast("HTTP1ServerConnection", server_conn).context)
        if connection.is_evicted:
            return
        self._open.remove(connection)
        if isinstance(connection.stream.error, ssl.SSLError):
            self._counts.count_refused(HttpRefusal.TLS)
        elif not connection.is_answered:
            is_late = self._clock() - connection.since_s >= REQUEST_S
            self._counts.count_refused(HttpRefusal.TIMEOUT if is_late else HttpRefusal.GONE)


def connection_of(request_conn: HTTPConnection | None) -> Connection:
    """Return the connection that a request came over."""
    return cast("Connection", cast("HTTP1Connection", request_conn).context)


def contested(clients: Sequence[str], newcomer: str) -> list[int]:
    """Return the indices of the connections that a newcomer may evict, best first; none if there is room.

    A client at its share loses its own oldest connection; at the limit, the client with most connections does.

    Parameters
    ----------
    clients : client of each connection, oldest first
    newcomer : client of the new connection
    """
    held = Counter(clients)
    if held[newcomer] >= MAX_PER_CLIENT:
        return [index for index, client in enumerate(clients) if client == newcomer]
    if len(clients) < MAX_PLACES:
        return []
    return sorted(range(len(clients)), key=lambda index: -held[clients[index]])


def client_of(address: str) -> str:
    """Return the client that an address counts for; an IPv6 client may use a whole /64, which counts once."""
    try:
        ip = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(ip, ipaddress.IPv6Address):
        if ip.ipv4_mapped is not None:
            return str(ip.ipv4_mapped)
        return str(ipaddress.ip_network((ip, 64), strict=False))
    return str(ip)
