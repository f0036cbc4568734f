"""The one problem every back end solves, and the one typed outcome each of them returns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.settings import Backend

#: Shares are fractions of the whole link, so one absolute tolerance fits every topic (DESIGN §4).
TOLERANCE = 1e-6
#: A topic that needs 1e-5 of the link would hide a 10 % error below ``TOLERANCE``; this one it cannot hide.
RELATIVE_TOLERANCE = 1e-3
#: Shares this close to a bound (relative) stand on it.
_ON_BOUND = 1e-9
#: Float noise of a sum of floors; feasibility itself is decided by the caller in exact arithmetic.
_NOISE = 1e-12


@dataclass(frozen=True, kw_only=True, slots=True)
class ShareProblem:
    """Divide one budget over weighted, bounded shares: (G1) of the link, (G2) of memory (DESIGN §4).

    ``min Σ e_i²/(2 w_i) − κ Σ e_i  s.t.  Σ e_i ≤ B, lo_i ≤ e_i ≤ hi_i`` with κ ≥ max hi_i / w_i, so that no share
    stops growing for any reason but a constraint. Its solution is e_i = clip(ν·w_i, lo_i, hi_i): weighted
    proportional-fair and weighted max-min at once.

    Parameters
    ----------
    weights : w_i > 0
    lo, hi : bounds of the shares, 0 ≤ lo_i ≤ hi_i ≤ 1 (dimensionless)
    budget : B > 0 (dimensionless)
    """

    weights: tuple[float, ...]
    lo: tuple[float, ...]
    hi: tuple[float, ...]
    budget: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Solved:
    """A vector whose residuals were checked by us, not only by the library that returned it."""

    kind: ClassVar[str] = "solved"
    values: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Infeasible:
    """No vector can satisfy the constraints; found analytically, never from a solver's status."""

    kind: ClassVar[str] = "infeasible"
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class SolverFailed:
    """The back end has no usable answer: a status other than solved, or residuals that do not hold."""

    kind: ClassVar[str] = "failed"
    reason: str


Outcome = Solved | Infeasible | SolverFailed


class Solver(Protocol):
    """A back end; ``name`` is its name in settings, metrics and ``Allocation.backend``."""

    name: Backend

    def solve(self, problem: ShareProblem) -> Outcome:
        """Solve ``problem``; a library's exception comes back as ``SolverFailed``."""
        ...


def infeasibility(problem: ShareProblem) -> Infeasible | None:
    """Return why ``problem`` has no solution, None when it has one: the floors alone decide."""
    floors = math.fsum(problem.lo)
    if floors > problem.budget + _NOISE:
        return Infeasible(reason=f"floors need {floors:.6g} of a budget of {problem.budget:.6g}")
    return None


def checked(problem: ShareProblem, values: Sequence[float], *, solver: str) -> Outcome:
    """Turn a library's vector into an outcome: ``Solved`` only if every constraint holds to ``TOLERANCE``."""
    violation = residual(problem, values)
    if not violation <= TOLERANCE:  # also catches nan
        return SolverFailed(reason=f"{solver}: constraints are violated by {violation:.3g}")
    return Solved(values=settle(problem, values))


def residual(problem: ShareProblem, values: Sequence[float]) -> float:
    """Largest violation of any constraint (dimensionless); nan when a value is nan."""
    if len(values) != len(problem.lo) or any(math.isnan(value) for value in values):
        return math.nan
    return max(
        math.fsum(values) - problem.budget,
        *(lo - value for lo, value in zip(problem.lo, values, strict=True)),
        *(value - hi for hi, value in zip(problem.hi, values, strict=True)),
        0.0,
    )


def settle(problem: ShareProblem, values: Sequence[float]) -> tuple[float, ...]:
    """Clip a vector to its bounds, put what stands on a bound exactly there, and give back what exceeds the budget.

    A solver's 9.99999999 for a bound of 10 must not become another deadline, so near-bound shares take the bound.
    Clipping can only break the budget; the excess is taken from the shares above their floors, in proportion,
    from those between their bounds first, so that a topic that has all it wants keeps it.
    """
    lows, highs = problem.lo, problem.hi
    shares = [_to_bound(value, lo=lo, hi=hi) for value, lo, hi in zip(values, lows, highs, strict=True)]
    between = [e - lo if lo < e < hi else 0.0 for e, lo, hi in zip(shares, lows, highs, strict=True)]
    shares = _give_back(shares, room=between, budget=problem.budget)
    above = [e - lo for e, lo in zip(shares, lows, strict=True)]
    return tuple(_give_back(shares, room=above, budget=problem.budget))


def disagreement(values: Sequence[float], reference: Sequence[float]) -> bool:
    """Whether two answers differ by more than the tolerances, absolute or relative, in any share."""
    return any(
        abs(value - truth) > min(TOLERANCE, RELATIVE_TOLERANCE * max(truth, _NOISE))
        for value, truth in zip(values, reference, strict=True)
    )


def _to_bound(value: float, *, lo: float, hi: float) -> float:
    if value >= hi * (1.0 - _ON_BOUND):
        return hi
    return lo if value <= lo * (1.0 + _ON_BOUND) else value


def _give_back(shares: list[float], *, room: list[float], budget: float) -> list[float]:
    excess, total = math.fsum(shares) - budget, math.fsum(room)
    if excess <= 0.0 or total <= 0.0:
        return shares
    factor = min(1.0, excess / total)
    return [share - factor * part for share, part in zip(shares, room, strict=True)]
