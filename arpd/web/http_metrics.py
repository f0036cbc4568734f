"""Counts of the HTTP server itself, as metrics."""

from __future__ import annotations

import threading
from collections import Counter
from enum import StrEnum
from typing import TYPE_CHECKING

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from arpd.web.families import counter_by
from arpd.web.passwords import PasswordVerdict

if TYPE_CHECKING:
    from collections.abc import Iterator

    from prometheus_client.metrics_core import Metric


class HttpRefusal(StrEnum):
    """Reasons why a connection got no answer."""

    BUSY = "busy"  # the limit was reached, and no connection could be evicted
    EVICTED = "evicted"  # it waited for its client, and a newcomer evicted it
    TIMEOUT = "timeout"  # the client took too long
    TLS = "tls"  # the handshake failed
    GONE = "gone"  # the client left


class HttpCounts(Collector):
    """Counts of the server, as Prometheus reads them; no client can add values to a label."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._requests: Counter[tuple[str, str]] = Counter()
        self._refused: Counter[str] = Counter()
        self._authentications: Counter[str] = Counter()
        self._reloads: Counter[str] = Counter()
        self._is_config_good = True

    def count_request(self, path: str, code: int) -> None:
        """Count an answer; ``path`` is a path of the server or ``other``."""
        with self._lock:
            self._requests[path, str(code)] += 1

    def count_refused(self, reason: HttpRefusal) -> None:
        """Count a connection without an answer."""
        with self._lock:
            self._refused[reason] += 1

    def count_authentication(self, verdict: PasswordVerdict) -> None:
        """Count credentials by verdict."""
        with self._lock:
            self._authentications[verdict] += 1

    def note_reload(self, *, is_good: bool) -> None:
        """Count a change of the web-config file or a certificate, and note whether it can be used."""
        with self._lock:
            self._reloads["ok" if is_good else "failed"] += 1
            self._is_config_good = is_good

    def collect(self) -> Iterator[Metric]:
        """Yield the families in a fixed order, their series sorted by label."""
        with self._lock:
            requests = sorted(self._requests.items())
            refused, authentications, reloads = self._refused.copy(), self._authentications.copy(), self._reloads.copy()
            is_config_good = self._is_config_good
        answered = CounterMetricFamily("arpd_http_requests", "Requests answered.", labels=("path", "code"))
        for labels, count in requests:
            answered.add_metric(labels, count)
        yield answered
        for name, text, label, known, counts in (
            ("arpd_http_connections_refused", "Connections without an answer.", "reason", HttpRefusal, refused),
            (
                "arpd_http_authentications",
                "Credentials of requests; cached means right and remembered.",
                "result",
                PasswordVerdict,
                authentications,
            ),
            (
                "arpd_http_config_reloads",
                "Changes of http.web_config and the files it names.",
                "result",
                ("failed", "ok"),
                reloads,
            ),
        ):
            yield counter_by(name, text, label, known, (({}, counts),))
        yield GaugeMetricFamily(
            "arpd_http_config_last_reload_successful",
            "0 while http.web_config cannot be used and an older version is in force.",
            value=float(is_config_good),
        )
