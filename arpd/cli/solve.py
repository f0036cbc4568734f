"""`arpd solve`: the published program, Eq. (4), for given numbers, or arpd's program for a configuration's topics."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, replace
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.text import Text

from arpd.cli.options import Command, add_json, within
from arpd.cli.output import fitted, show
from arpd.govern.plan import Wanted
from arpd.host.config.load import load_settings
from arpd.host.config.yaml_source import START, Fault, config_error
from arpd.model.errors import ArpdError, UsageError
from arpd.model.kinds import between
from arpd.model.quantities import RATE, format_number, format_rate, format_share, format_size
from arpd.model.settings import Backend, Settings
from arpd.report.wording import count
from arpd.solve.backends import Solver
from arpd.solve.eq4 import Eq4Problem, whole
from arpd.solve.program import Program
from arpd.solve.topics import Traffic, assumed_traffic, rows_of_traffic

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Mapping, Sequence

    Document = Mapping[str, Any]

_LEAST_HZ, _MOST = 0.001, 1_000_000  # of rates (Hz), topics and samples
_TEXT = """\
Without a configuration, solve Eq. (4) of Jalil & Kobayashi for one DEADLINE rate R and one DEPTH D that all N topics
share. Exits 1 when the constraints cannot be met.

    max R + D    subject to    Rmax/N - R >= Rmin                            (2)
                               Dmax*R/Rmax - D >= Dmin                       (3)
                               Rmin <= R <= Rmax, Dmin <= D <= Dmax          (4)

With --config, show what the daemon would plan for the file's topics on a link of a given capacity, or of several.
Payload and rate of a topic's source come from the file (payload, source_rate_hz), and topics without both are left out;
arpd topics --suggest measures them. Needs neither ROS nor a daemon.

examples:
  arpd solve --rmax 100 --sensing 11 --actuation 1            the first row of the paper's Table 2: R 7 Hz, D 365
  arpd solve --rmax 1000 --sensing 11 --actuation 1 --backend cvxpy --json
  arpd solve --rmax 100 --sensing 80 --actuation 1            infeasible: too many topics

  arpd solve --config robot.yaml --capacity 5mbit             rate, DEADLINE and DEPTH of every topic
  arpd solve --config robot.yaml --capacity 1mbit,5mbit,20mbit   how they move with the link

what a rate or depth is bound by:
  desired rate     it has what it asked for: max_rate_hz, or all that its source publishes
  link             a faster link would give it more; weight decides which topic gets how much
  minimum          min_rate_hz or min_depth keeps it up
  latency budget   a deeper history would only be older
  max depth        max_depth
  memory           program.memory_budget"""
_PAPER, _OWN = ("rmax", "sensing", "actuation"), ("config", "capacity")
_SUMMED = ("desired_rate_hz", "rate_hz")
_LIMITS: Document = {"rmin": 1.0, "dmin": 1, "dmax": 5000}
_BOTH_MODES = "give --rmax, --sensing and --actuation (the paper), or --config with --capacity (your topics)"


def _add_options(parser: argparse.ArgumentParser) -> None:
    paper = parser.add_argument_group("the paper's program")
    topics, rate = within(0, _MOST, parse=int), within(_LEAST_HZ, _MOST, parse=float)
    depth = within(1, _MOST, parse=int)
    paper.add_argument("--rmax", type=rate, metavar="HZ", help="Rmax, the highest rate with one topic only (Hz)")
    paper.add_argument("--sensing", type=topics, metavar="N", help="topics from the robot, SPt")
    paper.add_argument("--actuation", type=topics, metavar="N", help="topics to the robot, PAAt")
    paper.add_argument("--rmin", type=rate, metavar="HZ", help="Rmin (Hz, default 1)")
    paper.add_argument("--dmin", type=depth, metavar="N", help="Dmin (samples, default 1)")
    paper.add_argument("--dmax", type=depth, metavar="N", help="Dmax (samples, default 5000)")
    own = parser.add_argument_group("your topics, offline")
    own.add_argument("--config", type=Path, metavar="FILE", help="YAML configuration whose topics are planned")
    own.add_argument("--capacity", metavar="RATE[,RATE...]", help="plan for links of these capacities, like 5mbit")
    parser.add_argument("--backend", choices=[*map(str, Backend)], help="solver (default osqp, or the configuration's)")
    add_json(parser)


def _solve(options: argparse.Namespace) -> int:
    paper, own, limits = ([getattr(options, name) for name in names] for names in (_PAPER, _OWN, _LIMITS))
    if any(value is not None for value in own) == any(value is not None for value in (*paper, *limits)):
        raise UsageError(_BOTH_MODES)
    if None in paper and None in own:
        raise UsageError(f"something is missing; {_BOTH_MODES}")
    return _solve_topics(options) if None in paper else _solve_paper(options)


def _solve_paper(options: argparse.Namespace) -> int:
    asked = Backend(options.backend or Backend.OSQP)
    rmin, dmin, dmax = (usual if (own := getattr(options, name)) is None else own for name, usual in _LIMITS.items())
    try:
        problem = Eq4Problem(
            max_rate_hz=options.rmax,
            topics=options.sensing + options.actuation,
            min_rate_hz=rmin,
            min_depth=dmin,
            max_depth=dmax,
        )
    except ValueError as error:
        raise UsageError(str(error)) from error
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
    print(json.dumps(answer, indent=2) if options.json else _of_paper(problem, answer))
    if backend is not asked:
        print(f"arpd: {asked} gave no correct answer; this one is the closed form's", file=sys.stderr)
    return 0


def _of_paper(problem: Eq4Problem, answer: Document) -> str:
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


def _solve_topics(options: argparse.Namespace) -> int:
    try:
        capacities = [*map(between(RATE, "8kbit", "100gbit"), options.capacity.split(","))]
    except ValueError as error:
        raise UsageError(f"--capacity: {error}") from None
    settings = load_settings(options.config, interfaces=None)  # the file may belong to another computer
    if options.backend:
        settings = replace(settings, program=replace(settings.program, backend=Backend(options.backend)))
    if not (traffic := assumed_traffic(settings)):
        write = (
            "write `topics: [{name: /camera, payload: 30kB, source_rate_hz: 30}]`, or let arpd topics --suggest measure"
        )
        wrong = f"no topic has a payload and a source_rate_hz; {write}"
        raise config_error(options.config, [Fault(START, "topics", wrong)])
    plans = [_plan(capacity, settings, traffic) for capacity in capacities]
    if options.json:
        print(json.dumps(plans if len(plans) > 1 else plans[0], indent=2))
    else:
        for plan in plans:
            _show(plan)
    return 0


def _plan(capacity: float, settings: Settings, traffic: Sequence[Traffic]) -> Document:
    """Return the daemon's first plan for a link of this capacity, before headroom (bytes/s)."""
    loads = {each.topic: each for each in traffic}
    crossing = (settings.graph.sensing_topics or 0) + (settings.graph.actuation_topics or 0)
    rows, memory_bytes = rows_of_traffic(traffic, settings), settings.program.memory_budget_bytes
    program = Program(settings)
    answer = program.solve(program.on_link(capacity, rows, crossing=crossing), memory_bytes)
    qos = Wanted(answer, rows, (), previous={}, settings=settings).rows
    return {
        "capacity_bytes_per_second": capacity,
        "headroom": settings.link.headroom,
        "allocation": asdict(replace(answer, topics=(), price=None)),
        "share": sum(each.share for each in answer.topics),
        "memory_bytes": sum(row.slot_bytes * qos[row.name].depth for row in rows),
        "memory_budget_bytes": memory_bytes,
        "topics": [
            asdict(loads[row.name])
            | asdict(row)
            | asdict(each)
            | {"depth": qos[row.name].depth, "deadline_ns": qos[row.name].deadline_ns or None}
            for row, each in zip(rows, answer.topics, strict=True)
        ],
    }


