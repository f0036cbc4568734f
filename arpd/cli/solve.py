"""`arpd solve`: the published program, Eq. (4), for given numbers, or arpd's program for a configuration's topics."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from arpd.cli.options import Command, add_json
from arpd.model.errors import ArpdError, UsageError
from arpd.model.settings import Backend
from arpd.solve.backends import Solver
from arpd.solve.eq4 import Eq4Problem, whole

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping

_PAPER = ("rmax", "sensing", "actuation", "rmin", "dmin", "dmax")
_PAPER_NEEDS = ("rmax", "sensing", "actuation")
_OFFLINE = ("config", "capacity", "status")
_TEXT = """\
Without a configuration, solve Eq. (4) of Jalil & Kobayashi for one DEADLINE rate R and one DEPTH D that all N topics
share. Exits 1 when the constraints cannot be met.

    max R + D    subject to    Rmax/N - R >= Rmin                            (2)
                               Dmax*R/Rmax - D >= Dmin                       (3)
                               Rmin <= R <= Rmax, Dmin <= D <= Dmax          (4)

With --config, show what the daemon would plan for the file's topics on a link of a given capacity, or the rates on
several. Payload and rate of a topic's source come from the file (payload, source_rate_hz), or from what a running
daemon measured (--status). Needs neither ROS nor a daemon.

examples:
  arpd solve --rmax 100 --sensing 11 --actuation 1            the first row of the paper's Table 2: R 7 Hz, D 365
  arpd solve --rmax 1000 --sensing 11 --actuation 1 --backend cvxpy --json
  arpd solve --rmax 100 --sensing 80 --actuation 1            infeasible: too many topics

  arpd solve --config robot.yaml --capacity 5mbit             rate, DEADLINE and DEPTH of every topic
  arpd solve --config robot.yaml --capacity 1mbit,5mbit,20mbit   how the rates move with the link
  arpd status --json > robot.json && arpd solve --config new.yaml --status robot.json --capacity 5mbit

what a rate or depth is bound by:
  desired   it has what it asked for: max_rate_hz, or all that its source publishes
  link      a faster link would give it more; weight decides which topic gets how much
  minimum   min_rate_hz or min_depth keeps it up
  latency   latency_budget: a deeper history would only be older
  max       max_depth            memory    program.memory_budget"""
_BOTH_MODES = "--rmax, --sensing and --actuation (the paper), or --config with --capacity (your topics)"


def _add_options(parser: argparse.ArgumentParser) -> None:
    _add_paper(parser.add_argument_group("the paper's program"))
    _add_offline(parser.add_argument_group("your topics, offline"))
    backends = [str(backend) for backend in Backend]
    parser.add_argument("--backend", choices=backends, help="solver (default osqp, or the configuration's)")
    add_json(parser)


def _add_paper(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--rmax", type=float, metavar="HZ", help="Rmax, the highest rate with one topic only (Hz)")
    group.add_argument("--sensing", type=int, metavar="N", help="topics from the robot, SPt")
    group.add_argument("--actuation", type=int, metavar="N", help="topics to the robot, PAAt")
    group.add_argument("--rmin", type=float, metavar="HZ", help="Rmin (Hz, default 1)")
    group.add_argument("--dmin", type=int, metavar="N", help="Dmin (samples, default 1)")
    group.add_argument("--dmax", type=int, metavar="N", help="Dmax (samples, default 5000)")


def _add_offline(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--config", type=Path, metavar="FILE", help="YAML configuration whose topics are planned")
    group.add_argument("--capacity", metavar="RATE[,RATE...]", help="plan for links of these capacities, like 5mbit")
    group.add_argument(
        "--status", type=Path, metavar="FILE", help="take what topics publish from a saved `arpd status --json`"
    )


def _solve(options: argparse.Namespace) -> int:
    paper = [name for name in _PAPER if getattr(options, name) is not None]
    offline = [name for name in _OFFLINE if getattr(options, name) is not None]
    if paper and offline:
        raise UsageError(f"--{paper[0]} and --{offline[0]} do not go together; give {_BOTH_MODES}")
    if not paper and not offline:
        raise UsageError(f"nothing to solve; give {_BOTH_MODES}")
    if not offline:
        return _solve_paper(options)
    if options.config is None:
        raise UsageError(f"--{offline[0]} needs --config FILE, whose topics are planned")
    from arpd.cli.solve_topics import solve_topics

    return solve_topics(options)


def _solve_paper(options: argparse.Namespace) -> int:
    problem, asked = _problem(options), Backend(options.backend or Backend.OSQP)
    if refusal := problem.refusal():
        if not options.json:
            raise ArpdError(f"infeasible: {refusal}")
        print(json.dumps({"status": "infeasible", "binding": refusal}, indent=2))
        return 1
    (rate_hz, depth), backend = Solver(asked).eq4(problem)
    deadline_ns, depth_applied = problem.applied(rate_hz)
    answer = {
        "status": "optimal",
        "rate_hz": rate_hz,
        "depth": depth,
        "rate_hz_floor": whole(rate_hz),
        "depth_floor": whole(depth),
        "deadline_ns": deadline_ns,
        "depth_applied": depth_applied,
        "binding": "(2) link share, (3) depth share",
        "backend": backend,
    }
    print(json.dumps(answer, indent=2) if options.json else _table(problem, answer))
    if backend is not asked:
        print(f"arpd: {asked} gave no correct answer; this one is the closed form's", file=sys.stderr)
    return 0


def _problem(options: argparse.Namespace) -> Eq4Problem:
    missing = [f"--{name}" for name in _PAPER_NEEDS if getattr(options, name) is None]
    if missing:
        raise UsageError(f"the paper's program needs {' and '.join(missing)}, too; give {_BOTH_MODES}")
    for name, count in (("--sensing", options.sensing), ("--actuation", options.actuation)):
        if count < 0:
            raise UsageError(f"{name} {count} is below 0; count the topics")
    try:
        return Eq4Problem(
            max_rate_hz=options.rmax,
            topics=options.sensing + options.actuation,
            min_rate_hz=1.0 if options.rmin is None else options.rmin,
            min_depth=1 if options.dmin is None else options.dmin,
            max_depth=5000 if options.dmax is None else options.dmax,
        )
    except (ValueError, OverflowError) as error:
        raise UsageError(str(error)) from error


def _table(problem: Eq4Problem, answer: Mapping[str, Any]) -> str:
    return """\
{topics} topics share Rmax {max_rate_hz:g} Hz: publish each at {rate_hz_floor} Hz \
with a history of {depth_floor} samples.

              optimum   published      applied
  rate    {rate_hz:11.3f} {rate_hz_floor:11d}  {applied_hz:11.3f} Hz
  depth   {depth:11.3f} {depth_floor:11d}  {depth_applied:11d} samples
  DEADLINE {empty:22}  {deadline_ns:11d} ns

binding: {binding}; solved by {backend}""".format(
        **answer,
        topics=problem.topics,
        max_rate_hz=problem.max_rate_hz,
        applied_hz=1e9 / answer["deadline_ns"],
        empty="",
    )


SOLVE = Command(_TEXT, _add_options, _solve)
