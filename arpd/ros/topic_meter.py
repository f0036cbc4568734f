"""Rate and size of a topic's samples, from what a reader took during some seconds."""

from __future__ import annotations

from dataclasses import dataclass

from arpd.model.link_topics import TopicTraffic

_ENOUGH_BYTES, _ENOUGH_SAMPLES = 32e6, 2000
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

    def rate_hz(self, now_s: float, since_s: float) -> float:
        """Return its rate.

        Between the first and the last of n samples there are n - 1 periods. In a burst these are short, but where none
        was lost there are only n samples until now; a steady writer has at least as many as its periods say.
        """
        samples = self.last - self.first + 1
        if samples == 1:  # its period is unknown, but as long as the wait
            return 1.0 / max(now_s - since_s, _INSTANT_S)
        steady_hz = (samples - 1) / max(self.last_s - self.first_s, _INSTANT_S)
        if self.arrived < samples:
            return steady_hz
        return min(steady_hz, samples / max(now_s - self.first_s, _INSTANT_S))


class TopicMeter:
    """Counts the samples of one topic.

    Each writer numbers its samples, so a sample that a best-effort reader lost still counts for the rate. Those of a
    latched topic's history arrive before ``rated_from_s`` (monotonic clock) and count for the size alone.
    """

    def __init__(self, *, rated_from_s: float) -> None:
        self._rated_from_s = rated_from_s
        self._writers: dict[bytes, _Writer] = {}
        self._samples = self._bytes = self._largest = 0

    def add(self, *, writer: bytes, number: int, size_bytes: int, at_s: float) -> None:
        """Take one sample: its writer, its number there, and when it arrived, by the monotonic clock (s)."""
        self._samples += 1
        self._bytes += size_bytes
        self._largest = max(self._largest, size_bytes)
        if at_s < self._rated_from_s:
            return
        known = self._writers.setdefault(writer, _Writer(number, at_s, number, at_s))
        if number > known.last:
            known.last, known.last_s = number, at_s
            known.arrived += 1

    @property
    def has_enough(self) -> bool:
        """True if more samples would cost more than they tell."""
        return self._samples >= _ENOUGH_SAMPLES or (self._bytes >= _ENOUGH_BYTES and self._samples >= _LEAST_SAMPLES)

    def traffic(self, now_s: float) -> TopicTraffic:
        """Return what the samples so far tell; later ones do not count."""
        return TopicTraffic(
            samples=self._samples,
            rate_hz=sum(writer.rate_hz(now_s, self._rated_from_s) for writer in self._writers.values()),
            mean_bytes=self._bytes / self._samples if self._samples else None,
            largest_bytes=self._largest or None,
        )
