"""Measure a change of QoS: samples lost, doubled and reordered, the longest gap, and CPU.

Three ways on each link: AdaptivePublishers whose settings stay, some whose DEPTH changes by one again and again, and
plain publishers that are destroyed and created again. All have arpd's Fast DDS profile, whose heartbeat of 50 ms helps
destroy+create too. Then twelve topics are swapped for a minute.
"""

from __future__ import annotations

from typing import Any

from scripts.bench.child import ChildError
from scripts.bench.links import MBIT
from scripts.bench.report import Summary, figure, table
from scripts.bench.samples import Topic
from scripts.bench.sides import Robot, Side, Way
from scripts.bench.world import world_of

STILL, ADAPTIVE, RECREATE = "no swaps", "adaptive", "destroy+create"
EVENTS = ("lost", "doubled", "reordered")
_EVERY_S, _SWAPS = 4.0, 3  # a swap settles for three seconds
_RATE = 100 * MBIT
SOAK_TOPICS, SOAK_S = 12, 60.0
SIDES = {
    STILL: Side(name="still", way=Way(is_adaptive=True), has_profile=True),
    ADAPTIVE: Side(name="retune", way=Way(is_adaptive=True, swap="retune", swap_every_s=_EVERY_S), has_profile=True),
    RECREATE: Side(name="recreate", way=Way(swap="recreate", swap_every_s=_EVERY_S), has_profile=True),
}
#: By loss of the link (0..1): rate (Hz), DEPTH and bytes of each topic; each has a process of its own.
LINKS: dict[float, tuple[tuple[float, int, int], ...]] = {
    0.0: ((10, 10, 100), (100, 10, 100), (1000, 5000, 100), (100, 10, 30_000)),
    0.02: ((10, 10, 100), (100, 10, 100), (1000, 100, 100), (10, 10, 30_000)),
    0.1: ((10, 10, 100), (100, 100, 100), (1000, 5000, 100)),
}
QUICK = {0.0: ((100, 10, 100),)}


def measured(way: str, loss: float, topics: tuple[Topic, ...], seconds: float) -> list[dict[str, Any]]:
    """Return the figures of one way, by topic."""
    with world_of(Robot(topics=topics), SIDES[way], rate=_RATE, queue_bytes=1_000_000) as world:
        account, spent = world.play([(0.0, _RATE, loss)], seconds)
    grown = {name: spent["max_rss_bytes"][name] - spent["first_rss_bytes"][name] for name in world.children}
    rows = []
    for topic in topics:
        row = account.topics[topic.name]
        found = {"loss %": 100.0 * loss, "Hz": topic.rate_hz, "DEPTH": topic.depth, "bytes": topic.size, "way": way}
        counted = {
            "swaps": account.swaps // len(topics),
            "seen": account.writers[topic.name] - 1,
            "sent": row["published"],
            "lost": row["published"] - row["delivered"],
            "doubled": row["doubled"],
            "reordered": row["out_of_order"],
        }
        costs = {
            "CPU of the writer %": 100.0 * spent["cpu_s"][topic.node] / seconds,
            "MiB more": max(grown.values()) / 2**20,
        }
        rows.append({**found, **counted, "longest gap ms": 1e3 * row["gap_s"], **costs})
    return rows


def play(*, is_quick: bool, rounds: int = 1) -> Summary:
    """Play every way on every link, then swap twelve topics."""
    runs, failed = list[dict[str, Any]](), list[list[str]]()
    seconds = _EVERY_S * (2.5 if is_quick else _SWAPS * rounds + 0.5)
    for number, (loss, settings) in enumerate((QUICK if is_quick else LINKS).items()):
        topics = tuple(
            Topic(name=f"/swapped_{k}", node=f"writer{k}", rate_hz=rate_hz, depth=depth, size=size)
            for k, (rate_hz, depth, size) in enumerate(settings)
        )
        ways = list(SIDES)
        for way in ways[number % 3 :] + ways[: number % 3]:
            try:
                runs += measured(way, loss, topics, seconds)
            except ChildError as error:
                failed.append([f"{100 * loss:g} % loss", way, str(error)])

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
    many = tuple(Topic(name=f"/swapped_{k}", node="writer", rate_hz=20.0, size=100) for k in range(SOAK_TOPICS))
    soaked = measured(ADAPTIVE, 0.0, many, 10.0 if is_quick else SOAK_S * rounds)
    what = f"on {SOAK_TOPICS} topics, {sum(row['swaps'] for row in soaked):,} swaps"
    figures += [figure(f"{what}: {key}", sum(row[key] for row in soaked), most=0) for key in EVENTS]
    figures.append(figure(f"{what}: growth of writer or reader", soaked[0]["MiB more"], "MiB", most=2.0))
    return Summary(
        about="Writers on one host, a reader on the other. The bound is an AdaptivePublisher whose settings stay; "
        "seen: writers that the reader met beyond the first.",
        figures=figures,
        failed=failed,
        tables=[table("", [{key: value for key, value in run.items() if key != "MiB more"} for run in runs])],
    )
