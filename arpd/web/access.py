"""Who may ask: the web-config in force, read again when its files change, and the names that the daemon answers to."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import os
import socket
import time
from contextlib import suppress
from functools import lru_cache
from http import HTTPStatus
from typing import TYPE_CHECKING

import prometheus_client
from prometheus_client import CollectorRegistry, disable_created_metrics
from tornado.httputil import HTTPServerRequest, split_host_and_port

from arpd.model.errors import ConfigError
from arpd.ros.rate_limits import OncePerMinute
from arpd.web.passwords import Passwords, PasswordVerdict
from arpd.web.web_config import Protection, load_protection

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from arpd.model.settings import HttpSettings

log = logging.getLogger(__name__)

_REFUSALS = {
    PasswordVerdict.MISSING: HTTPStatus.UNAUTHORIZED,
    PasswordVerdict.WRONG: HTTPStatus.UNAUTHORIZED,
    PasswordVerdict.THROTTLED: HTTPStatus.TOO_MANY_REQUESTS,
    PasswordVerdict.BUSY: HTTPStatus.SERVICE_UNAVAILABLE,
}


class HttpCounts:
    """Counts of the HTTP server itself; no client can add values to a label."""

    def __init__(self, registry: CollectorRegistry) -> None:
        disable_created_metrics()  # type: ignore[no-untyped-call]

        def counter(name: str, text: str, *labels: str) -> prometheus_client.Counter:
            return prometheus_client.Counter(f"arpd_http_{name}", text, labels, registry=registry)

        self.requests = counter("requests", "Requests answered.", "path", "code")
        self.evicted = counter("connections_evicted", "Connections closed to make room for a newcomer.")
        text = "Credentials of requests; cached means right and remembered."
        self.authentications = counter("authentications", text, "result")
        for verdict in PasswordVerdict:
            self.authentications.labels(verdict)  # from zero, so that rate() sees the first
        text = "0 while http.web_config cannot be used and an older version is in force."
        name = "arpd_http_config_last_reload_successful"
        self.is_config_good = prometheus_client.Gauge(name, text, registry=registry)
        self.is_config_good.set(1)


class Access:
    """Lets requests in, or refuses them; keeps the last good `Protection` while its files cannot be used.

    TLS, users and client certificates cannot be removed without a restart, so that a half-written file does not open
    the port.

    Parameters
    ----------
    http : address and web-config
    directory : folder where a relative ``http.web_config`` starts
    counts : notes verdicts, and whether the file can be used

    Raises
    ------
    ConfigError
        If the web-config cannot be used.
    """

    def __init__(self, http: HttpSettings, *, directory: Path, counts: HttpCounts) -> None:
        self._http, self._directory = http, directory
        self.counts = counts
        self._fault = ""
        self.protection = load_protection(http, directory=directory)
        self._file = [directory / http.web_config] if http.web_config else []
        self._stamps = self._seen()
        self._passwords = Passwords(clock=time.monotonic, secret=os.urandom(32))
        self._naming = asyncio.Lock()
        self._logged = OncePerMinute()

    async def refusal(self, request: HTTPServerRequest) -> HTTPStatus | None:
        """Return why a request without the right name or password is refused, None for one that may be answered."""
        protection = self.protection
        if protection.basic_auth_users:
            given = request.headers.get("Authorization", "").encode("latin-1", "replace")
            client = client_of(str(request.remote_ip))
            verdict = await self._passwords.judge(protection.basic_auth_users, given, client)
            self.counts.authentications.labels(verdict).inc()
            if verdict is PasswordVerdict.WRONG and self._logged.take(client, time.monotonic()):
                log.warning("http: a wrong password from %s (logged once a minute)", client)
            return _REFUSALS.get(verdict)
        if protection.tls is None and not await self._is_own_name(request.host):
            return HTTPStatus.MISDIRECTED_REQUEST
        return None

    async def _is_own_name(self, host: str) -> bool:
        """Return whether a Host header names this computer: by an address, or by a name of its own.

        A page on the web can let its name lead to this computer (DNS rebinding) and read what the daemon answers to the
        browser. It cannot do so for an address, nor for a name that is not its own.
        """
        name = split_host_and_port(host.lower())[0].removesuffix(".")
        if name in ("localhost", self._http.host.lower()) or name.endswith(".localhost"):
            return True
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            async with self._naming:  # one thread at a time: it may have to wait for a name server
                minute = time.monotonic() // 60.0  # the full name may not be known at first
                return name in await asyncio.to_thread(_own_names, socket.gethostname().lower(), minute)
        return True

    def follow(self) -> bool:
        """Read the files again if they have changed; return True if there is another protection in force."""
        stamps = self._seen()  # taken before reading, so that a later change is read again
        if stamps == self._stamps and not self._fault:  # a file that a broken web-config names may appear
            return False
        self._stamps = stamps
        try:
            protection = load_protection(self._http, directory=self._directory)
            fault = _opened(self.protection, protection)
        except ConfigError as error:
            fault = str(error)
        self.counts.is_config_good.set(not fault)
        if fault and fault != self._fault:
            log.error("http.web_config is refused; the last good one stays in force: %s", fault)
        self._fault = fault
        if fault:
            return False
        log.info("http.web_config has changed and is in force")
        is_elsewhere, self.protection = protection.files != self.protection.files, protection
        if is_elsewhere:
            self._stamps = self._seen()
        return True

    def _seen(self) -> list[tuple[int, int, int] | None]:
        return [*map(_stamp, (*self._file, *self.protection.files))]


def exposure(addresses: Iterable[str], protection: Protection) -> str:
    """Return the risk of listening on IP addresses, empty if there is none."""
    if all(ipaddress.ip_address(each.partition("%")[0]).is_loopback for each in addresses):
        return ""
    if not (protection.basic_auth_users or protection.requires_certificate):
        return "anyone who reaches it can read it; add users or require client certificates in http.web_config"
    if protection.tls is None:
        return "passwords cross the network unencrypted; add tls_server_config to http.web_config"
    return ""


@lru_cache(maxsize=1)
def _own_names(name: str, _minute: float) -> frozenset[str]:
    short = name.partition(".")[0]  # some computers have their whole name as host name; mDNS takes the first part
    return frozenset({name, short, f"{short}.local", socket.getfqdn().lower()})


def client_of(address: str) -> str:
    """Return the client that an address counts for; an IPv6 client may use a whole /64, which counts once."""
    ip = ipaddress.ip_address(address.partition("%")[0])
    return str(ipaddress.ip_network((ip, 64), strict=False)) if isinstance(ip, ipaddress.IPv6Address) else str(ip)


def _opened(old: Protection, new: Protection) -> str:
    for key, before, after in (
        ("tls_server_config", old.tls, new.tls),
        ("basic_auth_users", old.basic_auth_users, new.basic_auth_users),
        ("client_auth_type", old.requires_certificate, new.requires_certificate),
    ):
        if bool(before) and not after:
            return f"{key}: was removed; restart arpd if this is intended"
    return ""


def _stamp(file: Path) -> tuple[int, int, int] | None:
    with suppress(OSError):
        status = file.stat()
        return status.st_mtime_ns, status.st_size, status.st_ino
    return None
