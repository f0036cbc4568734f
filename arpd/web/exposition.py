"""Makes the text of ``/metrics`` by prometheus_client, once for all who ask, and not while a tick runs."""

from __future__ import annotations

import math
import threading
import time
from typing import TYPE_CHECKING, Protocol

from prometheus_client import exposition as library
from prometheus_client.core import Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from prometheus_client.core import Metric

_AT_ONCE = 500  # samples: some milliseconds
_PATIENCE_S = 1.0


class Collects(Protocol):
    """A registry, or one collector."""

    def collect(self) -> Iterable[Metric]:
        """Return metric families."""


def choose_encoder(accept: str) -> tuple[Callable[[Collects], bytes], str]:
    """Return the encoder and the content type that prometheus_client negotiates with a client.

    Parameters
    ----------
    accept : the request's Accept header
    """
    try:
        return library.choose_encoder(accept)
    except (TypeError, ValueError):  # it compares versions unchecked: "version=x"
        return library.choose_encoder("")


class Exposition:
    """Makes the text of ``/metrics`` once for all clients that ask at the same time, and not while a tick runs.

    Python runs one thread at a time. With a thousand topics, one thread that makes the text would take half of the
    turns from the tick, four threads four turns of five. So one thread makes it, and looks every few milliseconds
    whether a tick runs. It waits for ticks one second in all, because metrics matter most when ticks hang.

    Parameters
    ----------
    registry : metrics to expose
    resting : set while no tick runs, None = there are no ticks
    clock : monotonic clock (s)
    """

    def __init__(
        self, registry: Collects, *, resting: threading.Event | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._registry = registry
        self._resting = resting
        self._clock = clock
        self._lock = threading.Lock()
        self._last: tuple[str, float, bytes] = ("", -math.inf, b"")  # content type, end of its making (s), text

    def answer(self, accept: str, *, asked_s: float | None = None) -> tuple[bytes, str]:
        """Return the text and its content type.

        Parameters
        ----------
        accept : the request's Accept header
        asked_s : when the request came, on the clock (s), None = now; requests that queued share one text
        """
        asked_s = self._clock() if asked_s is None else asked_s
        encode, content_type = choose_encoder(accept)
        with self._lock:
            made, done_s, text = self._last
            if made != content_type or done_s < asked_s:
                text = encode(_Paced(self._registry, self._tick_waiter()))
                self._last = content_type, self._clock(), text
        return text, content_type

    def _tick_waiter(self) -> Callable[[], None]:
        """Return a function that waits for a running tick, with the patience of one text."""
        left_s = _PATIENCE_S

        def wait() -> None:
            nonlocal left_s
            if self._resting is not None and left_s > 0 and not self._resting.is_set():
                began_s = self._clock()
                self._resting.wait(left_s)
                left_s -= self._clock() - began_s

        return wait


class _Paced:
    """A registry whose encoder waits before each family, and within large ones: it takes them one after another."""

    def __init__(self, registry: Collects, wait: Callable[[], None]) -> None:
        self._registry = registry
        self._wait = wait

    def collect(self) -> Iterator[Metric]:
        for family in self._registry.collect():
            self._wait()
            if len(family.samples) > _AT_ONCE:
                family.samples = _PacedSamples(family.samples)
                family.samples.wait = self._wait
            yield family


class _PacedSamples(list[Sample]):
    wait: Callable[[], None]

    def __iter__(self) -> Iterator[Sample]:
        for start in range(0, len(self), _AT_ONCE):
            self.wait()
            yield from self[start : start + _AT_ONCE]
