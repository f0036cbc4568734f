"""Speaks systemd's notify protocol (sd_notify(3)): READY, RELOADING, STOPPING, STATUS and the watchdog.

The protocol is one datagram to ``$NOTIFY_SOCKET``, so a dependency would cost more than it saves.
"""

from __future__ import annotations

import logging
import math
import os
import socket
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

log = logging.getLogger(__name__)

_BEAT_S = 1.0
_STALE_S = 5.0  # a part that has finished no round for so long hangs, and the watchdog's own time runs out


class Notifier:
    """Reports the state of the service to systemd; does nothing without NOTIFY_SOCKET, and never raises."""

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        address = environ.get("NOTIFY_SOCKET", "")
        # "@name" stands for a socket in the abstract namespace, whose address starts with a zero byte.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._status = ""  # as last set

    def ready(self) -> None:
        """Report the end of the start or of a reload."""
        self._send("READY=1")

    def reloading(self) -> None:
        """Report the begin of a reload; ``ready`` ends it, also after a refused configuration."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """Report the begin of a clean stop."""
        self._send("STOPPING=1")

    def status(self, text: str) -> None:
        """Set the line that ``systemctl status`` shows, if it is another one than before."""
        if text != self._status:
            self._status = text
            self._send("STATUS=" + " ".join(text.split()))  # a newline would start another assignment

    def watchdog(self) -> None:
        """Report that the service works; call it only after finished work."""
        self._send("WATCHDOG=1")

    def _send(self, message: str) -> None:
        if not self._address:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as channel:
                channel.settimeout(1.0)  # a systemd that hangs must not stop the tick
                channel.connect(self._address)
                channel.sendall(message.encode())
        except OSError as error:
            log.warning("cannot send %s to systemd: %s", message.split("\n", 1)[0], error)


class Watchdog:
    """Feeds the watchdog, at most once a second, while every part of the process finishes its rounds.

    Parameters
    ----------
    notifier : where the watchdog listens
    parts : for each other thread that must not hang, returns the end of its last round, on the same clock (s)
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        notifier: Notifier,
        *,
        parts: Sequence[Callable[[], float]] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._notifier = notifier
        self._parts = parts
        self._clock = clock
        self._beat_s = -math.inf

    def beat(self) -> None:
        """Note the end of a round of the calling thread."""
        now_s = self._clock()
        if now_s - self._beat_s >= _BEAT_S and all(now_s - finished_s() < _STALE_S for finished_s in self._parts):
            self._beat_s = now_s
            self._notifier.watchdog()
