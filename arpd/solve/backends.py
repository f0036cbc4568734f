"""Asks the back end of the configuration, proves its answer, and lets the closed form answer where that fails.

Importing this module loads no solver library; a `Solver` loads the one that it asks.
"""

from __future__ import annotations

import logging
import math
from collections import Counter
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

from arpd.model.settings import Backend
from arpd.solve.level import TOLERANCE, residual, water_level

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.solve.eq4 import Eq4Problem
    from arpd.solve.level import Column

log = logging.getLogger(__name__)
T = TypeVar("T")


class Solver:
    """Answers by a back end; by the closed form where it is missing, raises, finds nothing, or misses by 1e-6.

    A back end is a module with ``level``, for ν of (G1) or (G2) where floors fit and not all ceilings do, and ``eq4``,
    for (R, D) of an Eq. (4) that has a solution. It may raise anything, and returns nan where it finds no answer.

    Parameters
    ----------
    backend : back end to ask
    outcomes : (back end, ``solved`` | ``failed`` | ``disagreed``) → count; its own by default
    """

    def __init__(self, backend: Backend, outcomes: Counter[tuple[str, str]] | None = None) -> None:
        self.outcomes: Counter[tuple[str, str]] = Counter() if outcomes is None else outcomes
        self._backend = backend
        self._fault = ""
        self._library: Any = None
        try:
            if backend is not Backend.CLOSED_FORM:
                self._library = import_module(f"arpd.solve.{backend}_")
        except Exception as error:  # noqa: BLE001 - of an installation that does not fit, a library may raise anything
            self._note(f"cannot be used ({error})")

    def level(self, weights: Column, low: Column, high: Column, budget: float) -> tuple[float, Backend | None]:
        """Return ν and who found it; None where nobody is asked, because all ceilings fit, or the floors alone."""
        if high.sum() <= budget * (1.0 + TOLERANCE):
            return math.inf, None
        closed = water_level(weights, low, high, budget)
        if low.sum() >= budget * (1.0 - TOLERANCE):
            return closed, None
        return self._asked(
            lambda: self._library.level(weights, low, high, budget),
            closed=closed,
            missed_by=lambda level: residual(level, weights, low, high, budget),
        )

    def eq4(self, problem: Eq4Problem) -> tuple[tuple[float, float], Backend]:
        """Return (R, D) of an Eq. (4) that has a solution, and who found it."""
        rate_hz, depth = problem.vertex()
        return self._asked(
            lambda: self._library.eq4(problem),
            closed=(rate_hz, depth),
            missed_by=lambda found: (
                abs(found[0] - rate_hz) / problem.max_rate_hz + abs(found[1] - depth) / problem.max_depth
            ),
        )

    def _asked(self, ask: Callable[[], T], *, closed: T, missed_by: Callable[[T], float]) -> tuple[T, Backend]:
        if self._backend is not Backend.CLOSED_FORM:
            missed = math.nan
            try:
                if self._library is not None and (missed := missed_by(answer := ask())) <= TOLERANCE:
                    self.outcomes[self._backend, "solved"] += 1
                    return answer, self._backend
            except Exception as error:  # noqa: BLE001 - a library may raise anything
                self._note(f"raised {type(error).__name__}: {error}")
            self.outcomes[self._backend, "failed" if math.isnan(missed) else "disagreed"] += 1
        self.outcomes[Backend.CLOSED_FORM, "solved"] += 1
        return closed, Backend.CLOSED_FORM

    def _note(self, fault: str) -> None:
        """Log a fault once, not at every plan."""
        if fault != self._fault:
            self._fault = fault
            log.error("program.backend: %s %s; the closed form answers", self._backend, fault)
