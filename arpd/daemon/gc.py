"""Python's garbage collection, moved to where it delays nothing.

By itself it begins wherever the most is allocated, which is in the middle of a tick or of a scrape, and nothing else
runs until it ends: with a thousand topics 20 to 70 ms, twice a second while somebody scrapes. A tick in ten was late.
"""

from __future__ import annotations

import gc
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

EVERY_S = 30.0
MOST_NEW = 200_000  # objects that may wait for it: some tens of megabytes, if all were garbage


class Garbage:
    """Collects when it is asked to and when enough has come together, never by itself.

    Most garbage needs no collecting, for Python frees at once what nobody refers to; this is for what refers to itself.

    Parameters
    ----------
    clock : monotonic clock (s)
    """

    def __init__(self, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._collected_s = clock()

    def take_over(self) -> None:
        """Leave collecting to `collect_if_due`; what is there already, mostly modules, is there for good."""
        gc.collect()
        gc.freeze()
        gc.disable()
        self._collected_s = self._clock()

    def give_back(self) -> None:
        """Let Python collect by itself again."""
        gc.unfreeze()
        gc.enable()

    def collect_if_due(self) -> None:
        """Collect after a while, or when much is new; call it when a delay costs least."""
        now_s = self._clock()
        if now_s - self._collected_s >= EVERY_S or gc.get_count()[0] >= MOST_NEW:
            gc.collect()
            self._collected_s = now_s
