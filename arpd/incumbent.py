"""Which of several daemons drives the robot: the one that has run longest, and the others stand by."""

from __future__ import annotations

from dataclasses import dataclass

_SILENT_S = 2.0  # four claims missed: that daemon is gone
_MOST = 32  # daemons remembered, so that a liar on the network cannot take our memory


@dataclass(frozen=True, kw_only=True, slots=True, order=True)
class Claim:
    """What a daemon says of itself, twice a second.

    Parameters
    ----------
    started_ns : Unix time it started at (ns). Each daemon compares the same two numbers, so that all come to the same
        result, whatever their clocks are worth; a wrong one only means that a younger daemon drives
    token : random, so that no two are alike
    host : where it runs, for people
    """

    started_ns: int
    token: str
    host: str


class Incumbency:
    """Who is in charge, by what was heard lately; pure, in seconds of one monotonic clock.

    Parameters
    ----------
    own : this daemon's claim
    """

    def __init__(self, own: Claim) -> None:
        self._own = own
        self._heard_s: dict[Claim, float] = {}

    def note(self, claim: Claim, now_s: float) -> None:
        """Note that another daemon, or this one itself, was heard."""
        if claim.token != self._own.token and (claim in self._heard_s or len(self._heard_s) < _MOST):
            self._heard_s[claim] = now_s

    def others(self, now_s: float) -> tuple[Claim, ...]:
        """Return the other daemons that are there, the one that started first at the front."""
        self._heard_s = {claim: at_s for claim, at_s in self._heard_s.items() if now_s - at_s <= _SILENT_S}
        return tuple(sorted(self._heard_s))

    def superior(self, now_s: float) -> Claim | None:
        """Return who is in charge, None when this daemon is."""
        return next((claim for claim in self.others(now_s) if claim < self._own), None)
