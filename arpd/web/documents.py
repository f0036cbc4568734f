"""Makes each document once for all who ask at the same time: in one thread, and between ticks."""

from __future__ import annotations

import asyncio
import time
from functools import partial
from itertools import chain
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

from prometheus_client import CollectorRegistry, generate_latest

from arpd.web.api import history_json, status_json

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Iterable, Iterator

    from arpd.report.history import History
    from arpd.report.snapshot import Snapshot

_PATIENCE_S = 1.0
_REST = 3.0  # times the work of a document passes before the next


class Documents:
    """The documents of the daemon.

    Python runs one thread at a time, so making a large document slows the tick down. Documents are made one after the
    other, and those who ask meanwhile share the one that is being made. Its pieces take milliseconds and wait while a
    tick runs: for a second in all, because metrics matter most when ticks hang. They are of what `HttpServer` is given.
    """

    def __init__(
        self,
        *,
        snapshot: Callable[[], Snapshot | None],
        history: History,
        registry: CollectorRegistry,
        resting: threading.Event,
        clock: Callable[[], float],
    ) -> None:
        self.snapshot, self.clock = snapshot, clock
        self._history = history
        self._registry = registry
        self._resting = resting
        self._one_by_one = asyncio.Lock()
        self._free_at_s = 0.0
        self._in_the_making: dict[str, asyncio.Task[bytes]] = {}

    async def get(self, name: str) -> bytes:
        """Return ``metrics``, ``status`` or ``history``; there is no status before the first tick."""
        if (made := self._in_the_making.get(name)) is None:
            pieces = {"metrics": self._metrics, "status": self._status, "history": self._past}[name]
            made = self._in_the_making[name] = asyncio.create_task(self._make(pieces))
            made.add_done_callback(lambda _: self._in_the_making.pop(name))
        return await asyncio.shield(made)

    async def _make(self, pieces: Callable[[], Iterable[bytes]]) -> bytes:
        async with self._one_by_one:
            await asyncio.sleep(self._free_at_s - time.monotonic())
            return await asyncio.to_thread(self._join, pieces)

    def _join(self, pieces: Callable[[], Iterable[bytes]]) -> bytes:
        began_s = time.thread_time()
        body = b"".join(self._between_ticks(pieces()))
        self._free_at_s = time.monotonic() + _REST * (time.thread_time() - began_s)
        return body

    def _between_ticks(self, pieces: Iterable[bytes]) -> Iterator[bytes]:
        left_s = _PATIENCE_S
        for piece in chain((b"",), pieces):  # it waits before the first, too
            yield piece
            if left_s > 0 and not self._resting.is_set():
                began_s = time.monotonic()
                self._resting.wait(left_s)
                left_s -= time.monotonic() - began_s

    def _metrics(self) -> Iterable[bytes]:
        families = (SimpleNamespace(collect=partial(iter, [family])) for family in self._registry.collect())
        return (generate_latest(cast("CollectorRegistry", one)) for one in families)

    def _status(self) -> Iterable[bytes]:
        snapshot = self.snapshot()
        return () if snapshot is None else status_json(snapshot, now_s=self.clock())

    def _past(self) -> Iterable[bytes]:
        samples, snapshot = self._history.samples, self.snapshot()
        return (history_json(samples, snapshot.events if snapshot else ()),)
