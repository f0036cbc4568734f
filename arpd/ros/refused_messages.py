"""Messages from the network that arpd refuses: counted, and logged once a minute per source."""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.ros.rate_limits import OncePerMinute

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from arpd.model.observation import MessageKind, MessageRefusal

log = logging.getLogger(__name__)


class RefusedMessages:
    """Counts refused messages, and logs them once a minute per source and reason; for any number of threads.

    Parameters
    ----------
    clock : monotonic clock (s)
    """

    def __init__(self, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._counts: Counter[tuple[MessageKind, MessageRefusal]] = Counter()
        self._logged = OncePerMinute()

    @property
    def counts(self) -> Mapping[tuple[MessageKind, MessageRefusal], int]:
        """Refusals so far."""
        with self._lock:
            return MappingProxyType(dict(self._counts))

    def note(self, kind: MessageKind, reason: MessageRefusal, words: str, *, source: str = "") -> None:
        """Count a refusal.

        Parameters
        ----------
        words : the refused message and the reason
        source : its sender, empty = not known
        """
        with self._lock:
            self._counts[kind, reason] += 1
            is_news = self._logged.take((kind, reason, source), self._clock())
        if is_news:
            log.warning("ignored (logged once a minute): %s", words)
