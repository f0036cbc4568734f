"""Compare arpd with everything a user would do instead: the demo robot over links that change.

Latency and age are over all twelve topics, each with the same weight; a sample that neither arrived until four seconds
after the end nor was withheld never arrives. The bound is an arpd that is told the mean of the link's next 0.2 s at
every tick; price, pacing and governor are the same.
"""

from __future__ import annotations

import random
import sys
from dataclasses import replace
from statistics import fmean, median
from typing import Any

import numpy as np

from arpd.model.wire import wire_size
from arpd.sim.demo import demo_settings
from arpd.solve.eq4 import Eq4Problem, rate_of
from arpd.solve.program import Program
from arpd.solve.topics import assumed_traffic, rows_of_traffic
from scripts.bench.child import ChildError
from scripts.bench.harness import errors, queues_s, settled_s
from scripts.bench.links import CALM_S, DURATION_S, MBIT, SEED, Course, at, links
from scripts.bench.report import Summary, Table, figure, spread, table
from scripts.bench.robots import demo_robot
from scripts.bench.sides import PREFIX, SIDES, Robot
from scripts.bench.world import world_of

ROUNDS = 3
_COLUMNS = {
    "latency p50 ms": "p50_ms",
    "p99 ms": "p99_ms",
    "age p50 s": "age_p50_s",
    "age p99 s": "age_p99_s",
    "Mbit/s": "goodput_mbit",
    "lost %": "lost_percent",
    "withheld %": "withheld_percent",
    "queue peak ms": "queue_peak_ms",
}
#: Sides by name: how the samples cross, and what it is in words.
WAYS = {
    "defaults": ("plain", "rclpy's defaults, KEEP_LAST 10"),
    "keep-last-1": ("plain", "KEEP_LAST 1"),
    "keep-last-5000": ("plain", "KEEP_LAST 5000"),
    "paper": ("plain", "the paper's optimum, computed once for the rate at the start"),
    "throttle": ("plain", "every topic throttled by hand, by what `arpd solve` gives for the link's mean rate"),
    "arpd": ("two_ends", "arpd, with its relay's two ends"),
    "bound": ("bound", "arpd, told the mean of the link's next 0.2 s at every tick"),
}


def robot_for(way: str, course: Course, robot: Robot) -> Robot:
    """Return the robot as a user without arpd would set it up for a link."""
    if way.startswith("keep-last-"):
        return robot.changed(depth=int(way.removeprefix("keep-last-")))
    traffic = assumed_traffic(demo_settings())
    if way == "paper":  # Rmax of a message of the mean size: N topics at Rmax/N fill the link exactly
        mean_bytes = fmean(wire_size(topic.payload_bytes, rate_hz=1.0)[0] for topic in traffic)
        problem = Eq4Problem(max_rate_hz=course[0][1] / mean_bytes, topics=len(traffic))
        deadline_ns, depth = problem.applied(problem.vertex()[0])
        rate_hz = rate_of(deadline_ns)
        slowed = robot.changed(depth=depth, deadline_hz=rate_hz)
        return replace(
            slowed, topics=tuple(replace(each, rate_hz=min(each.rate_hz, rate_hz)) for each in slowed.topics)
        )
    if way == "throttle":
        times = np.arange(0.0, DURATION_S, 0.1)
        settings, mean = demo_settings(), fmean(at(course, float(now_s))[0] for now_s in times)
        rows, memory_bytes = rows_of_traffic(traffic, settings), settings.program.memory_budget_bytes
        program = Program(settings)
        answer = program.solve(program.on_link(mean, rows), memory_bytes)
        rates = {each.name.removeprefix(PREFIX): each.rate_hz for each in answer.topics}
        return replace(
            robot, topics=tuple(replace(each, rate_hz=min(each.rate_hz, rates[each.name])) for each in robot.topics)
        )
    return robot


