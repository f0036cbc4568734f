"""Asks the back end of the configuration, proves its answer, and lets the closed form answer where that fails.

A solver library is loaded when it is first asked: a link that carries all needs none.
"""

from __future__ import annotations

import logging
import math
from collections import Counter
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, TypeVar

from arpd.model.settings import Backend
from arpd.solve.level import TOLERANCE, Column, residual, water_level

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.solve.eq4 import Eq4Problem

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
    load : imports the module of a back end; returns None until then, while the closed form answers: that is no failure
    """

    def __init__(
        self,
        backend: Backend,
        outcomes: Counter[tuple[str, str]] | None = None,
        *,
        load: Callable[[str], Any] | None = None,
    ) -> None:
        self.outcomes: Counter[tuple[str, str]] = Counter() if outcomes is None else outcomes
        self._backend, self._load = backend, load or import_module
        self._fault = ""
        if backend is not Backend.CLOSED_FORM and find_spec(backend) is None:
            self._note("is not installed")

    def level(self, weights: Column, low: Column, high: Column, budget: float) -> tuple[float, Backend | None]:
        """Return ν and who found it; None where nobody is asked, because all ceilings fit, or the floors alone."""
        if high.sum() <= budget * (1.0 + TOLERANCE):
            return math.inf, None
        closed = water_level(weights, low, high, budget)
        if low.sum() >= budget * (1.0 - TOLERANCE):
            return closed, None
        return self._asked(
            lambda library: library.level(weights, low, high, budget),
            closed=closed,
            missed_by=lambda level: residual(level, weights, low, high, budget),
        )

    def eq4(self, problem: Eq4Problem) -> tuple[tuple[float, float], Backend]:
        """Return (R, D) of an Eq. (4) that has a solution, and who found it."""
        rate_hz, depth = problem.vertex()
        return self._asked(
            lambda library: library.eq4(problem),
            closed=(rate_hz, depth),
            missed_by=lambda found: (
                abs(found[0] - rate_hz) / problem.max_rate_hz + abs(found[1] - depth) / problem.max_depth
            ),
        )

    def _asked(self, ask: Callable[[Any], T], *, closed: T, missed_by: Callable[[T], float]) -> tuple[T, Backend]:
        outcome = ""
        try:
            if self._backend is not Backend.CLOSED_FORM and (library := self._load(f"arpd.solve.{self._backend}_")):
                if (missed := missed_by(answer := ask(library))) <= TOLERANCE:
                    self.outcomes[self._backend, "solved"] += 1
                    return answer, self._backend
                outcome = "failed" if math.isnan(missed) else "disagreed"
        except Exception as error:  # noqa: BLE001 - a library may raise anything
            outcome = "failed"
            self._note(f"cannot be used ({type(error).__name__}: {error})")
        if outcome:
            self.outcomes[self._backend, outcome] += 1
        self.outcomes[Backend.CLOSED_FORM, "solved"] += 1
        return closed, Backend.CLOSED_FORM

    def _note(self, fault: str) -> None:
        """Log a fault once, not at every plan."""
        if fault != self._fault:
            self._fault = fault
            log.error("program.backend: %s %s; the closed form answers", self._backend, fault)
