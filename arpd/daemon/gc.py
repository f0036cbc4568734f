"""Garbage collection between ticks.

Python collects where most is allocated, in the middle of a tick or a scrape, and stops all threads until it ends.
Measured with a thousand topics: 20 to 70 ms, twice a second during scrapes, and one tick in ten was late.
"""

from __future__ import annotations

import gc
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

EVERY_S = 30.0
MOST_NEW = 200_000  # objects that may wait to be collected: some tens of megabytes, if all were garbage


class Garbage:
    """Collects garbage only when `collect_if_due` is called.

    Python frees most objects as soon as nothing refers to them; only cycles need a collection.

    Parameters
    ----------
    clock : monotonic clock (s)
    """

    def __init__(self, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._collected_s = clock()

    def take_over(self) -> None:
        """Switch off automatic collection; objects that exist now, mostly modules, are never collected."""
        gc.collect()
        gc.freeze()
        gc.disable()
        self._collected_s = self._clock()

    def collect_if_due(self) -> None:
        """Collect every 30 s, or when many objects are new; call it where a delay costs least."""
        now_s = self._clock()
        if now_s - self._collected_s >= EVERY_S or gc.get_count()[0] >= MOST_NEW:
            gc.collect()
            self._collected_s = now_s
