"""The HTTP server: Tornado in a thread of its own, which listens as soon as it can and makes no tick wait."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections import Counter
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets

from arpd.host.services import NO_METRICS
from arpd.web.access import Access, HttpCounts, client_of, exposure
from arpd.web.documents import Documents
from arpd.web.handlers import Site
from arpd.web.metrics import make_registry

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from prometheus_client import Histogram
    from tornado.iostream import IOStream

    from arpd.model.settings import HttpSettings
    from arpd.report.history import History
    from arpd.report.snapshot import Snapshot

log = logging.getLogger(__name__)

MAX_CONNECTIONS = 32  # each may hold a whole answer that its client does not take
_BACKLOG = 4096  # a burst of newcomers fills a shorter one, and the kernel takes a scrape's second try after a second
_LIMITS = {
    "max_header_size": 16_384,
    "idle_connection_timeout": 20.0,  # for a head, the handshake included, and between two requests
    "max_body_size": 65_536,  # read and ignored; a client whose body is not read may lose the answer
    "body_timeout": 5.0,
}
_LOOK_S = 1.0  # between two looks at the files of the web-config, and two tries to listen
_WAIT_S = 2.0  # for its first try to listen, which may ask a name server, and for its end


class HttpServer:
    """Serves metrics, status and page; without a free port the daemon governs all the same.

    Parameters
    ----------
    http : address and web-config
    snapshot : returns the last snapshot, None before the first tick finished
    directory : folder of the configuration file, where a relative ``http.web_config`` starts
    history : the last ten minutes
    durations : of ticks and solves
    resting : set while no tick runs
    clock : monotonic clock of the snapshots (s)

    Raises
    ------
    ConfigError
        If the web-config cannot be used.

    Attributes
    ----------
    fault : why there are no metrics, empty while it listens
    registry : what it exposes
    """

    def __init__(
        self,
        http: HttpSettings,
        *,
        snapshot: Callable[[], Snapshot | None],
        directory: Path,
        history: History,
        durations: Iterable[Histogram],
        resting: threading.Event,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.registry = make_registry(snapshot, clock=clock, durations=durations)
        self._http = http
        self._access = Access(http, directory=directory, counts=HttpCounts(self.registry))
        documents = Documents(snapshot=snapshot, history=history, registry=self.registry, resting=resting, clock=clock)
        self._site = Site(documents=documents, access=self._access)
        self.fault = ""
        self.port = 0  # while it listens

    @property
    def url(self) -> str:
        """Base URL without a trailing slash."""
        scheme = "http" if self._access.protection.tls is None else "https"
        return f"{scheme}://{replace(self._http, port=self.port or self._http.port).netloc}"

    @contextmanager
    def up(self) -> Iterator[None]:
        """Listen, or try to, while the block lasts."""
        logging.getLogger("tornado.general").setLevel(logging.CRITICAL)  # it warns of what clients do wrong
        tried, loop = threading.Event(), asyncio.new_event_loop()
        stop = asyncio.Event()
        thread = threading.Thread(target=self._run, args=(loop, stop, tried), name="arpd-http", daemon=True)
        thread.start()
        tried.wait(_WAIT_S)
        try:
            yield
        finally:
            with suppress(RuntimeError):  # it has failed: its loop is closed
                loop.call_soon_threadsafe(stop.set)
            thread.join(_WAIT_S)

    def _run(self, loop: asyncio.AbstractEventLoop, stop: asyncio.Event, tried: threading.Event) -> None:
        try:
            with asyncio.Runner(loop_factory=lambda: loop) as runner:
                runner.run(self._serve(stop, tried))
        except Exception as error:
            log.exception("the HTTP server has failed; no metrics until arpd restarts")
            self.fault = f"{NO_METRICS}{error}"
        finally:
            tried.set()

    async def _serve(self, stop: asyncio.Event, tried: threading.Event) -> None:
        server = _Server(self._site, ssl_options=self._access.protection.tls, **_LIMITS)
        try:
            while not stop.is_set():
                if not self.port:
                    self._listen(server)
                tried.set()
                if self._access.follow():
                    server.ssl_options = self._access.protection.tls
                    server.close_connections()  # they came under the rules of before
                with suppress(TimeoutError):
                    await asyncio.wait_for(stop.wait(), _LOOK_S)
        finally:
            self.port = 0
            server.stop()
            server.close_connections()

    def _listen(self, server: _Server) -> None:
        try:
            sockets = bind_sockets(self._http.port, self._http.host, backlog=_BACKLOG)
        except (OSError, UnicodeError, OverflowError) as error:
            why = getattr(error, "strerror", None) or error
            fault = f"{NO_METRICS}http: cannot listen on {self._http.netloc}: {why}"
            if fault != self.fault:
                log.error(  # noqa: TRY400 - no traceback needed
                    "%s; arpd tries again. Set http.host and http.port to a free address of this machine "
                    "(ss -ltnp shows who listens)",
                    fault,
                )
            self.fault = fault
            return
        self.fault, self.port = "", sockets[0].getsockname()[1]
        server.add_sockets(sockets)
        log.info("metrics at %s/metrics", self.url)
        if amiss := exposure([each.getsockname()[0] for each in sockets], self._access.protection):
            log.warning("http: %s is open to the network, and %s", self.url, amiss)


class _Server(HTTPServer):
    """Tornado's server with a bound on connections, at which a newcomer closes another's.

    It closes the oldest one of the client that has most, so a flood closes its own, and a scrape always gets in.
    """

    def initialize(self, *arguments: Any, **options: Any) -> None:
        super().initialize(*arguments, **options)
        self._clients: dict[Any, str] = {}  # by stream, oldest first
        self._counts: HttpCounts = arguments[0].access.counts

    def handle_stream(self, stream: IOStream, address: tuple[Any, ...]) -> None:
        if len(self._clients) >= MAX_CONNECTIONS:
            ((most, _),) = Counter(self._clients.values()).most_common(1)
            oldest = next(each for each, client in self._clients.items() if client == most)
            del self._clients[oldest]
            self._counts.evicted.inc()
            oldest.close()
        self._clients[stream] = client_of(str(address[0]))
        super().handle_stream(stream, address)

    def on_close(self, server_conn: Any) -> None:
        super().on_close(server_conn)
        self._clients.pop(server_conn.stream, None)

    def close_connections(self) -> None:
        for stream in tuple(self._clients):
            stream.close()
