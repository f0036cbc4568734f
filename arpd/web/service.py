"""Runs the HTTP server while a block lasts."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from arpd.web.http_metrics import HttpCounts
from arpd.web.metrics import make_registry
from arpd.web.server import HttpServer
from arpd.web.web_config import web_config_path

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path
    from threading import Event

    from arpd.model.settings import HttpSettings
    from arpd.report.history import History
    from arpd.report.snapshot import Snapshot


@contextmanager
def serving(
    settings: HttpSettings,
    snapshot: Callable[[], Snapshot | None],
    *,
    directory: Path,
    history: History | None = None,
    resting: Event | None = None,
) -> Iterator[str]:
    """Serve metrics, health and status while the block lasts; yields the server's URL.

    Parameters
    ----------
    settings : address and web-config
    snapshot : returns the last snapshot, None before the first
    directory : folder of the configuration file, where a relative ``http.web_config`` starts
    history : the last ten minutes, None = empty
    resting : set while no tick runs, None = there are no ticks

    Raises
    ------
    ConfigError
        If the web-config cannot be used.
    HttpAddressError
        If the address cannot be used.
    """
    counts = HttpCounts()
    registry = make_registry(snapshot)
    registry.register(counts)
    server = HttpServer(
        settings.host,
        settings.port,
        snapshot=snapshot,
        registry=registry,
        resting=resting,
        history=history,
        web_config=web_config_path(settings, directory=directory),
        counts=counts,
    )
    server.start()
    try:
        yield server.url
    finally:
        server.stop()
