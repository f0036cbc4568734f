"""How a topic begins that no plan covers yet: pure."""

from __future__ import annotations

from arpd.model.wire import FRAGMENT_BYTES

#: Rate of a topic of large samples until its first plan: two cameras, two lidars and a point cloud take 1 Mbit/s (Hz).
SLOW_START_HZ = 2.0
_LONGEST_S = 4.0  # a plan takes an announcement, the governor's debounce and a parameter call, some 2.5 s


class SlowStart:
    """Tells whether a topic must wait for its first plan, as a TCP sender begins with a small window (RFC 5681 §3.1).

    What a source will put on the link is not known before it has been heard for a while; until then a robot that
    starts its camera on a weak link would fill every queue. Only topics whose samples take more than one packet wait,
    only while a daemon is there to plan them, and not for ever: one that stays on its host is never planned.
    """

    def __init__(self) -> None:
        self.has_daemon = False
        self._until_s: float | None = None  # None before the first sample
        self._is_large = False

    def begin(self, sample_bytes: int, now_s: float) -> None:
        """Note the first sample."""
        if self._until_s is None:
            self._until_s = now_s + _LONGEST_S
            self._is_large = sample_bytes > FRAGMENT_BYTES

    def end(self) -> None:
        """Note that there is a plan; it never begins again."""
        self._until_s, self._is_large = 0.0, False

    def holds(self, now_s: float) -> bool:
        """Whether the topic must wait."""
        return self.has_daemon and self._is_large and self._until_s is not None and now_s < self._until_s