def measured(link: str, course: Course, way: str, seconds: float) -> dict[str, Any]:
    """Return the figures of one side on one link."""
    robot = demo_robot()
    slowed = robot_for(way, course, robot)
    with world_of(slowed, SIDES[WAYS[way][0]], rate=course[0][1]) as world:
        account, spent = world.play(course, seconds, looks=True)
    looks = world.looks
    queues = queues_s(looks)
    found = {
        "link": link,
        "way": way,
        **account.pooled(),
        "queue_peak_ms": 1e3 * max(queues, default=0.0),
        "error_percent": None if (error := errors(looks)) is None else 100.0 * error,
        "cpu_percent": {name: 100.0 * cpu_s / seconds for name, cpu_s in spent["cpu_s"].items()},
        "faults": account.faults(),
    }
    change_s, (rate, _) = course[1][0] if len(course) > 1 else 0.0, at(course, CALM_S)
    after = [(look["at_s"] - change_s, look) for look in looks if look["at_s"] >= change_s and "estimate" in look]
    if link == "step-down":
        found["budget_s"] = settled_s((at_s, look["budget"] <= 1.1 * rate) for at_s, look in after)
    if link == "step-up":
        found["budget_s"] = settled_s((at_s, look["estimate"] >= 0.8 * rate) for at_s, look in after)
    return found


def play(*, is_quick: bool) -> Summary:
    """Play every side on every link, in random order in each round."""
    every = links()
    if is_quick:
        every = {"step-down": ("20 → 5 Mbit/s", [(0.0, 20 * MBIT, 0.0), (2.0, 5 * MBIT, 0.0)])}
    ways = ["defaults", "arpd"] if is_quick else list(WAYS)
    rng, runs = random.Random(SEED), []
    for number in range(1 if is_quick else ROUNDS):
        cells = [
            (link, way) for link in every for way in ways if not link.startswith("steady") or way in {"arpd", "bound"}
        ]
        for link, way in rng.sample(cells, len(cells)):
            try:
                runs.append(measured(link, every[link][1], way, 6.0 if is_quick else DURATION_S))
            except ChildError as error:
                print(f"{link}, {way}, round {number + 1}: {error}", file=sys.stderr)
    return summary(runs, every, ways)


def summary(runs: list[dict[str, Any]], every: dict[str, tuple[str, Course]], ways: list[str]) -> Summary:
    """Return medians over the rounds: arpd beside the bound, and every side on every link."""

    def of(link: str, way: str, key: str) -> list[float | None]:
        return [run[key] for run in runs if (run["link"], run["way"]) == (link, way) and key in run]

    def middle(link: str, way: str, key: str) -> float | None:
        known = of(link, way, key)
        return None if not known or None in known else float(median(value for value in known if value is not None))

    def p99s(link: str, way: str) -> str:
        latency, age = middle(link, way, "p99_ms"), middle(link, way, "age_p99_s")
        text = f"{_duration(latency and latency / 1e3)} / {_duration(age)}" if of(link, way, "p99_ms") else ""
        return f"**{text}**" if way == "arpd" and text else text

    figures = []
    for link in every:
        for what, key, unit, most, least in (
            ("p99 latency", "p99_ms", "ms", 1.5, None),
            ("p99 age", "age_p99_s", "s", 2.0, None),
            ("goodput", "goodput_mbit", "Mbit/s", None, 0.92),
            ("longest queue", "queue_peak_ms", "ms", None, None),
            ("error of the estimate, median", "error_percent", "%", None, None),
            ("until the budget follows", "budget_s", "s", None, None),
            ("commands later than 100 ms, or lost", "late_commands_percent", "%", None, None),
        ):
            if of(link, "arpd", key):
                bound = middle(link, "bound", key)
                limits = {"most": most and bound and most * bound, "least": least and bound and least * bound}
                if key == "late_commands_percent":
                    limits["most"] = 1.0
                figures.append(figure(f"{link}: {what}", middle(link, "arpd", key), unit, bound=bound, **limits))
    rows = [
        {"link": link, "side": way, **{head: spread(of(link, way, key)) for head, key in _COLUMNS.items()}}
        for link in every
        for way in ways
        if of(link, way, "p99_ms")
    ]

    def crossed(title: str, value: Any) -> Table:
        full = [link for link in every if not link.startswith("steady")]  # arpd and the bound alone play the others
        return table(title, [{"link": link, **{way: value(link, way) for way in ways}} for link in full])

    return Summary(
        about="Medians of all rounds over all twelve topics, each with the same weight; a lost sample never arrives, "
        "so with more than 1 % lost the p99 is never.",
        figures=figures,
        tables=[
            crossed("p99 latency / p99 age", p99s),
            table("", [{"side": way, "what": WAYS[way][1]} for way in ways]),
            table("", [{"link": link, "course": what} for link, (what, _) in every.items()]),
            table("All figures, the worst round in brackets", rows),
        ],
    )


def _duration(value_s: float | None) -> str:
    if value_s is None:
        return "never"
    return f"{value_s * 1e3:.0f} ms" if value_s < 1.0 else f"{value_s:.1f} s"
