"""Clocks of the peers against this host's, from the time stamps of probes and reports."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from arpd.model.probing import ClockOffset

if TYPE_CHECKING:
    from arpd.model.probing import PeerReport

_WINDOW_S = 30.0  # two clocks that nobody corrects part by 3 ms in this time (100 ppm)
_ROUNDING_S = 1e-6  # of a delay between clocks of which one was never set


class _Sample(NamedTuple):
    at_s: float
    offset: ClockOffset


class PeerClocks:
    """Measures how far each peer's clock is ahead, as NTP does (RFC 5905, section 8).

    A probe takes w₁ to the peer, and its delay by the two clocks is w₁ + θ; a report takes w₂ back, and shows w₂ − θ.
    So θ is half the difference, and wrong by at most half the round trip w₁ + w₂, however unequal the two ways are. The
    shortest round trip of the last 30 s tells most.
    """

    def __init__(self) -> None:
        # Later samples have longer round trips, so the first is the best of the window.
        self._samples: dict[str, deque[_Sample]] = {}

    def note(self, report: PeerReport) -> None:
        """Note a report that is believed."""
        if not report.delays_s or report.return_delay_s is None:
            return
        there_s, back_s = min(report.delays_s), report.return_delay_s
        if there_s + back_s < -_ROUNDING_S:
            self._samples.pop(report.peer, None)  # a clock was set between probe and report
            return
        found = ClockOffset(offset_s=(there_s - back_s) / 2, uncertainty_s=max(0.0, there_s + back_s) / 2)
        kept = self._samples.setdefault(report.peer, deque())
        if any(not _overlap(sample.offset, found) for sample in kept):
            kept.clear()  # both bounds hold, so a clock was set since
        while kept and kept[-1].offset.uncertainty_s >= found.uncertainty_s:
            kept.pop()
        kept.append(_Sample(report.received_at_s, found))
        self._forget(report.received_at_s)

    def offsets(self, now_s: float) -> dict[str, ClockOffset]:
        """Return the offset of each peer whose reports tell it, by name.

        Parameters
        ----------
        now_s : monotonic clock (s)
        """
        self._forget(now_s)
        return {peer: kept[0].offset for peer, kept in self._samples.items()}

    def _forget(self, now_s: float) -> None:
        for peer, kept in [*self._samples.items()]:
            while kept and now_s - kept[0].at_s > _WINDOW_S:
                kept.popleft()
            if not kept:
                del self._samples[peer]


def _overlap(one: ClockOffset, other: ClockOffset) -> bool:
    return abs(one.offset_s - other.offset_s) <= one.uncertainty_s + other.uncertainty_s + _ROUNDING_S
