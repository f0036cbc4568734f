"""Time a division of the link by each back end, beside the paper's way: cvxpy with its default solver.

Every side divides the same link among the same topics (G1) while the capacity wanders by a few per cent, as in the
daemon. Time is that of the CPU, in the one thread that solves. The sides take turns with the same few instances, in
rotating order. An answer is off when a share differs by more than the tolerance of the back ends.
"""

from __future__ import annotations

import random
import subprocess
import sys
import time
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from arpd.model.allocation import Topic
from arpd.model.settings import Backend, Settings
from arpd.solve import cvxpy_, osqp_
from arpd.solve.level import TOLERANCE, Column, water_level
from arpd.solve.program import Program
from scripts.bench.report import Summary, figure, table

if TYPE_CHECKING:
    from collections.abc import Callable

PAPER = "the paper's way: cvxpy with its default solver, (G1) with κ"
LEVELS: dict[str, Callable[[Column, Column, Column, float], float]] = {
    "cvxpy": cvxpy_.level,
    "osqp": osqp_.level,
    "closed form": water_level,
}
WHOLE = {f"*the whole program: (G1), (G2), rounding; {backend}*": backend for backend in Backend}
#: topics → turns; in each turn every side solves `TURN` instances
TURNS = {1: 30, 12: 40, 100: 40, 1000: 20}
QUICK = {1: 5, 12: 15}
TURN, HEADROOM, MEMORY_BYTES = 5, 0.85, 2.0**26
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
topics = [Topic(name=f"/t{i}", wire_bytes=1000.0 + i, **topic) for i in range(12)]
program.solve(program.on_link(1e5, topics), 2.0**26)
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(imported_s, int(status["VmHWM"].split()[0]) * 1024)
"""


def topics_like_a_robots(count: int, rng: random.Random) -> list[Topic]:
    """Return small fast topics and large slow ones, a few with more weight."""
    return [
        Topic(
            name=f"/t{i}",
            wire_bytes=round(10 ** rng.uniform(2.4, 4.6), 1),
            packets=1,
            desired_rate_hz=round(10 ** rng.uniform(0.0, 2.0), 2),  # at least the floor
            min_rate_hz=rng.choice([0.0, 0.5, 1.0]),
            weight=rng.choice([1.0, 1.0, 1.0, 2.0, 4.0, 10.0]),
            latency_budget_s=1.0,
        )
        for i in range(count)
    ]


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
    """Time all sides and the whole program on the same instances, in turns."""
    rng = random.Random(count)
    topics = topics_like_a_robots(count, rng)
    cost, weights, floor, wish = (
        np.array([getattr(topic, name) for topic in topics])
        for name in ("wire_bytes", "weight", "min_rate_hz", "desired_rate_hz")
    )
    programs = {name: Program(Settings(), backend=backend) for name, backend in WHOLE.items()}
    seconds: dict[str, list[float]] = {name: [] for name in (PAPER, *LEVELS, *programs)}
    off = dict.fromkeys(seconds, 0)
    order, part = list(seconds), 0.6
    for turn in range(turns + 1):
        capacities = []
        for _ in range(TURN):  # about half of the demand, so that some topics get less than they want
            part = min(0.9, max(0.3, part * rng.uniform(0.95, 1.05)))
            capacities.append(part * float(cost @ wish))
        order = order[1:] + order[:1]
        for name in order:
            for capacity in capacities:
                low = cost * np.minimum(floor, wish) / capacity
                problem = weights, low, np.maximum(low, np.minimum(1.0, cost * wish / capacity)), HEADROOM
                started = time.thread_time()
                if name in programs:
                    programs[name].solve(programs[name].on_link(capacity, topics), MEMORY_BYTES)
                else:
                    shares = shares_of(name, *problem)
                elapsed_s = time.thread_time() - started
                if turn:  # the first turn imports libraries
                    seconds[name].append(elapsed_s)
                    if name not in programs:
                        off[name] += not np.abs(shares - shares_of("closed form", *problem)).max() <= TOLERANCE
    times = {name: f"{median(each) * 1e3:.3g}, {np.quantile(each, 0.99) * 1e3:.3g}" for name, each in seconds.items()}
    return {"topics": count, "times": times, "off": off, "answers": turns * TURN}


def footprint(backend: Backend) -> tuple[float, float]:
    """Return import time (s) and peak memory (MiB) of a fresh process that solves one program without ROS."""
    command = [sys.executable, "-c", FOOTPRINT, backend]
    runs = [subprocess.run(command, capture_output=True, text=True, check=True).stdout.split() for _ in range(3)]
    return median(float(run[0]) for run in runs), median(int(run[1]) for run in runs) / 2**20


def play(*, is_quick: bool, rounds: int = 1) -> Summary:
    races = [race(count, turns * rounds) for count, turns in (QUICK if is_quick else TURNS).items()]
    footprints = [(str(backend), *footprint(backend)) for backend in Backend]
    answers = sum(each["answers"] for each in races)
    off = {name: sum(each["off"][name] for each in races) for name in (PAPER, *LEVELS)}
    return Summary(
        about="CPU time (ms) of a division among N topics, median and 99th percentile.",
        figures=[
            figure(f"{name}: answers that are off", many, f"of {answers:,}", most=None if name == PAPER else 0)
            for name, many in off.items()
        ],
        tables=[
            table(
                "",
                list(races[0]["times"]),
                ("way", str),
                *((f"N = {each['topics']:,}", each["times"].__getitem__) for each in races),
            ),
            table(
                "",
                footprints,
                ("a process that solves, without ROS", lambda row: row[0]),
                ("imports in s", lambda row: row[1]),
                ("MiB", lambda row: round(row[2])),
            ),
        ],
    )
