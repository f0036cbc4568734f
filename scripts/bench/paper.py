"""Repeat the paper's evaluation, Figures 3 and 4 of Jalil & Kobayashi, with real ROS 2 over simulated links.

Eleven sensors publish at the DEADLINE rate. A planner on the base reads them all and answers at the rate of one, each
sensor in its turn; a command carries the stamp of its sample, so its latency is end to end. Writers are plain rclpy
with the DEPTH and DEADLINE under test; readers keep everything, so that only the link and the writer lose samples.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, replace
from itertools import product
from statistics import median
from typing import Any

from arpd.sim.result import percentile
from arpd.solve.eq4 import Eq4Problem, whole
from scripts.bench.child import ChildError
from scripts.bench.report import Summary, figure, ranged, table
from scripts.bench.samples import BASE, Topic
from scripts.bench.sides import SIDES, Robot, Side
from scripts.bench.world import world_of

SENSORS, SECONDS, DRAIN_S = 11, 4.0, 7.0  # to the end of two of rclpy's heartbeats
RMAX_HZ, DEPTHS = (100, 200, 500, 1000), (1, 5000)
PAYLOADS = (33, 100, 1000)  # serialized bytes; a sample's tag and its head have 33
#: Link, payload and Rmax of the standard form.
USUAL = (*product(("2.4 GHz",), (100, 1000), (200, 1000)), ("wired", 100, 1000))
LIVE_HZ = 100.0  # of every source under arpd: more than 2.4 GHz carries of 1000 B, less than it carries of 33 B
_PROCESSES = 3  # share the sensors, because publish() holds the GIL
# A station tries a frame seven times (IEEE 802.11 dot11ShortRetryLimit): if three frames of ten fail, as on a busy
# 2.4 GHz channel, 0.3^7 = 0.02 % of the packets are lost. Rate (bytes/s), queue (bytes), loss (0..1):
LINKS = {"2.4 GHz": (8e6 / 8, 256_000, 0.3**7), "wired": (1e9 / 8, 1_000_000, 0.0)}
PLAIN = replace(SIDES["plain"], warm_up_s=0.5)
#: Heartbeats of rclpy's default, 3 s, and of arpd's Fast DDS profile, 50 ms.
HEARTBEATS = {"3 s, rclpy's default": PLAIN, "50 ms, arpd's profile": replace(PLAIN, has_profile=True)}


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """One configuration on one link; under arpd, DEPTH 0 stands for what arpd chooses."""

    link: str
    payload: int
    rate_hz: float
    depth: int
    loss: float
    side: Side = PLAIN
    heartbeat: str = ""

    @property
    def place(self) -> dict[str, Any]:
        """Link and payload for a table."""
        return {"link": self.link, "payload B": self.payload}


def optimum(rmax_hz: int) -> tuple[int, int]:
    """Return (R, D) of Eq. (4) as in the paper's Table 2 (Hz, samples)."""
    rate_hz, depth = Eq4Problem(max_rate_hz=rmax_hz, topics=SENSORS + 1).vertex()
    return whole(rate_hz), whole(depth)


def robot_of(cell: Cell) -> Robot:
    """Return the sensors, and the topic on which the planner answers."""
    qos: dict[str, Any] = {"depth": cell.depth or 10, "deadline_hz": cell.rate_hz if cell.depth else 0.0}
    about: dict[str, Any] = {"rate_hz": cell.rate_hz, "size": cell.payload, **qos}
    sensors = [Topic(name=f"/sensor_{k}", node=f"sensors{k % _PROCESSES}", **about) for k in range(SENSORS)]
    uniform = {"program": {"policy": "uniform"}, "defaults": {"latency_budget": "none"}}
    settings = uniform if cell.side.is_governed else None
    return Robot(topics=(*sensors, Topic(name="/actuation", node=BASE, answers=SENSORS, **about)), settings=settings)


def measured(cell: Cell, seconds: float) -> dict[str, Any]:
    """Return the figures of one turn."""
    rate, queue_bytes, _ = LINKS[cell.link]
    uniform: dict[str, Any] = {}
    with world_of(robot_of(cell), cell.side, rate=rate, queue_bytes=queue_bytes) as world:

        def note() -> None:
            if status := world.status():
                uniform.update(status["allocation"]["uniform"] or {})

        events = [(seconds - 0.5, note)] if cell.side.is_governed else []
        account, spent = world.play([(0.0, rate, cell.loss)], seconds, events=events, drain_s=DRAIN_S)
    first = {number: one["first"] or 0 for number, one in account.noted.items()}
    answered = [row for row in account.arrivals.pop("/actuation") if row[0] in first and row[1] >= first[row[0]]]
    latency_ms = {(row[0], row[1]): (row[3] - row[2]) * 1e-6 for row in reversed(answered)}
    asked = {
        (row[0], row[1])
        for rows in account.arrivals.values()
        for row in rows
        if row[1] % SENSORS == row[0] and row[1] >= first[row[0]]
    }
    published = sum(one["published"] for one in account.noted.values())
    unanswered = max(0, len(asked - latency_ms.keys()) - account.withheld.get("/actuation", 0))
    lost = sum(map(account.lost, account.topics)) + unanswered
    return {
        "p50 ms": percentile(list(latency_ms.values()), 0.5),
        "p99 ms": percentile(list(latency_ms.values()), 0.99),
        "lost %": 100.0 * lost / max(1, published + len(asked)),
        "rate reached %": 100.0 * published / (cell.rate_hz * seconds * SENSORS),
        "link % full": 100.0 * spent["to_base_mbit"] * 1e6 / 8 / rate,
        "Rmax Hz": uniform.get("max_rate_hz"),
        "R Hz": uniform.get("rate_hz"),
    }


