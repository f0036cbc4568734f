"""A connection under one deadline, however its bytes trickle."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable

_CHUNK_BYTES = 65_536


class Stream:
    """Receives and sends until the time given is over; a timeout per call would let a byte now and then hold it.

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
        """Give everything that follows this long in all (s)."""
        self._deadline_s = self._clock() + seconds

    def receive(self, most: int) -> bytes:
        """Return what is there, at most that many bytes, none at the end.

        Raises
        ------
        TimeoutError
            If the time is over.
        """
        self._arm()
        return self._connection.recv(most)

    def send(self, data: bytes) -> None:
        """Send all of it.

        Raises
        ------
        TimeoutError
            If the time is over.
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
