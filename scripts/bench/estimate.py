"""Compare capacity estimates and their effect: arpd, an oracle and two estimates from throughput alone.

Usage: .venv/bin/python scripts/bench/estimate.py [--quick] [--only SCENARIO,...] [--way WAY,...] [--seeds N]

Every way governs the same robot on the same simulated link in virtual time, through the daemon's own tick; only the
source of the capacity differs. scripts/bench/estimate_scenarios.py has the links and robots,
scripts/bench/estimate_metrics.py the definition of every figure. The oracle knows rate, queue, cross traffic and
per-packet overhead at every tick; headroom, hold and dwell bind it as they bind the others.

With --only, --way or --quick nothing is written unless --json or --plot name a file.
"""

from __future__ import annotations

import logging
import math
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.adapters.sim.baselines import Oracle, ThroughputAverage, WindowMaximum
from arpd.cli.progress import progress
from arpd.daemon.scenario import ScenarioResult, run
from scripts.bench.estimate_metrics import Metrics, measure
from scripts.bench.estimate_plot import draw
from scripts.bench.estimate_report import TARGETS, scenario_table, target_table
from scripts.bench.estimate_scenarios import SCENARIOS
from scripts.bench.record import conditions, keep, options_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from arpd.daemon.scenario import EstimatorMaker
    from arpd.model.settings import Settings

ARPD, ORACLE = "arpd", "oracle"
WAYS = (ARPD, "average", "maximum", ORACLE)
SEEDS = 5
QUICK_SEEDS = 2
QUICK = (
    *("fall 20 to 5", "fall 5 to 1", "rise 5 to 20", "noisy", "bursts, all lost", "outages, lost", "oscillation 5 s"),
)
PROCESSES = 2

Key = tuple[str, str, int]  # scenario, way, seed


def maker(way: str, settings: Settings) -> EstimatorMaker | None:
    """Return the maker of a way's estimator; None for arpd's own."""
    makers: dict[str, EstimatorMaker] = {
        ORACLE: Oracle,
        "average": lambda _truth: ThroughputAverage(settings.link),
        "maximum": lambda _truth: WindowMaximum(settings.link),
    }
    return makers.get(way)


def play(key: Key) -> ScenarioResult:
    """Run one scenario one way with one seed."""
    name, way, seed = key
    scenario = SCENARIOS[name]
    logging.disable(logging.CRITICAL)
    return run(
        scenario.settings,
        scenario.schedule(seed),
        scenario.duration_s,
        seed=seed,
        managed=True,
        model=scenario.model,
        foreign=scenario.foreign,
        topics=scenario.robot,
        make_estimator=maker(way, scenario.settings),
    )


def measure_all(
    names: list[str], ways: list[str], seeds: int, on_picture: Callable[[str, dict[str, ScenarioResult]], None]
) -> dict[str, dict[str, list[Metrics]]]:
    """Return metrics by scenario and way, one entry per seed; call ``on_picture`` with the first seed's runs."""
    keys: list[Key] = [(name, way, seed) for name in names for seed in range(1, seeds + 1) for way in ways]
    found: dict[str, dict[str, list[Metrics]]] = {}
    with ProcessPoolExecutor(PROCESSES) as pool, progress("simulating", total=len(keys)) as shown:
        played = pool.map(play, keys)
        for name in names:
            found[name] = {way: [] for way in ways}
            shown.reach(len(ways) * seeds * (len(found) - 1), name)
            for seed in range(1, seeds + 1):
                results = {way: next(played) for way in ways}
                shown.reach(len(ways) * (seeds * (len(found) - 1) + seed))
                for way in ways:
                    found[name][way].append(measure(SCENARIOS[name], results[way], results.get(ORACLE)))
                if seed == 1:
                    on_picture(name, results)
    return found


def document(found: Mapping[str, Mapping[str, list[Metrics]]], seeds: int, took_s: float) -> dict[str, Any]:
    return {
        "seeds": seeds,
        "took_s": round(took_s, 1),
        "scenarios": {
            name: {way: [_finite(metrics) for metrics in every] for way, every in ways.items()}
            for name, ways in found.items()
        },
        "targets": [
            {
                "target": target.title,
                "limit": target.limit,
                "median": _number(median(values)),
                "worst": _number(target.worst(values)),
                "met": target.is_met(values),
            }
            for target in TARGETS
            if (values := target.values(found, ARPD))
        ],
    }


def _finite(metrics: Metrics) -> dict[str, float | None]:
    return {name: _number(value) for name, value in metrics.items()}


def _number(value: float) -> float | None:
    return round(value, 5) if math.isfinite(value) else None


def _chosen(text: str, known: tuple[str, ...], what: str) -> list[str]:
    chosen: list[str] = []
    for part in (part.strip() for part in text.split(",")):
        names = [part] if part in known else [name for name in known if name.startswith(part)]
        if not names:
            sys.exit(f"{part!r} is no {what}; there are: {', '.join(known)}")
        chosen += names
    return list(dict.fromkeys(chosen))


def main() -> int:
    quick = f"{QUICK_SEEDS} seeds, fewer scenarios, arpd and oracle"
    parser = options_of(__doc__, "estimate", quick=quick, has_plot=True)
    parser.add_argument("--only", metavar="SCENARIO,...", help="these scenarios, by name or its beginning")
    parser.add_argument("--way", metavar="WAY,...", help=f"these of {', '.join(WAYS)}")
    parser.add_argument("--seeds", type=int, metavar="N", help=f"seeds from 1 to N (default {SEEDS})")
    options = parser.parse_args()
    names = list(QUICK) if options.quick else list(SCENARIOS)
    names = _chosen(options.only, tuple(SCENARIOS), "scenario") if options.only else names
    ways = [ARPD, ORACLE] if options.quick else list(WAYS)
    ways = _chosen(options.way, WAYS, "way") if options.way else ways
    seeds = options.seeds or (QUICK_SEEDS if options.quick else SEEDS)
    noted = conditions()
    pictures: dict[str, dict[str, ScenarioResult]] = {}
    started_s = time.monotonic()
    found = measure_all(names, ways, seeds, pictures.__setitem__)
    took_s = time.monotonic() - started_s
    print(scenario_table(found, seeds=seeds))
    if ARPD in ways:
        print("\n" + target_table(found, ARPD))
    if not all(every[0]["goodput"] > 0.0 for ways in found.values() for every in ways.values()):
        sys.exit("estimate: nothing was delivered in some scenario")
    is_partial = bool(options.quick or options.only or options.way)
    found_document = {"conditions": noted} | document(found, seeds, took_s)
    keep(found_document, options, "estimate", is_partial=is_partial, draw=partial(draw, pictures))
    return 0


if __name__ == "__main__":
    sys.exit(main())