def cells(*, is_quick: bool, is_full: bool) -> list[Cell]:
    """Return the optimum and the fixed configurations at each Rmax, then the lost packets, then arpd."""
    rate_hz, depth = optimum(max(RMAX_HZ))
    wifi: dict[str, Any] = {"link": "2.4 GHz", "loss": LINKS["2.4 GHz"][2]}
    payloads = PAYLOADS[-1:] if is_quick else PAYLOADS[::2]
    live = [Cell(**wifi, payload=each, rate_hz=LIVE_HZ, depth=0, side=SIDES["adaptive"]) for each in payloads]
    if is_quick:
        fixed = [(1, 100), (5000, 100), (depth, rate_hz)]
        return [*(Cell(**wifi, payload=100, rate_hz=hz, depth=d) for d, hz in fixed), *live]
    figures = [
        Cell(link=link, payload=payload, rate_hz=hz, depth=d, loss=LINKS[link][2])
        for link, payload, rmax_hz in (product(LINKS, PAYLOADS, RMAX_HZ) if is_full else USUAL)
        for hz, d in (optimum(rmax_hz), *((rmax_hz, each) for each in DEPTHS))
    ]
    lossy = [
        Cell(link="2.4 GHz", payload=100, rate_hz=rate_hz, depth=depth, loss=loss, side=side, heartbeat=heartbeat)
        for loss in ((0.0, 0.0001, 0.001, 0.01) if is_full else (0.0, 0.01))
        for heartbeat, side in HEARTBEATS.items()
    ]
    return [*figures, *lossy, *live]


def play(*, is_quick: bool, rounds: int = 1) -> Summary:
    """Play every configuration, in random order in each round."""
    wanted = cells(is_quick=is_quick, is_full=rounds > 1)
    runs: dict[Cell, list[dict[str, Any]]] = {cell: [] for cell in wanted}
    failed: list[list[str]] = []
    for number in range(rounds):
        for cell in random.Random(number).sample(wanted, len(wanted)):
            try:
                runs[cell].append(measured(cell, 2.0 if is_quick else SECONDS))
            except ChildError as error:
                about = f"DEPTH {cell.depth} at {cell.rate_hz:g} Hz"
                failed.append([cell.link, f"{cell.payload} B", about, cell.heartbeat or cell.side.name, str(error)])
    found = summary({cell: found for cell, found in runs.items() if found})
    found.failed = failed
    return found


def summary(runs: dict[Cell, list[dict[str, Any]]]) -> Summary:
    """Return each optimum beside the fixed configurations at its Rmax, the lost packets, and arpd."""
    optima = {optimum(rmax_hz): rmax_hz for rmax_hz in RMAX_HZ}
    common = ("p50 ms", "p99 ms", "lost %", "link % full")

    def p99(cell: Cell) -> float:
        return float(median(math.inf if run["p99 ms"] is None else run["p99 ms"] for run in runs[cell]))

    def said(cell: Cell, *keys: str, prefix: str = "") -> dict[str, Any]:
        return {prefix + key: ranged(run[key] for run in runs[cell]) for key in keys}

    plain = [cell for cell in runs if not cell.heartbeat and not cell.side.is_governed]
    solved = [cell for cell in plain if (cell.rate_hz, cell.depth) in optima]
    rows, won = [], dict.fromkeys((cell.link for cell in solved), 0)
    for cell in solved:
        rivals = [other for other in plain if other not in solved and other.place == cell.place]
        kept = [other for other in rivals if not any(run["lost %"] for run in runs[other])]
        won[cell.link] += all(p99(cell) <= p99(other) for other in kept)
        rmax_hz = optima[int(cell.rate_hz), cell.depth]
        row = {
            **cell.place,
            "Rmax Hz": rmax_hz,
            "optimum": f"({cell.rate_hz:g} Hz, {cell.depth})",
            **said(cell, *common),
        }
        for depth in DEPTHS:
            prefix = f"DEPTH {depth} at Rmax: "
            row |= dict.fromkeys((prefix + "p99 ms", prefix + "lost %", prefix + "rate reached %"), "")
            for other in (each for each in rivals if (each.rate_hz, each.depth) == (rmax_hz, depth)):
                row |= said(other, "p99 ms", "lost %", "rate reached %", prefix=prefix)
        rows.append(row)
    heartbeats = [
        {"packets lost %": 100.0 * cell.loss, "heartbeat": cell.heartbeat, **said(cell, *common)}
        for cell in runs
        if cell.heartbeat
    ]
    live = [{**cell.place, **said(cell, "Rmax Hz", "R Hz", *common)} for cell in runs if cell.side.is_governed]
    what = "optima with a lower p99 than each fixed configuration that loses nothing"
    here = {link: sum(cell.link == link for cell in solved) for link in won}
    return Summary(
        about="Latency is end to end, sensor → planner → actuator (range of rounds); lost: of all samples "
        "of the twelve topics. 2.4 GHz: 8 Mbit/s, queue 256 kB, 0.022 % loss; wired: 1 Gbit/s, queue 1 MB.",
        figures=[figure(f"{link}: {what}", won[link], f"of {here[link]}", least=here[link]) for link in won],
        tables=[
            table("Every optimum beside the fixed configurations at its Rmax", rows),
            table("The cost of a lost packet, 100 B over 2.4 GHz, by the optimum at 1000 Hz", heartbeats),
            table(f"Under `arpd run` with `policy: uniform`; the sources publish at {LIVE_HZ:g} Hz", live),
        ],
    )
