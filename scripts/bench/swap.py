"""Measure a change of QoS: samples lost, doubled and reordered, the longest gap, and CPU.

Three ways on each combination: an AdaptivePublisher whose settings stay, one whose DEPTH changes by one again and
again, and a plain publisher that is destroyed and created again. All have arpd's Fast DDS profile, whose heartbeat of
50 ms helps destroy+create too. Then twelve topics are swapped for minutes.
"""

from __future__ import annotations

import sys
from typing import Any

from scripts.bench.child import ChildError
from scripts.bench.links import MBIT
from scripts.bench.report import Summary, figure, table
from scripts.bench.samples import Topic
from scripts.bench.sides import Robot, Side, Way
from scripts.bench.world import world_of

STILL, ADAPTIVE, RECREATE = "no swaps", "adaptive", "destroy+create"
EVENTS = ("lost", "doubled", "reordered")
_EVERY_S, _SWAPS = 4.0, 6  # a swap settles for three seconds
_RATE = 100 * MBIT
SOAK_TOPICS, SOAK_S = 12, 180.0
SIDES = {
    STILL: Side(name="still", way=Way(is_adaptive=True), has_profile=True),
    ADAPTIVE: Side(name="retune", way=Way(is_adaptive=True, swap="retune", swap_every_s=_EVERY_S), has_profile=True),
    RECREATE: Side(name="recreate", way=Way(swap="recreate", swap_every_s=_EVERY_S), has_profile=True),
}
Cell = tuple[float, float, int, int]  # loss of the link (0..1), rate (Hz), DEPTH, bytes of a sample
CELLS: tuple[Cell, ...] = (
    *((0.0, rate_hz, depth, 100) for rate_hz, depth in ((10, 10), (100, 10), (1000, 10), (1000, 5000))),
    (0.0, 100, 10, 30_000),
    *((0.02, rate_hz, depth, 100) for rate_hz, depth in ((10, 10), (100, 10), (1000, 100))),
    (0.02, 10, 10, 30_000),
    *((0.1, rate_hz, depth, 100) for rate_hz, depth in ((10, 10), (100, 100), (1000, 5000))),
)
QUICK: tuple[Cell, ...] = ((0.0, 100, 10, 100),)


def measured(cell: Cell, way: str, *, topics: int = 1, seconds: float) -> dict[str, Any]:
    """Return the figures of one way."""
    loss, rate_hz, depth, size = cell
    about: dict[str, Any] = {"rate_hz": rate_hz, "size": size, "depth": depth}
    robot = Robot(topics=tuple(Topic(name=f"/swapped_{k}", node="writer", **about) for k in range(topics)))
    with world_of(robot, SIDES[way], rate=_RATE, queue_bytes=1_000_000) as world:
        account, spent = world.play([(0.0, _RATE, loss)], seconds)
    rows = account.topics.values()
    grown = {name: spent["max_rss_bytes"][name] - spent["first_rss_bytes"][name] for name in ("writer", "base_sink")}
    return {
        "loss %": 100.0 * loss,
        "Hz": rate_hz,
        "DEPTH": depth,
        "bytes": size,
        "way": way,
        "swaps": account.swaps,
        "seen": sum(account.writers.values()) - topics,
        "sent": sum(row["published"] for row in rows),
        "lost": sum(row["published"] - row["delivered"] for row in rows),
        "doubled": sum(row["doubled"] for row in rows),
        "reordered": sum(row["out_of_order"] for row in rows),
        "longest gap ms": max(1e3 * row["gap_s"] for row in rows),
        "CPU of the writer %": 100.0 * spent["cpu_s"]["writer"] / seconds,
        "MiB more": max(grown.values()) / 2**20,
    }


def play(*, is_quick: bool) -> Summary:
    """Play every way on every combination, then swap twelve topics for minutes."""
    runs = []
    seconds = _EVERY_S * (2.5 if is_quick else _SWAPS + 0.5)
    for number, cell in enumerate(QUICK if is_quick else CELLS):
        ways = list(SIDES)
        for way in ways[number % 3 :] + ways[: number % 3]:
            try:
                runs.append(measured(cell, way, seconds=seconds))
            except ChildError as error:
                print(f"{cell}, {way}: {error}", file=sys.stderr)

    def total(way: str, key: str, *, is_lossy: bool) -> int:
        return sum(run[key] for run in runs if run["way"] == way and (run["loss %"] > 0) == is_lossy)

    figures = [
        figure(
            f"link that loses {'2 or 10 %' if lossy else 'nothing'}, {key}",
            total(ADAPTIVE, key, is_lossy=lossy),
            bound=total(STILL, key, is_lossy=lossy),
            most=0,
        )
        for lossy in sorted({run["loss %"] > 0 for run in runs})
        for key in EVENTS
    ]
    soaked = measured((0.0, 20.0, 10, 100), ADAPTIVE, topics=SOAK_TOPICS, seconds=10.0 if is_quick else SOAK_S)
    what = f"on {SOAK_TOPICS} topics, {soaked['swaps']:,} swaps"
    figures += [figure(f"{what}: {key}", soaked[key], most=0) for key in EVENTS]
    figures.append(figure(f"{what}: growth of writer or reader", soaked["MiB more"], "MiB", most=2.0))
    return Summary(
        about="A writer and a reader on two hosts. The bound is an AdaptivePublisher whose settings stay; seen: "
        "writers that the reader met beyond the first.",
        figures=figures,
        tables=[table("", runs)],
    )
