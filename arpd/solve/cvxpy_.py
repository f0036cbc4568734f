"""The program in cvxpy, as one reads it in the paper: Eq. (4), and (G1) and (G2) of docs/design.md.

Import this module only on demand: it costs about 2 s, and 82 MiB in `arpd run`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cvxpy as cp

if TYPE_CHECKING:
    from arpd.solve.eq4 import Eq4Problem
    from arpd.solve.level import Column

_ACCURATELY: dict[str, Any] = {"solver": cp.CLARABEL, "tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12}


def eq4(problem: Eq4Problem) -> tuple[float, float]:
    """Return (R, D) of Eq. (4)."""
    R, D = cp.Variable(), cp.Variable()  # noqa: N806 - the paper's names
    Rmax, Rmin, N = problem.max_rate_hz, problem.min_rate_hz, problem.topics  # noqa: N806 - the paper's names
    Dmax, Dmin = problem.max_depth, problem.min_depth  # noqa: N806 - the paper's names
    cp.Problem(
        cp.Maximize(R + D),
        [
            Rmax / N - R >= Rmin,  # (2)
            Dmax * R / Rmax - D >= Dmin,  # (3)
            Rmin <= R,
            Rmax >= R,
            Dmin <= D,
            Dmax >= D,
        ],
    ).solve(**_ACCURATELY)
    return float(R.value), float(D.value)


def level(weights: Column, low: Column, high: Column, budget: float) -> float:
    """Return ν, the dual of the link in (G1), or of the memory in (G2).

    (G1): e_i = a_i·R_i is the share of link time, a_i·ℓ_i ≤ e_i ≤ a_i·u_i, and B = η.
    (G2): e_i = m_i·D_i is memory, m_i·Dmin_i ≤ e_i ≤ m_i·min(Dmax_i, τ_i·u_i − δ_i), and B = M.

    Shares are parts of B here, and weights parts of all weight, so that all numbers are near 1.
    """
    e, w = cp.Variable(len(weights)), weights / weights.sum()
    link = cp.sum(e) == 1
    cp.Problem(
        cp.Minimize(cp.sum_squares(cp.multiply(w**-0.5, e)) / 2),
        [link, low / budget <= e, e <= high / budget],
    ).solve(**_ACCURATELY)
    return -float(link.dual_value) * budget / float(weights.sum())
