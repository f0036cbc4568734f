"""An HTTP server that tries again until it can listen, while the daemon governs."""

from __future__ import annotations

import logging
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

from arpd.web.server import HttpAddressError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager

log = logging.getLogger(__name__)

_AGAIN_S = 5.0


class RetryingServer:
    """Serves as soon as it can listen; a port in use or a missing address does not keep the daemon from governing.

    Parameters
    ----------
    serving : listens while its block lasts and yields the URL; raises HttpAddressError if it cannot
    again_s : time between two tries (s)
    """

    def __init__(self, serving: Callable[[], AbstractContextManager[str]], *, again_s: float = _AGAIN_S) -> None:
        self._serving = serving
        self._again_s = again_s
        self._error: Exception | None = None
        self.fault = ""

    @contextmanager
    def up(self) -> Iterator[None]:
        """Listen, or try to, while the block lasts; raise any other error of the first try."""
        stopping, tried = threading.Event(), threading.Event()
        thread = threading.Thread(target=self._run, args=(stopping, tried), name="arpd-web", daemon=True)
        thread.start()
        tried.wait()
        try:
            if self._error is not None:
                raise self._error
            yield
        finally:
            stopping.set()
            thread.join(timeout=2.0)

    def _run(self, stopping: threading.Event, tried: threading.Event) -> None:
        try:
            while not stopping.is_set():
                self._serve(stopping, tried)
        except Exception as error:
            if tried.is_set():
                log.exception("the HTTP server has failed; no metrics until arpd restarts")
            self._error, self.fault = error, f"no metrics: {error}"
        finally:
            tried.set()

    def _serve(self, stopping: threading.Event, tried: threading.Event) -> None:
        try:
            with self._serving() as url:
                self.fault = ""
                log.info("metrics at %s/metrics", url)
                tried.set()
                stopping.wait()
        except HttpAddressError as error:
            if not self.fault:
                log.error("%s; arpd runs without metrics and tries again", error)  # noqa: TRY400 - no traceback needed
            self.fault = f"no metrics: {str(error).partition(';')[0]}"
            tried.set()
            stopping.wait(self._again_s)
