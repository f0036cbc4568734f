"""The protection in force, read at start and whenever one of its files changes."""

from __future__ import annotations

import ipaddress
import logging
import threading
from typing import TYPE_CHECKING

from arpd.model.errors import ConfigError
from arpd.web.web_config import Protection, load_protection

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from arpd.web.http_metrics import HttpCounts

log = logging.getLogger(__name__)

_RETRY_S = 10.0  # a file that a broken web-config names may appear while the web-config stays the same


class Access:
    """Keeps `Protection` up to date with its files; if they cannot be used, the last good one stays in force.

    TLS, users and client certificates cannot be removed without a restart, so that a half-written file does not open
    the port.

    Parameters
    ----------
    path : web-config file, None = no protection
    counts : counts the changes
    clock : monotonic clock (s)

    Raises
    ------
    ConfigError
        If the file cannot be used.
    """

    def __init__(self, path: Path | None, *, counts: HttpCounts, clock: Callable[[], float]) -> None:
        self._path = path
        self._counts = counts
        self._clock = clock
        self._lock = threading.Lock()
        self._fault = ""
        self._retry_at_s = 0.0
        self._protection = Protection() if path is None else load_protection(path)
        self._stamps = _stamps(self._protection.files)

    def current(self) -> Protection:
        """Return the protection in force; if its files have changed, one thread reads them first."""
        if self._path is not None and self._lock.acquire(blocking=False):
            try:
                self._follow(self._path)
            finally:
                self._lock.release()
        return self._protection

    def _follow(self, path: Path) -> None:
        stamps = _stamps(self._protection.files)  # taken before reading, so that a later change is read again
        if stamps == self._stamps and not (self._fault and self._clock() >= self._retry_at_s):
            return
        fault = ""
        try:
            protection = load_protection(path)
        except ConfigError as error:
            fault = str(error)
        else:
            fault = _opened(self._protection, protection)
        if not fault:
            if protection.files != self._protection.files:
                stamps = ()
            self._protection = protection
        if fault != self._fault or not fault:
            self._counts.note_reload(is_good=not fault)
            if fault:
                log.error("http.web_config is refused; the last good one stays in force: %s", fault)
            else:
                log.info("http.web_config has changed and is in force")
        self._stamps, self._fault, self._retry_at_s = stamps, fault, self._clock() + _RETRY_S


def exposure(address: str, protection: Protection) -> str:
    """Return the risk of listening on an IP address, empty if there is none."""
    if ipaddress.ip_address(address.partition("%")[0]).is_loopback:
        return ""
    if not (protection.users or protection.requires_certificate):
        return "anyone who reaches it can read it; add users or require client certificates in http.web_config"
    if protection.tls is None:
        return "passwords cross the network unencrypted; add tls_server_config to http.web_config"
    return ""


def _opened(old: Protection, new: Protection) -> str:
    for key, before, after in (
        ("tls_server_config", old.tls, new.tls),
        ("basic_auth_users", old.users, new.users),
        ("client_auth_type", old.requires_certificate, new.requires_certificate),
    ):
        if bool(before) and not after:
            return f"{key}: was removed; restart arpd if this is intended"
    return ""


def _stamps(files: tuple[Path, ...]) -> tuple[tuple[int, int, int] | None, ...]:
    return tuple(_stamp(file) for file in files)


def _stamp(file: Path) -> tuple[int, int, int] | None:
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino
