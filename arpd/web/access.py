"""Who may ask: the web-config in force, read again when its files change, and the names that the daemon answers to."""

from __future__ import annotations

import ipaddress
import logging
import socket
from functools import cache
from typing import TYPE_CHECKING

import prometheus_client
from prometheus_client import CollectorRegistry, disable_created_metrics
from tornado.httputil import split_host_and_port

from arpd.model.errors import ConfigError
from arpd.web.passwords import PasswordVerdict
from arpd.web.web_config import Protection, load_protection

if TYPE_CHECKING:
    from pathlib import Path


log = logging.getLogger(__name__)


class Access:
    """Keeps `Protection` up to date with its files; if they cannot be used, the last good one stays in force.

    TLS, users, client certificates and the list of their names cannot be removed without a restart, so that a
    half-written file does not open the port.

    Parameters
    ----------
    path : web-config file, None = no protection
    counts : notes whether the file can be used

    Raises
    ------
    ConfigError
        If the file cannot be used.
    """

    def __init__(self, path: Path | None, *, counts: HttpCounts) -> None:
        self._path = path
        self._counts = counts
        self._fault = ""
        self.protection = Protection() if path is None else load_protection(path)
        self._stamps = _stamps(self.protection.files)

    def follow(self) -> bool:
        """Read the files again if they have changed; return True if there is another protection in force."""
        if self._path is None:
            return False
        stamps = _stamps(self.protection.files)  # taken before reading, so that a later change is read again
        if stamps == self._stamps and not self._fault:  # a file that a broken web-config names may appear
            return False
        self._stamps = stamps
        try:
            protection = load_protection(self._path)
            fault = _opened(self.protection, protection)
        except (ConfigError, OSError) as error:  # a certificate may vanish while it is read
            fault = str(error)
        self._counts.is_config_good.set(not fault)
        if fault and fault != self._fault:
            log.error("http.web_config is refused; the last good one stays in force: %s", fault)
        self._fault = fault
        if fault:
            return False
        log.info("http.web_config has changed and is in force")
        if protection.files != self.protection.files:
            self._stamps = _stamps(protection.files)
        self.protection = protection
        return True


class HttpCounts:
    """Counts of the HTTP server itself; no client can add values to a label.

    Parameters
    ----------
    registry : exposes them
    """

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
        self.is_config_good = prometheus_client.Gauge(
            "arpd_http_config_last_reload_successful", text, registry=registry
        )
        self.is_config_good.set(1)


def exposure(address: str, protection: Protection) -> str:
    """Return the risk of listening on an IP address, empty if there is none."""
    if ipaddress.ip_address(address.partition("%")[0]).is_loopback:
        return ""
    if not (protection.users or protection.requires_certificate):
        return "anyone who reaches it can read it; add users or require client certificates in http.web_config"
    if protection.tls is None:
        return "passwords cross the network unencrypted; add tls_server_config to http.web_config"
    return ""


def is_own_name(host: str, listening_on: str) -> bool:
    """Return whether a Host header names this computer: by an address, or by a name of its own.

    A page on the web can let its name lead to this computer (DNS rebinding) and read what the daemon answers to the
    browser. It cannot do so for an address, nor for a name that is not its own.

    Parameters
    ----------
    host : the header, with or without a port
    listening_on : ``http.host``
    """
    name = split_host_and_port(host.lower())[0].removesuffix(".")
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return name in ("localhost", listening_on.lower()) or name.endswith(".localhost") or name in _own_names()
    return True


@cache
def _own_names() -> frozenset[str]:
    name = socket.gethostname().lower()
    short = name.partition(".")[0]  # some computers have their whole name as host name; mDNS takes the first part
    return frozenset({name, short, f"{short}.local", socket.getfqdn().lower()})


def client_of(address: str) -> str:
    """Return the client that an address counts for; an IPv6 client may use a whole /64, which counts once."""
    ip = ipaddress.ip_address(address.partition("%")[0])
    return str(ipaddress.ip_network((ip, 64), strict=False)) if isinstance(ip, ipaddress.IPv6Address) else str(ip)


def _opened(old: Protection, new: Protection) -> str:
    for key, before, after in (
        ("tls_server_config", old.tls, new.tls),
        ("basic_auth_users", old.users, new.users),
        ("client_auth_type", old.requires_certificate, new.requires_certificate),
        ("client_allowed_sans", old.allowed_sans, new.allowed_sans),
    ):
        if bool(before) and not after:
            return f"{key}: was removed; restart arpd if this is intended"
    return ""


def _stamps(files: tuple[Path, ...]) -> list[tuple[int, int, int] | None]:
    stamps: list[tuple[int, int, int] | None] = []
    for file in files:
        try:
            status = file.stat()
        except OSError:
            stamps.append(None)
        else:
            stamps.append((status.st_mtime_ns, status.st_size, status.st_ino))
    return stamps
