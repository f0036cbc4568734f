"""Time a division of the link by each back end, beside the paper's way: cvxpy with its default solver.

Usage: .venv/bin/python scripts/bench/solve.py [--quick] [--json FILE]

Every side divides the same link among the same topics (G1) while the capacity wanders by a few per cent, as in the
daemon. Time is that of the CPU, in the one thread that solves. The sides take turns with the same few instances, in
rotating order, so that other load on the machine slows all of them.
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

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from arpd.model.allocation import Topic
from arpd.model.settings import Backend, Settings
from arpd.solve import cvxpy_, osqp_
from arpd.solve.level import TOLERANCE, water_level
from arpd.solve.program import Program
from scripts.bench.record import conditions, keep, options_of
from scripts.bench.report import about, mib, paragraphs, table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from arpd.solve.level import Column

PAPER = "the paper's way: cvxpy with its default solver, (G1) with κ"
LEVELS: dict[str, Callable[[Column, Column, Column, float], float]] = {
    "cvxpy": cvxpy_.level,
    "osqp": osqp_.level,
    "closed form": water_level,
}
WHOLE = {backend: f"*the whole program: (G1), (G2), rounding; {backend}*" for backend in Backend}
#: topics → turns; in each turn every side solves `TURN` instances
TURNS = {1: 30, 12: 40, 100: 40, 1000: 20}
QUICK = {1: 5, 12: 15}
TURN = 5
HEADROOM = 0.85
#: Runs in a process of its own, for the memory of a back end without ROS.
FOOTPRINT = """
import sys, time
started = time.perf_counter()
from arpd.model.allocation import Topic
from arpd.solve.program import Program
from arpd.model.settings import Backend, Settings
program = Program(Settings(), backend=Backend(sys.argv[1]))
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
    return [demand * part for part in parts]


def papers_way(weights: Column, low: Column, high: Column, budget: float) -> Column:
    """Return the shares of the textbook form of the program, by cvxpy's default solver."""
    import cvxpy as cp

    share = cp.Variable(len(weights))
    objective = cp.sum(cp.multiply(1 / (2 * weights), cp.square(share))) - float(max(high / weights)) * cp.sum(share)
    cp.Problem(cp.Minimize(objective), [cp.sum(share) <= budget, share >= low, share <= high]).solve()
    shares: Column = share.value
    return shares


def shares_of(name: str, weights: Column, low: Column, high: Column, budget: float) -> Column:
    """Return the shares that one side finds."""
    if name == PAPER:
        return papers_way(weights, low, high, budget)
    return np.clip(LEVELS[name](weights, low, high, budget) * weights, low, high)


def race(count: int, turns: int) -> dict[str, Any]:
    """Time all sides and the whole program ((G1), (G2), rounding) on the same instances, in turns."""
    rng = random.Random(count)
    topics = topics_like_a_robots(count, rng)
    cost, weights, floor, wish = (
        np.array([getattr(topic, name) for topic in topics])
        for name in ("wire_bytes", "weight", "min_rate_hz", "desired_rate_hz")
    )
    programs = {WHOLE[backend]: Program(Settings(), backend=backend) for backend in Backend}
    seconds: dict[str, list[float]] = {name: [] for name in (PAPER, *LEVELS, *programs)}
    off = dict.fromkeys(seconds, 0)
    order = list(seconds)
    for turn in range(turns + 1):
        capacities = wandering(topics, rng, TURN)
        order = order[1:] + order[:1]
        for name in order:
            for capacity in capacities:
                low = cost * np.minimum(floor, wish) / capacity
                problem = weights, low, np.maximum(low, np.minimum(1.0, cost * wish / capacity)), HEADROOM
                started = time.thread_time()
                if name in programs:
                    programs[name].solve(capacity, topics, 2.0**26)
                else:
                    shares = shares_of(name, *problem)
                elapsed_s = time.thread_time() - started
                if turn:  # the first turn imports libraries
                    seconds[name].append(elapsed_s)
                    if name not in programs:
                        truth = shares_of("closed form", *problem)
                        off[name] += not np.abs(shares - truth).max() <= TOLERANCE
    return {
        "topics": count,
        "instances": turns * TURN,
        "median_s": {name: median(times) for name, times in seconds.items()},
        "p99_s": {name: float(np.quantile(times, 0.99)) for name, times in seconds.items()},
        "failed_or_wrong": off,
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
        about(document, "CPU time (ms) of a division among N topics, median and 99th percentile"),
        table(
            document["races"][0]["median_s"],
            ("", lambda way: way),
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
    text = f"{race['median_s'][way] * 1e3:.3g}, {race['p99_s'][way] * 1e3:.3g}"
    wrong = race["failed_or_wrong"][way]
    return f"{text}; {wrong} of {race['instances']} off" if wrong else text


def main() -> None:
    options = options_of(__doc__, "solve", quick="1 and 12 topics only").parse_args()
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
    keep(document, options, "solve", is_partial=options.quick)
    print(report(document))


if __name__ == "__main__":
    main()
