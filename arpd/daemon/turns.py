"""Turns: the ticks at which the daemon does everything, and not only what follows the link."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from arpd.model.endpoints import PublisherState

_EVERY_S = 0.5
_EARLY_S = 0.01  # ticks come every 0.03 or 0.1 s; the nearest one takes the turn
_MOST_REST_S = 2.0  # a turn that something else held up is no measure
_RESTS = 30.0  # times its duration, so that a thousand topics leave most of a core to the robot


class Turns:
    """Decides which ticks are whole turns: two a second, and at once when what the program rests on has changed.

    Turns that take long are rarer.
    """

    def __init__(self) -> None:
        self._began_s = -math.inf
        self._took_s = 0.0
        self._facts: Hashable = None
        self._publishers: Sequence[PublisherState] = ()
        self._is_settled = False

    def ask(self) -> None:
        """Make the next tick a whole turn."""
        self._began_s = -math.inf

    def is_due(self, now_s: float, *, facts: Hashable, publishers: Sequence[PublisherState]) -> bool:
        """Return whether a tick is a whole turn.

        Parameters
        ----------
        facts : whatever calls for a turn when it changes
        publishers : those of the observation; the same object until something was announced
        """
        since_s = now_s - self._began_s
        # While a plan is under way, announcements bring its next step.
        is_news = facts != self._facts or not (self._is_settled or publishers is self._publishers)
        return since_s >= min(_MOST_REST_S, _RESTS * self._took_s) and (is_news or since_s >= _EVERY_S - _EARLY_S)

    def note(
        self,
        now_s: float,
        *,
        facts: Hashable,
        publishers: Sequence[PublisherState],
        took_s: float,
        is_settled: bool,
    ) -> None:
        """Note a whole turn that finished; after one that raised, the next tick is whole again.

        Parameters
        ----------
        took_s : its duration (s)
        is_settled : whether every endpoint has the plan
        """
        self._began_s, self._took_s = now_s, took_s
        self._facts, self._publishers, self._is_settled = facts, publishers, is_settled
