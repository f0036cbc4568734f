"""What arrived and was not believed: counted, and said in the log as often as is of use."""

from __future__ import annotations

import logging
import threading
import time
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.observe.rate_limits import Refusals

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from arpd.observe.rate_limits import Kind, Reason

log = logging.getLogger(__name__)


class Refused:
    """`Refusals` for callbacks in any number of threads.

    Parameters
    ----------
    clock : monotonic clock (s)
    """

    def __init__(self, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._refusals = Refusals()

    @property
    def counts(self) -> Mapping[tuple[Kind, Reason], int]:
        """Refusals so far."""
        with self._lock:
            return MappingProxyType(self._refusals.counts)

    def note(self, kind: Kind, reason: Reason, words: str, *, source: str = "") -> None:
        """Count a refusal, and say it if it is news.

        Parameters
        ----------
        words : what was refused, and why
        source : who said it, empty = not known
        """
        with self._lock:
            is_news = self._refusals.note(kind, reason, source, self._clock())
        if is_news:
            log.warning("ignored, and said once a minute: %s", words)
