"""Who may be connected: a bound on all clients, a share for each, and room for newcomers."""

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
MAX_THREADS = 2 * MAX_PLACES  # an evicted connection's thread ends a moment later than its place is free


class Connection:
    """One connection that holds a place.

    Attributes
    ----------
    client : whom it counts for, see `client_of`
    is_waiting : whether the client's next move is awaited, so that the connection may be evicted
    is_evicted : whether it was
    """

    def __init__(self, connection: socket.socket, client: str) -> None:
        self.connection = connection
        self.client = client
        self.is_waiting = True
        self.is_evicted = False
        self._lock = threading.Lock()

    def become(self, connection: socket.socket) -> None:
        """Go on by another socket that took over the descriptor (TLS).

        Raises
        ------
        ConnectionError
            If the visit was evicted in the meantime.
        """
        with self._lock:
            self.connection = connection
            if self.is_evicted:
                raise ConnectionError("evicted")

    def evict(self) -> None:
        """Wake the thread that waits for the client, with an end of the stream."""
        with self._lock, suppress(OSError):
            socket.socket.shutdown(self.connection, socket.SHUT_RDWR)  # SSLSocket's own would break its thread

    @contextmanager
    def working(self) -> Iterator[None]:
        """Mark that the daemon works on an answer, which is soon done and not to be thrown away."""
        self.is_waiting = False
        try:
            yield
        finally:
            self.is_waiting = True


class ConnectionLimit:
    """Gives places to connections; a newcomer without one takes that of whoever can best spare it.

    A scrape always finds a place: every connection that waits for its client can be evicted, the oldest of the client
    that holds the most first, so that floods of half-open connections evict their own. Only those the daemon works
    for keep theirs, and that takes milliseconds.

    Parameters
    ----------
    patience_s : how long a newcomer waits for the thread of an evicted one to end, while those behind it queue (s)
    """

    def __init__(self, *, patience_s: float = 1.0) -> None:
        self._patience_s = patience_s
        self._changed = threading.Condition()
        self._open: list[Connection] = []
        self._threads = 0

    def enter(self, connection: socket.socket, client: str) -> tuple[Connection | None, Connection | None]:
        """Return the newcomer's visit, None if there is no place at all, and the visit it evicted, if any."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._threads < MAX_THREADS, self._patience_s):
                return None, None
            evicted = None
            if rivals := contested([visit.client for visit in self._open], client):
                evicted = next((self._open[index] for index in rivals if self._open[index].is_waiting), None)
                if evicted is None:
                    return None, None
                self._open.remove(evicted)
                evicted.is_evicted = True
            visit = Connection(connection, client)
            self._open.append(visit)
            self._threads += 1
        if evicted is not None:
            evicted.evict()
        return visit, evicted

    def leave(self, visit: Connection) -> None:
        """Give the place back; once for each visit that entered."""
        with self._changed:
            self._threads -= 1
            self._changed.notify()
            if not visit.is_evicted:
                self._open.remove(visit)


def contested(clients: Sequence[str], newcomer: str) -> list[int]:
    """Return which places, by position, a newcomer may take, best first; none if it may take a free one.

    A client at its share gives up its own oldest; when all places are taken, the client with the most does.

    Parameters
    ----------
    clients : who holds each place, oldest first
    newcomer : who asks for one
    """
    held = Counter(clients)
    if held[newcomer] >= MAX_PER_CLIENT:
        return [index for index, client in enumerate(clients) if client == newcomer]
    if len(clients) < MAX_PLACES:
        return []
    return sorted(range(len(clients)), key=lambda index: -held[clients[index]])


def client_of(address: str) -> str:
    """Return whom an address counts for: an IPv6 client has a whole /64 to choose from, and counts once."""
    try:
        ip = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(ip, ipaddress.IPv6Address):
        if ip.ipv4_mapped is not None:
            return str(ip.ipv4_mapped)
        return str(ipaddress.ip_network((ip, 64), strict=False))
    return str(ip)
