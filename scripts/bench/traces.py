"""Play a folder of recorded links in virtual time: how much of each is used, and how long packets wait for it."""

from __future__ import annotations

import logging
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product
from statistics import median
from typing import TYPE_CHECKING, Any

from arpd.daemon.scenario import Scenario, Way
from arpd.daemon.summary import WARM_UP_S, between, summarize
from arpd.model.errors import TraceError
from arpd.sim.result import percentile
from arpd.sim.schedule import Service
from arpd.sim.trace import LinkTrace, read_trace
from scripts.bench.estimate import BUSY, CAMERA, LOW_FLOORS, PROCESSES, SEEN, UNSEEN
from scripts.bench.links import CELLULAR_S, WALK, cellular
from scripts.bench.report import Summary, figure, table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

_LEAST_S, _MOST_S = 30.0, 120.0  # a shorter recording goes on as `read_trace` says; of a longer one, its begin
_SEEDS, _THROTTLE = 6, 0.5  # cellular models; share of the mean rate
_THROTTLED, _SEEN = "fixed throttle", "arpd, queue seen"
SIDES = {"defaults": Way.WITHOUT, _THROTTLED: Way.WITHOUT, "arpd": Way.ARPD, _SEEN: Way.ARPD, "bound": Way.ORACLE}
_MEDIANS = ("delivered %", "carried %", "queue p95 s", "IMU p99 s", "IMU age p99 s")


def recordings(folder: Path | None, rounds: int = 1) -> list[LinkTrace]:
    """Return the links of a folder; says of each file that is none what is wrong, and goes on."""
    if folder is None:
        seeds = range(1, _SEEDS * rounds + 1)
        models = [LinkTrace(name=f"cellular, model {k}", rates=cellular(k), duration_s=CELLULAR_S) for k in seeds]
        return [replace(read_trace(WALK), name="walk, model"), *models]
    found = list[LinkTrace]()
    for path in sorted(each for each in folder.glob("*") if each.is_file()):
        try:
            found.append(read_trace(path))
        except TraceError as error:
            print(error, file=sys.stderr)
    return found


def measured(trace: LinkTrace, side: str) -> dict[str, Any]:
    """Play a link with one side; the robot has so many cameras that it fills nine of ten seconds of the link."""
    end_s, service = min(max(trace.duration_s, _LEAST_S), _MOST_S), Service(trace.rates)
    seconds = [service.by(at_s + 1.0) - service.by(at_s) for at_s in range(int(end_s))]
    cameras = math.ceil((percentile(seconds, 0.9) or 0.0) / (CAMERA.payload_bytes * CAMERA.rate_hz))
    robot = (*BUSY, *(replace(CAMERA, name=f"/camera/{k}/compressed") for k in range(3, cameras)))
    if side == _THROTTLED:
        offered = sum(each.payload_bytes * each.rate_hz for each in robot)
        slower = min(1.0, _THROTTLE * service.by(end_s) / end_s / offered)
        robot = tuple(replace(each, rate_hz=each.rate_hz * slower) for each in robot)
    model = replace(SEEN if side == _SEEN else UNSEEN, losses=trace.losses)
    result = Scenario(LOW_FLOORS, trace.rates, end_s, way=SIDES[side], model=model, topics=robot).play()
    found, span = summarize(result, start_s=WARM_UP_S, end_s=end_s), between(result.moments, WARM_UP_S, end_s)
    could = sum(one.truth_bytes_per_second for one in span) / len(span)
    queues = [one.queue_delay_s for one in span if one.truth_bytes_per_second > 0.0]
    imu = next(each for each in result.topics if each.topic == "/imu")
    return {
        "link": trace.name,
        "side": side,
        "delivered %": 100.0 * found.goodput_bytes_per_second / could if could else 0.0,
        "carried %": 100.0 * found.carried_share,
        "queue p95 s": percentile(queues, 0.95),
        "IMU p99 s": imu.latency_p99_s,
        "IMU age p99 s": imu.age_p99_s,
        "plans/min": found.plans_per_minute,
        "Mbit/s": could * 8e-6,
        "out %": 100.0 * (1.0 - len(queues) / len(span)),
    }


def play(*, is_quick: bool, folder: Path | None = None, rounds: int = 1) -> Summary:
    """Play every link with every side."""
    if not (traces := recordings(folder, rounds)[: 1 if is_quick else None]):
        sys.exit(f"{folder}: no recording in it")
    with ProcessPoolExecutor(PROCESSES, initializer=logging.disable) as pool:
        return summary(list(pool.map(measured, *zip(*product(traces, SIDES), strict=True))))


def summary(rows: Sequence[dict[str, Any]]) -> Summary:
    """Return the medians of the sides, a table of links and sides, and a picture with a dot for each."""
    ours, bounds = ([row for row in rows if row["side"] == side] for side in ("arpd", "bound"))
    both = [(row["delivered %"], bound["delivered %"]) for row, bound in zip(ours, bounds, strict=True)]
    shares = [100.0 * row / bound for row, bound in both if bound] or [math.nan]
    figures = [
        figure("share of the bound's goodput, median", median(shares), "%", least=85.0),
        figure("share of the bound's goodput, worst", min(shares), "%", least=85.0),
        figure("plans, worst", max(row["plans/min"] for row in ours), "/min", most=6.0),
    ]
    medians = [
        {
            "side": side,
            **{
                key: median(math.inf if row[key] is None else row[key] for row in rows if row["side"] == side)
                for key in _MEDIANS
            },
        }
        for side in dict.fromkeys(row["side"] for row in rows)
    ]
    dots = [
        {"p95 of the queue (s)": row["queue p95 s"]}
        | {side: row["delivered %"] if side == row["side"] else None for side in SIDES}
        for row in rows
    ]
    return Summary(
        about="One run per link and side in virtual time, the bottleneck unseen but where the side says so. Payload "
        "delivered and bytes carried as shares of what the link could; how long a packet sent now waits for the link.",
        figures=figures,
        tables=[table("Medians of the links", medians), table("Every link", rows)],
        drawn=table("delivered payload, % of the link", dots),
    )