def _show(plan: Document) -> None:
    answer, rows = plan["allocation"], plan["topics"]
    used, budget = format_size(plan["memory_bytes"]), format_size(plan["memory_budget_bytes"])
    share, capacity = format_share(plan["headroom"]), format_rate(plan["capacity_bytes_per_second"])
    head = [
        f"link     {capacity}, of which {share} may be planned for {count(len(rows), 'topic')}",
        f"program  {answer['status']}, bound by {_words(answer['binding'])}, solved by {answer['backend']}",
        *([f"         gave way: {answer['degradation']}"] if answer["degradation"] else []),
        f"memory   {used} of {budget} when every history is full",
    ]
    total = [f"total of {len(rows)}", "", "", "", *(_four(sum(row[key] for row in rows)) for key in _SUMMED)]
    total += [f"{100 * plan['share']:.1f}", "", "", "", ""]
    cells = [[cell(row) for _, cell in _COLUMNS.values()] for row in rows]
    ranks, titles = [rank for rank, _ in _COLUMNS.values()], [*_COLUMNS]
    table = fitted([titles, *cells, total], ranks=ranks, words=titles[-2:])
    show(*map(Text, head), "", table, "")


def _words(binding: str) -> str:
    return binding.replace("_", " ")


def _four(value: float) -> str:
    return format_number(value, digits=4)


# Of a topic's row: how soon a narrow terminal loses the column, and what stands in it.
_COLUMNS: Mapping[str, tuple[int, Callable[[Document], str]]] = {
    "TOPIC": (0, itemgetter("topic")),
    "WEIGHT": (6, lambda row: format_number(row["weight"])),
    "PAYLOAD\nB": (7, lambda row: _four(row["payload_bytes"])),
    "MINIMUM\nHZ": (4, lambda row: _four(row["min_rate_hz"])),
    "DESIRED\nHZ": (5, lambda row: _four(row["desired_rate_hz"])),
    "RATE\nHZ": (0, lambda row: _four(row["rate_hz"]) if row["rate_hz"] else "paused"),
    "LINK\n%": (3, lambda row: f"{100 * row['share']:.1f}"),  # one decimal for all: points stand below each other
    "DEADLINE\nMS": (0, lambda row: _four(row["deadline_ns"] * 1e-6) if row["deadline_ns"] else "none"),
    "DEPTH": (0, lambda row: str(row["depth"])),
    "RATE\nBOUND BY": (1, lambda row: _words(row["binding"])),
    "DEPTH\nBOUND BY": (2, lambda row: _words(row["depth_binding"])),
}


SOLVE = Command(_TEXT, _add_options, _solve)
