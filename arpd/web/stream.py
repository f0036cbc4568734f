"""The status document as server-sent events: whole at first, then what changes, once a second for all clients.

An event ``status`` has the whole document, an event ``changes`` a JSON Patch (RFC 6902) of the one before. The age of
the document is left out: it changes always, and a client can count.
"""

from __future__ import annotations

import asyncio
import json
import logging
from typing import TYPE_CHECKING, Any

from arpd.report.json_patch import patch_between

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Callable
    from concurrent.futures import Executor

log = logging.getLogger(__name__)

_PERIOD_S = 1.0
_SILENCE_S = 15.0  # then a comment, so that a middlebox keeps the connection
_RETRY_MS = 2000
_COMMENT = b":\n\n"


class Feed:
    """Makes the events, and nothing while nobody listens.

    Parameters
    ----------
    status : returns the status document, None before the first tick
    pool : runs what takes long
    """

    def __init__(self, status: Callable[[], dict[str, Any] | None], *, pool: Executor) -> None:
        self._status = status
        self._pool = pool
        self._turn = asyncio.Condition()
        self._task: asyncio.Task[None] | None = None
        self._document: dict[str, Any] | None = None
        self._number = 0  # of the document; it lasts beyond pauses
        self._changes = b""  # from the document before
        self.listeners = 0

    async def events(self, has_left: Callable[[], bool]) -> AsyncGenerator[bytes, None]:
        """Yield events until the listener has left; one that missed an event gets the whole document again."""
        self.listeners += 1
        seen = 0

        def is_news() -> bool:
            return has_left() or (self._document is not None and self._number != seen)

        try:
            if self._task is None:
                self._task = asyncio.create_task(self._run())
            while True:
                try:
                    async with asyncio.timeout(_SILENCE_S), self._turn:
                        await self._turn.wait_for(is_news)
                except TimeoutError:
                    yield _COMMENT
                    continue
                if has_left():
                    return
                is_next = seen and self._number == seen + 1
                seen = self._number
                yield self._changes if is_next else await self._off_loop(_whole, self._document)
        finally:
            self.listeners -= 1

    async def look_around(self) -> None:
        """Let listeners that have left give up their places."""
        async with self._turn:
            self._turn.notify_all()

    async def _run(self) -> None:
        while self.listeners:
            try:
                document, changes = await self._off_loop(self._make, self._document)
            except Exception:
                log.exception("the status document could not be made")
            else:
                if changes:
                    async with self._turn:
                        self._document, self._changes = document, changes
                        self._number += 1
                        self._turn.notify_all()
            await asyncio.sleep(_PERIOD_S)
        self._task = self._document = None

    def _make(self, old: dict[str, Any] | None) -> tuple[dict[str, Any] | None, bytes]:
        """Return the document and the event that leads to it, empty if nothing has changed."""
        new = self._status()
        if new is None:
            return old, b""
        if old is None:
            return new, _COMMENT  # nobody has seen another
        # The age of both is the new one's, so that it is no change.
        changes = patch_between({**old, "age_seconds": new["age_seconds"]}, new)
        return new, _event("changes", changes) if changes else b""

    async def _off_loop(self, work: Callable[..., Any], *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._pool, work, *arguments)


def _whole(document: dict[str, Any]) -> bytes:
    return f"retry: {_RETRY_MS}\n".encode() + _event("status", document)


def _event(name: str, data: Any) -> bytes:
    return f"event: {name}\ndata: {json.dumps(data, allow_nan=False, separators=(',', ':'))}\n\n".encode()
