"""Clocks of the peers against this host's, from the time stamps of probes and reports."""

from __future__ import annotations

from arpd.model.probing import ClockOffset, PeerReport

_WINDOW_S = 30.0  # two clocks that nobody corrects part by 3 ms in this time (100 ppm)
_ROUNDING_S = 1e-6  # of a delay between clocks of which one was never set


class PeerClocks:
    """Measures how far each peer's clock is ahead, as NTP does (RFC 5905, section 8).

    A probe takes w₁ to the peer, and its delay by the two clocks is w₁ + θ; a report takes w₂ back, and shows w₂ − θ.
    So θ is half the difference, and wrong by at most half the round trip w₁ + w₂, however unequal the two ways are. A
    short round trip tells most; one of the last 30 s is kept.
    """

    def __init__(self) -> None:
        self._best: dict[str, tuple[float, ClockOffset]] = {}  # when it was found (s), by peer

    def note(self, report: PeerReport) -> None:
        """Note a report that is believed."""
        if not report.delays_s or report.return_delay_s is None:
            return
        there_s, back_s = min(report.delays_s), report.return_delay_s
        if there_s + back_s < -_ROUNDING_S:
            self._best.pop(report.peer, None)  # a clock was set between probe and report
            return
        found = ClockOffset(offset_s=(there_s - back_s) / 2, uncertainty_s=max(0.0, there_s + back_s) / 2)
        best = self.offsets(report.received_at_s).get(report.peer, found)
        is_set = abs(best.offset_s - found.offset_s) > best.uncertainty_s + found.uncertainty_s + _ROUNDING_S
        if is_set or found.uncertainty_s <= best.uncertainty_s:  # both bounds hold, unless a clock was set since
            self._best[report.peer] = report.received_at_s, found

    def offsets(self, now_s: float) -> dict[str, ClockOffset]:
        """Return the offset of each peer whose reports told it lately, by name."""
        self._best = {peer: kept for peer, kept in self._best.items() if now_s - kept[0] <= _WINDOW_S}
        return {peer: offset for peer, (_, offset) in self._best.items()}
