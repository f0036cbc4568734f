"""Leader of several daemons: the one that started first drives the robot, and the others stand by."""

from __future__ import annotations

from dataclasses import dataclass

LEAST_STARTED_NS = 1_577_836_800 * 10**9  # 2020: systemd sets no clock to less

_SILENT_S = 2.0  # four heartbeats missed: that daemon is gone
_LASTING_S = 0.4  # asks for a second heartbeat, 0.5 s after the first: invented names do not return
_MOST_HEARD = 32  # daemons remembered, so invented ones cannot fill the memory


@dataclass(frozen=True, kw_only=True, slots=True, order=True)
class DaemonHeartbeat:
    """Heartbeat of a daemon, sent twice a second.

    Parameters
    ----------
    started_ns : Unix time of its start (ns). All daemons compare the same numbers, so all come to the same result even
        if clocks are wrong; a wrong clock only lets a younger daemon drive
    token : random, so no two are alike
    host : its host, for people
    """

    started_ns: int
    token: str
    host: str


class Leader:
    """Chooses the active daemon by recent heartbeats; pure, in seconds of one monotonic clock.

    Parameters
    ----------
    own : heartbeat of this daemon
    """

    def __init__(self, own: DaemonHeartbeat) -> None:
        self._own = own
        self._heard_s: dict[DaemonHeartbeat, tuple[float, float]] = {}  # first and last

    def note(self, heartbeat: DaemonHeartbeat, now_s: float) -> bool:
        """Note a heartbeat of another daemon, or of this one; return False when too many are known."""
        if heartbeat.token == self._own.token:
            return True
        if heartbeat not in self._heard_s and len(self._heard_s) >= _MOST_HEARD:
            self._forget(now_s)
            if len(self._heard_s) >= _MOST_HEARD:
                return False
        first_s, _ = self._heard_s.get(heartbeat, (now_s, now_s))
        self._heard_s[heartbeat] = first_s, now_s
        return True

    def others(self, now_s: float, *, most: int = _MOST_HEARD) -> tuple[DaemonHeartbeat, ...]:
        """Return the other daemons that run, the one that started first in front.

        Parameters
        ----------
        most : number of daemons there can be; those heard for longest count
        """
        self._forget(now_s)
        lasting = [each for each, (first_s, last_s) in self._heard_s.items() if last_s - first_s >= _LASTING_S]
        lasting.sort(key=lambda each: (self._heard_s[each][0], each))
        return tuple(sorted(lasting[: max(0, most)]))

    def active_daemon(self, now_s: float, *, most: int = _MOST_HEARD) -> DaemonHeartbeat | None:
        """Return the active daemon, None when this one is."""
        return next((heartbeat for heartbeat in self.others(now_s, most=most) if heartbeat < self._own), None)

    def _forget(self, now_s: float) -> None:
        self._heard_s = {heartbeat: at_s for heartbeat, at_s in self._heard_s.items() if now_s - at_s[1] <= _SILENT_S}
