"""Limits connections: a bound for all clients together, a share for each, and room for newcomers."""

from __future__ import annotations

import ipaddress
import socket
import threading
from collections import Counter
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

MAX_PLACES = 16
MAX_PER_CLIENT = 12
MAX_THREADS = 2 * MAX_PLACES  # the thread of an evicted connection ends a moment after the next connection's begins


class Connection:
    """One connection that counts against the limit.

    Attributes
    ----------
    socket : plain or TLS
    client : name that it counts for, see `client_of`
    is_waiting : True while it waits for its client, so that it may be evicted
    is_evicted : True once it is evicted
    """

    def __init__(self, raw: socket.socket, client: str) -> None:
        self.socket = raw
        self.client = client
        self.is_waiting = True
        self.is_evicted = False
        self._lock = threading.Lock()

    def become(self, wrapped: socket.socket) -> None:
        """Continue with another socket that took over the descriptor (TLS).

        Raises
        ------
        ConnectionError
            If the connection was evicted in the meantime.
        """
        with self._lock:
            self.socket = wrapped
            if self.is_evicted:
                raise ConnectionError("evicted")

    def evict(self) -> None:
        """End the stream, which wakes the thread that waits for the client."""
        with self._lock, suppress(OSError):
            socket.socket.shutdown(self.socket, socket.SHUT_RDWR)  # SSLSocket's own would break its thread

    @contextmanager
    def working(self) -> Iterator[None]:
        """Keep the connection from eviction while the daemon works on its answer."""
        self.is_waiting = False
        try:
            yield
        finally:
            self.is_waiting = True


class ConnectionLimit:
    """Admits connections; at the limit, a newcomer evicts another.

    A scrape always gets in: a newcomer may evict any connection that waits for its client, first the oldest one of the
    client that has most, so that a flood of half-open connections evicts its own. Only connections whose answer is in
    work stay, and that takes milliseconds.

    Parameters
    ----------
    patience_s : longest wait of a newcomer for the thread of an evicted connection to end; those behind it queue (s)
    """

    def __init__(self, *, patience_s: float = 1.0) -> None:
        self._patience_s = patience_s
        self._changed = threading.Condition()
        self._open: list[Connection] = []
        self._threads = 0

    def enter(self, raw: socket.socket, client: str) -> tuple[Connection | None, Connection | None]:
        """Return the newcomer's connection, None if it cannot enter, and the connection that it evicted, if any."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._threads < MAX_THREADS, self._patience_s):
                return None, None
            evicted = None
            if rivals := contested([connection.client for connection in self._open], client):
                evicted = next((self._open[index] for index in rivals if self._open[index].is_waiting), None)
                if evicted is None:
                    return None, None
                self._open.remove(evicted)
                evicted.is_evicted = True
            connection = Connection(raw, client)
            self._open.append(connection)
            self._threads += 1
        if evicted is not None:
            evicted.evict()
        return connection, evicted

    def leave(self, connection: Connection) -> None:
        """Release a connection that entered; call it once for each."""
        with self._changed:
            self._threads -= 1
            self._changed.notify()
            if not connection.is_evicted:
                self._open.remove(connection)


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
