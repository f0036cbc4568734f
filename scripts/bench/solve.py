"""Time a re-solve: the paper's way, cvxpy with parameters, OSQP called directly, and the exact solver.

Usage: .venv/bin/python scripts/bench/solve.py [--quick] [--json FILE] [--plot FILE]

Every side divides the same link among the same topics (G1) while the capacity wanders by a few per cent, as in the
daemon. The sides take turns with the same few instances, in rotating order, so that other load on the machine slows all
of them. Only ratios within one run mean anything.
"""

from __future__ import annotations

import random
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from arpd.model.allocation import Topic
from arpd.model.settings import Backend, ProgramSettings
from arpd.solve.checked import load
from arpd.solve.exact import water_fill
from arpd.solve.problem import ShareProblem, Solved, disagreement
from arpd.solve.program import Program
from scripts.bench.picture import picture
from scripts.bench.record import conditions, keep, options_of
from scripts.bench.report import about, mib, paragraphs, table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

PAPER, DPP, OSQP, EXACT = SIDES = "cvxpy, built anew", "cvxpy, parameters", "OSQP, direct", "exact"
WAYS = {
    PAPER: "the paper's way: cvxpy, built for each solve, its default solver",
    DPP: "cvxpy, parametrised (DPP)",
    OSQP: "OSQP, direct",
    EXACT: "exact, whole numbers",
    "whole program, osqp": "*the whole program: (G1), (G2), rounding; osqp*",
    "whole program, exact": "*the whole program: (G1), (G2), rounding; exact*",
}
#: topics → turns; in each turn every side solves `TURN` instances
TURNS = {1: 30, 12: 40, 100: 20, 1000: 10, 10_000: 7}
QUICK = {1: 5, 12: 15}
TURN = {10_000: 1}
TURN_OTHERWISE = 5
HEADROOM = 0.85
#: Runs in a process of its own, for the memory of a back end without ROS.
FOOTPRINT = """
import sys, time
started = time.perf_counter()
from arpd.model.allocation import Topic
from arpd.solve.program import Program
from arpd.model.settings import Backend, ProgramSettings
program = Program(settings=ProgramSettings(backend=Backend(sys.argv[1])), headroom=0.85)
imported_s = time.perf_counter() - started
topic = dict(packets=1, desired_rate_hz=20.0, min_rate_hz=1.0)
program.solve(1e5, [Topic(name=f"/t{i}", wire_bytes=1000.0 + i, **topic) for i in range(12)], 2.0**26)
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(imported_s, int(status["VmHWM"].split()[0]) * 1024, "cvxpy" in sys.modules)
"""


def topics_like_a_robots(count: int, rng: random.Random) -> list[Topic]:
    """Return small fast topics and large slow ones, a few with more weight."""
    return [
        Topic(
            name=f"/t{i}",
            wire_bytes=round(10 ** rng.uniform(2.4, 4.6), 1),
            packets=1,
            desired_rate_hz=round(10 ** rng.uniform(0.0, 2.0), 2),
            min_rate_hz=rng.choice([0.0, 0.5, 1.0]),
            weight=rng.choice([1.0, 1.0, 1.0, 2.0, 4.0, 10.0]),
            latency_budget_s=1.0,
        )
        for i in range(count)
    ]


def wandering(topics: Sequence[Topic], rng: random.Random, length: int) -> list[float]:
    """Return capacities (bytes/s) of about half of the demand, so that some topics get less than they want."""
    demand = sum(topic.wire_bytes * topic.desired_rate_hz for topic in topics)
    part, parts = 0.6, []
    for _ in range(length):
        part = min(0.9, max(0.3, part * rng.uniform(0.95, 1.05)))
        parts.append(part)
    return [round(demand * part, 1) for part in parts]


def division_of_the_link(topics: Sequence[Topic], capacity: float) -> ShareProblem:
    """Return (G1) as `Program` states it, in tenths of a byte, hundredths of a hertz and of the budget."""
    cost = [round(topic.wire_bytes * 10) for topic in topics]
    whole = round(capacity * 10) * 100
    return ShareProblem(
        weights=tuple(round(topic.weight) for topic in topics),
        lo=tuple(a * round(topic.min_rate_hz * 100) for a, topic in zip(cost, topics, strict=True)),
        hi=tuple(min(whole, a * round(topic.desired_rate_hz * 100)) for a, topic in zip(cost, topics, strict=True)),
        budget=round(HEADROOM * whole),
        whole=whole,
    )


def papers_way(problem: ShareProblem) -> tuple[float, ...]:
    """Solve the textbook form of the program with cvxpy's default solver, without a check of the answer."""
    import cvxpy as cp
    import numpy as np

    weights = np.array(problem.weights, dtype=float)
    lo, hi = (np.array([bound / problem.whole for bound in bounds]) for bounds in (problem.lo, problem.hi))
    share = cp.Variable(len(weights))
    objective = cp.sum(cp.multiply(1 / (2 * weights), cp.square(share))) - float(max(hi / weights)) * cp.sum(share)
    cp.Problem(
        cp.Minimize(objective), [cp.sum(share) <= problem.budget / problem.whole, share >= lo, share <= hi]
    ).solve()
    return tuple(float(value) for value in share.value)


def sides() -> dict[str, Callable[[ShareProblem], tuple[float, ...] | None]]:
    """Return the competitors; one returns None if it fails, where arpd would use `exact`."""

    def ours(backend: Backend) -> Callable[[ShareProblem], tuple[float, ...] | None]:
        solver = load(backend)

        def solve(problem: ShareProblem) -> tuple[float, ...] | None:
            outcome = solver.solve(problem)
            return outcome.values if isinstance(outcome, Solved) else None

        return solve

    return {PAPER: papers_way, DPP: ours(Backend.CVXPY), OSQP: ours(Backend.OSQP), EXACT: ours(Backend.EXACT)}


