"""Deadlines missed by one publisher or subscription, whichever of its endpoints was in force at the time."""

from __future__ import annotations

from typing import Protocol


class Endpoint(Protocol):
    """A writer, or a reader."""

    def deadlines_missed(self) -> int:
        """Count the deadlines missed since it was made; by a destroyed one, as far as known."""


class DeadlineCount:
    """Adds up what each endpoint misses while it is in force.

    A writer that a swap prepares or retires gets no samples, and the middleware counts that, too.

    Parameters
    ----------
    endpoint : the one in force
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._before = -endpoint.deadlines_missed()  # missed by others, less what this one missed before its time

    @property
    def missed(self) -> int:
        """Deadlines missed so far."""
        return self._before + self._endpoint.deadlines_missed()

    def follow(self, endpoint: Endpoint) -> None:
        """Count what this endpoint misses from now on."""
        if endpoint is not self._endpoint:
            self._before = self.missed - endpoint.deadlines_missed()
            self._endpoint = endpoint
