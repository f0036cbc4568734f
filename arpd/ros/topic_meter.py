"""Rate and size of a topic's samples, from what a reader took during some seconds."""

from __future__ import annotations

from dataclasses import dataclass

from arpd.model.link_topics import TopicTraffic

ENOUGH_BYTES = 32e6
ENOUGH_SAMPLES = 2000
_LEAST_SAMPLES = 10  # of large messages, so that their rate is known
_INSTANT_S = 1e-3  # arrivals are not known better


@dataclass(slots=True)
class _Writer:
    """Numbers and arrivals of the first and the last sample of one writer (s), and how many arrived."""

    first: int
    first_s: float
    last: int
    last_s: float
    arrived: int = 1


class TopicMeter:
    """Counts the samples of one topic.

    Each writer numbers its samples, so a sample that a best-effort reader lost still counts for the rate.

    Parameters
    ----------
    rated_from_s : when samples begin to count for the rate; those of a latched topic's history arrive before, and
        count for the size alone; monotonic clock (s)
    """

    def __init__(self, *, rated_from_s: float) -> None:
        self._rated_from_s = rated_from_s
        self._writers: dict[bytes, _Writer] = {}
        self._samples = 0
        self._bytes = 0
        self._largest = 0

    def add(self, *, writer: bytes, number: int, size_bytes: int, at_s: float) -> None:
        """Take one sample.

        Parameters
        ----------
        writer : identity of its writer
        number : its number there
        at_s : its arrival; monotonic clock (s)
        """
        self._samples += 1
        self._bytes += size_bytes
        self._largest = max(self._largest, size_bytes)
        if at_s < self._rated_from_s:
            return
        known = self._writers.get(writer)
        if known is None:
            self._writers[writer] = _Writer(number, at_s, number, at_s)
        elif number > known.last:
            known.last, known.last_s = number, at_s
            known.arrived += 1

    @property
    def has_enough(self) -> bool:
        """True if more samples would cost more than they tell."""
        return self._samples >= ENOUGH_SAMPLES or (self._bytes >= ENOUGH_BYTES and self._samples >= _LEAST_SAMPLES)

    def traffic(self, now_s: float) -> TopicTraffic:
        """Return what the samples so far tell; later ones do not count.

        Parameters
        ----------
        now_s : monotonic clock (s)
        """
        return TopicTraffic(
            samples=self._samples,
            rate_hz=sum(self._rate_hz(writer, now_s) for writer in self._writers.values()),
            mean_bytes=self._bytes / self._samples if self._samples else None,
            largest_bytes=self._largest if self._samples else None,
        )

    def _rate_hz(self, writer: _Writer, now_s: float) -> float:
        """Return the rate of one writer.

        Between the first and the last of n samples there are n - 1 periods. In a burst these are short, but where none
        was lost there are only n samples until now; a steady writer has at least as many as its periods say.
        """
        samples = writer.last - writer.first + 1
        if samples == 1:  # its period is unknown, but as long as the wait
            return 1.0 / max(now_s - self._rated_from_s, _INSTANT_S)
        steady_hz = (samples - 1) / max(writer.last_s - writer.first_s, _INSTANT_S)
        if writer.arrived < samples:
            return steady_hz
        return min(steady_hz, samples / max(now_s - writer.first_s, _INSTANT_S))