def race(count: int, turns: int) -> dict[str, Any]:
    """Time all sides and the whole program ((G1), (G2), rounding) on the same instances, in turns."""
    rng = random.Random(count)
    topics = topics_like_a_robots(count, rng)
    competitors = sides()
    programs = {
        f"whole program, {backend}": Program(settings=ProgramSettings(backend=backend), headroom=HEADROOM)
        for backend in (Backend.OSQP, Backend.EXACT)
    }
    seconds: dict[str, list[float]] = {name: [] for name in (*competitors, *programs)}
    wrong = dict.fromkeys(seconds, 0)
    order = list(seconds)
    length = TURN.get(count, TURN_OTHERWISE)
    for turn in range(turns + 1):
        capacities = wandering(topics, rng, length)
        problems = [division_of_the_link(topics, capacity) for capacity in capacities]
        truths = [water_fill(problem).shares() for problem in problems]
        order = order[1:] + order[:1]
        for name in order:
            for capacity, problem, truth in zip(capacities, problems, truths, strict=True):
                started = time.perf_counter()
                if name in programs:
                    programs[name].solve(capacity, topics, 2.0**26)
                else:
                    answer = competitors[name](problem)
                elapsed_s = time.perf_counter() - started
                if turn:  # the first turn imports libraries
                    seconds[name].append(elapsed_s)
                    wrong[name] += name in competitors and (answer is None or disagreement(answer, truth))
    return {
        "topics": count,
        "instances": turns * length,
        "median_s": {name: median(times) for name, times in seconds.items()},
        "p90_s": {name: sorted(times)[int(0.9 * len(times))] for name, times in seconds.items()},
        "failed_or_wrong": wrong,
    }


def footprint(backend: Backend) -> dict[str, Any]:
    """Return import time and peak memory of a fresh process that solves one program without ROS."""
    command = [sys.executable, "-c", FOOTPRINT, backend]
    fields = [subprocess.run(command, capture_output=True, text=True, check=True).stdout.split() for _ in range(3)]
    return {
        "import_s": median(float(field[0]) for field in fields),
        "peak_rss_bytes": median(int(field[1]) for field in fields),
        "loads_cvxpy": fields[0][2] == "True",
    }


def report(document: dict[str, Any]) -> str:
    return paragraphs(
        about(document, "Median ms of a re-solve of N topics; ×: times as fast as the paper's way"),
        table(
            WAYS,
            ("", WAYS.__getitem__),
            *((f"N = {race['topics']:,}", partial(_time, race)) for race in document["races"]),
        ),
        table(
            document["footprints"].items(),
            ("a process that solves, without ROS", 0),
            ("MiB", lambda found: found[1]["peak_rss_bytes"], mib),
            ("imports in s", lambda found: found[1]["import_s"], "{:.2f}"),
            ("imports cvxpy", lambda found: "yes" if found[1]["loads_cvxpy"] else "no"),
        ),
    )


def _time(race: dict[str, Any], way: str) -> str:
    spent_ms = race["median_s"][way] * 1e3
    text = f"{spent_ms:.0f}" if spent_ms >= 100.0 else f"{spent_ms:.3g}"
    if way in SIDES[1:]:  # these solve the same problem as the paper's way
        times = race["median_s"][PAPER] / race["median_s"][way]
        text += f" ({times:.0f}×)" if times >= 1.0 else " (slower)"
    if wrong := race["failed_or_wrong"][way]:
        text += f", {wrong} of {race['instances']} off"
    return text


def draw(races: Sequence[dict[str, Any]], path: Path) -> None:
    counts = [race["topics"] for race in races]
    ends: list[float] = []
    with picture(path, dpi=120, figsize=(8, 5)) as (_, axes):
        for name in sorted(races[0]["median_s"], key=lambda name: races[-1]["median_s"][name]):
            spent_ms = [race["median_s"][name] * 1e3 for race in races]
            style = "--" if name.startswith("whole") else "-"
            (line,) = axes.loglog(counts, spent_ms, style, marker="o", markersize=4)
            ends.append(max(spent_ms[-1], 1.6 * ends[-1] if ends else 0.0))  # so that labels do not overlap
            axes.text(counts[-1] * 1.3, ends[-1], name, va="center", color=line.get_color())
        axes.set_xlim(right=counts[-1] * 30)
        axes.set(xlabel="topics", ylabel="median re-solve (ms)")
        axes.set_title("Dividing the link again after the capacity moved")
        axes.grid(visible=True, which="major", alpha=0.3)


def main() -> None:
    options = options_of(__doc__, "solve", quick="1 and 12 topics only", has_plot=True).parse_args()
    sizes = QUICK if options.quick else TURNS
    noted = conditions()
    races, footprints = [], {}
    with progress("timing", total=len(sizes) + len(Backend)) as shown:
        for count, turns in sizes.items():
            shown.step(f"{count} topics")
            races.append(race(count, turns))
        for backend in Backend:
            shown.step(f"footprint of {backend}")
            footprints[str(backend)] = footprint(backend)
    document = {"conditions": noted, "races": races, "footprints": footprints}
    keep(document, options, "solve", is_partial=options.quick, draw=partial(draw, races))
    print(report(document))


if __name__ == "__main__":
    main()
