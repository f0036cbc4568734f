"""Counts of the HTTP server itself, as metrics; no client can add values to a label."""

from __future__ import annotations

from typing import TYPE_CHECKING

from prometheus_client import Counter, Gauge, disable_created_metrics

from arpd.web.passwords import PasswordVerdict

if TYPE_CHECKING:
    from prometheus_client import CollectorRegistry


class HttpCounts:
    """Counts of the server.

    Parameters
    ----------
    registry : exposes them
    """

    def __init__(self, registry: CollectorRegistry) -> None:
        disable_created_metrics()  # type: ignore[no-untyped-call]
        self.requests = Counter("arpd_http_requests", "Requests answered.", ["path", "code"], registry=registry)
        self.evicted = Counter(
            "arpd_http_connections_evicted", "Connections closed to make room for a newcomer.", registry=registry
        )
        self.authentications = Counter(
            "arpd_http_authentications",
            "Credentials of requests; cached means right and remembered.",
            ["result"],
            registry=registry,
        )
        for verdict in PasswordVerdict:
            self.authentications.labels(verdict)  # from zero, so that rate() sees the first
        self.is_config_good = Gauge(
            "arpd_http_config_last_reload_successful",
            "0 while http.web_config cannot be used and an older version is in force.",
            registry=registry,
        )
        self.is_config_good.set(1)
