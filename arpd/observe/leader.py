"""Which of several daemons drives the robot: the one that has run longest, and the others stand by."""

from __future__ import annotations

from dataclasses import dataclass

LEAST_STARTED_NS = 1_577_836_800 * 10**9  # 2020: no clock that systemd has set reads less

_SILENT_S = 2.0  # four claims missed: that daemon is gone
_LASTING_S = 0.4  # a second claim, half a second after the first: whoever invents names does not come back to them
_MOST = 32  # daemons remembered, so that a liar on the network cannot take our memory


@dataclass(frozen=True, kw_only=True, slots=True, order=True)
class DaemonHeartbeat:
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


class Leader:
    """Who is in charge, by what was heard lately; pure, in seconds of one monotonic clock.

    Parameters
    ----------
    own : this daemon's claim
    """

    def __init__(self, own: DaemonHeartbeat) -> None:
        self._own = own
        self._heard_s: dict[DaemonHeartbeat, tuple[float, float]] = {}  # first and last

    def note(self, claim: DaemonHeartbeat, now_s: float) -> bool:
        """Note that another daemon, or this one itself, was heard; return False where there are too many."""
        if claim.token == self._own.token:
            return True
        if claim not in self._heard_s and len(self._heard_s) >= _MOST:
            self._forget(now_s)
            if len(self._heard_s) >= _MOST:
                return False
        first_s, _ = self._heard_s.get(claim, (now_s, now_s))
        self._heard_s[claim] = first_s, now_s
        return True

    def others(self, now_s: float, *, most: int = _MOST) -> tuple[DaemonHeartbeat, ...]:
        """Return the other daemons that are there, the one that started first at the front.

        Parameters
        ----------
        most : daemons there can be; those that have been heard for longest are believed
        """
        self._forget(now_s)
        lasting = [claim for claim, (first_s, last_s) in self._heard_s.items() if last_s - first_s >= _LASTING_S]
        lasting.sort(key=lambda claim: (self._heard_s[claim][0], claim))
        return tuple(sorted(lasting[: max(0, most)]))

    def active_daemon(self, now_s: float, *, most: int = _MOST) -> DaemonHeartbeat | None:
        """Return who is in charge, None when this daemon is."""
        return next((claim for claim in self.others(now_s, most=most) if claim < self._own), None)

    def _forget(self, now_s: float) -> None:
        self._heard_s = {claim: at_s for claim, at_s in self._heard_s.items() if now_s - at_s[1] <= _SILENT_S}
