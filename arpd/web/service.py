"""The HTTP server for as long as the daemon runs."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from arpd.web.metrics import make_registry
from arpd.web.server import HttpServer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from arpd.settings import HttpSettings
    from arpd.snapshot import Snapshot


@contextmanager
def serving(settings: HttpSettings, snapshot: Callable[[], Snapshot | None]) -> Iterator[str]:
    """Serve metrics, health and status for as long as the block lasts; yields the server's URL."""
    server = HttpServer(settings.host, settings.port, snapshot=snapshot, registry=make_registry(snapshot))
    server.start()
    try:
        yield server.url
    finally:
        server.stop()
