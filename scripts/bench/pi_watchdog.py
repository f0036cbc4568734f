"""Systemd's watchdog for processes of a benchmark: it notes when it would have restarted them."""

from __future__ import annotations

import select
import socket
import threading
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path
    from types import TracebackType
    from typing import Self


class Watchdogs:
    """Listens to the notifications of processes while the ``with`` block lasts.

    Parameters
    ----------
    folder : for the sockets
    periods_s : WatchdogSec of each process's unit, by its name (s)
    clock : monotonic clock (s)
    """

    def __init__(
        self, folder: Path, periods_s: Mapping[str, float], *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._periods_s = periods_s
        self._clock = clock
        self._paths = {name: folder / f"notify-{name}" for name in periods_s}
        self._last_s: dict[str, float] = {}
        self._longest_s = dict.fromkeys(periods_s, 0.0)
        self._restarts = dict.fromkeys(periods_s, 0)
        self._stopping = threading.Event()
        self._listener = threading.Thread(target=self._listen, name="watchdogs", daemon=True)

    def __enter__(self) -> Self:
        self._sockets = {}
        for name, path in self._paths.items():
            self._sockets[name] = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._sockets[name].bind(str(path))
        self._listener.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        self._listener.join()
        for channel in self._sockets.values():
            channel.close()

    def environment(self, name: str) -> dict[str, str]:
        """Return what systemd gives a process; nothing to one without a watchdog."""
        if name not in self._periods_s:
            return {}
        return {"NOTIFY_SOCKET": str(self._paths[name]), "WATCHDOG_USEC": str(round(self._periods_s[name] * 1e6))}

    def report(self) -> dict[str, dict[str, Any]]:
        """Return by process its restarts, and its longest silence so far (s)."""
        for name in self._last_s.copy():
            self._note(name, is_sign=False)
        return {
            name: {
                "restarts": self._restarts[name],
                "longest_s": self._longest_s[name],
                "is_ready": name in self._last_s,
            }
            for name in self._periods_s
        }

    def _listen(self) -> None:
        names = {channel: name for name, channel in self._sockets.items()}
        while not self._stopping.is_set():
            for channel in select.select(list(names), [], [], 0.2)[0]:
                self.hear(names[channel], channel.recv(4096).decode())

    def hear(self, name: str, message: str) -> None:
        """Note a message; the watchdog counts from the first READY."""
        lines = message.splitlines()
        if "READY=1" in lines or ("WATCHDOG=1" in lines and name in self._last_s):
            self._note(name, is_sign=True)

    def _note(self, name: str, *, is_sign: bool) -> None:
        now_s = self._clock()
        silence_s = now_s - self._last_s.get(name, now_s)
        self._longest_s[name] = max(self._longest_s[name], silence_s)
        if is_sign:
            self._restarts[name] += silence_s > self._periods_s[name]
            self._last_s[name] = now_s
