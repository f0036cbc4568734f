"""`arpd solve`: the published program, Eq. (4), for given numbers."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING

from arpd.errors import ArpdError, UsageError
from arpd.settings import Backend

if TYPE_CHECKING:
    from arpd.paper import Eq4Problem, Eq4Solution


def add_solve(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "solve",
        help="solve the published DEPTH/DEADLINE program for given numbers",
        description="""\
Solve Eq. (4) of Jalil & Kobayashi for one DEADLINE rate R and one DEPTH D that all N topics share:

    max R + D    subject to    Rmax/N - R >= Rmin                            (2)
                               Dmax*R/Rmax - D >= Dmin                       (3)
                               Rmin <= R <= Rmax, Dmin <= D <= Dmax          (4)

Needs neither ROS nor a daemon. The answer is checked against the exact vertex in rational arithmetic.
Exits 1 when the constraints cannot be met, and says which.""",
        epilog="""\
examples:
  arpd solve --rmax 100 --sensing 11 --actuation 1            the first row of the paper's Table 2: R 7 Hz, D 365
  arpd solve --rmax 1000 --sensing 11 --actuation 1 --backend exact --json
  arpd solve --rmax 100 --sensing 80 --actuation 1            infeasible: too many topics""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--rmax", type=float, required=True, metavar="HZ", help="Rmax, the highest rate with one topic only (Hz)"
    )
    parser.add_argument("--sensing", type=int, required=True, metavar="N", help="topics from the robot, SPt")
    parser.add_argument("--actuation", type=int, required=True, metavar="N", help="topics to the robot, PAAt")
    parser.add_argument("--rmin", type=float, default=1.0, metavar="HZ", help="Rmin (Hz, default %(default)g)")
    parser.add_argument("--dmin", type=int, default=1, metavar="N", help="Dmin (samples, default %(default)s)")
    parser.add_argument("--dmax", type=int, default=5000, metavar="N", help="Dmax (samples, default %(default)s)")
    parser.add_argument(
        "--backend",
        choices=[str(backend) for backend in Backend],
        default=str(Backend.OSQP),
        help="solver (default %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(handler=_solve)


class _InfeasibleError(ArpdError):
    """The constraints cannot be met together."""


def _solve(options: argparse.Namespace) -> int:
    from arpd.paper import Eq4Status, solve_eq4

    problem = _problem(options)
    try:
        solution = solve_eq4(problem, Backend(options.backend))
    except ImportError as error:
        raise UsageError(f"back end {options.backend} is not installed here ({error}); try --backend exact") from error
    infeasible = solution.status is Eq4Status.INFEASIBLE
    if options.json:
        print(json.dumps(asdict(solution), indent=2))
        return 1 if infeasible else 0
    if infeasible:
        raise _InfeasibleError(f"infeasible: {solution.binding}")
    print(_table(problem, solution))
    if not solution.agreed:
        print(f"arpd: {options.backend} gave no correct answer; this one is exact's", file=sys.stderr)
    return 0


def _problem(options: argparse.Namespace) -> Eq4Problem:
    from arpd.paper import Eq4Problem

    for name, count in (("--sensing", options.sensing), ("--actuation", options.actuation)):
        if count < 0:
            raise UsageError(f"{name} {count} is below 0; count the topics")
    try:
        return Eq4Problem(
            max_rate_hz=options.rmax,
            topics=options.sensing + options.actuation,
            min_rate_hz=options.rmin,
            min_depth=options.dmin,
            max_depth=options.dmax,
        )
    except (ValueError, OverflowError) as error:
        raise UsageError(str(error)) from error


def _table(problem: Eq4Problem, solution: Eq4Solution) -> str:
    return f"""\
{problem.topics} topics share Rmax {problem.max_rate_hz:g} Hz: publish each at {solution.rate_hz_floor} Hz \
with a history of {solution.depth_floor} samples.

              optimum   published      applied
  rate    {solution.rate_hz:11.3f} {solution.rate_hz_floor:11d}  {1e9 / solution.deadline_ns:11.3f} Hz
  depth   {solution.depth:11.3f} {solution.depth_floor:11d}  {solution.depth_applied:11d} samples
  DEADLINE {"":22}  {solution.deadline_ns:11d} ns

binding: {solution.binding}; solved by {solution.backend}"""
