"""Compare arpd with the bound and with other ways to find the capacity, on simulated links.

Usage: .venv/bin/python scripts/bench/estimate.py [--quick] [--only SCENARIO,...] [--way WAY,...] [--seeds N]
                                                  [--grid [N]]

Every way but the last governs the same robot in virtual time, through the daemon's own tick; only the source of the
capacity differs:

arpd                arpd's estimator
bound               told the truth at every tick: rate and cross traffic, averaged over the next 0.2 s, and the queue
average, maximum    two estimates from throughput alone, on some scenarios
fluid               no robot: a delay-target controller on a fluid, without samples and floors, on some scenarios

scripts/bench/estimate_scenarios.py has the links and robots, scripts/bench/estimate_metrics.py the definition of every
figure. --grid adds a sample of the grid in scripts/bench/estimate_grid.py; `--only grid` plays nothing else. With
--only, --way or --quick nothing is written unless --json or --plot name a file.
"""

from __future__ import annotations

import logging
import math
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.adapters.sim.baselines import Oracle, ThroughputAverage, WindowMaximum
from arpd.cli.progress import progress
from arpd.daemon.scenario import ScenarioResult, run
from scripts.bench.estimate_fluid import flow
from scripts.bench.estimate_grid import CELLS, play_grid
from scripts.bench.estimate_metrics import Metrics, carried, measure
from scripts.bench.estimate_plot import draw
from scripts.bench.estimate_scenarios import FALLS, SCENARIOS
from scripts.bench.estimate_targets import ARPD, BOUND, FLUID, THROUGHPUT, report, scenario_tables
from scripts.bench.record import conditions, keep, options_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from arpd.daemon.scenario import EstimatorMaker
    from arpd.model.settings import Settings
    from scripts.bench.estimate_grid import Judged

WAYS = (ARPD, BOUND, *THROUGHPUT, FLUID)
SEEDS = 10
QUICK_SEEDS = 2
QUICK = (
    *("fall 20 to 11", "fall 20 to 5", "fall 5 to 1", "rise 5 to 20", "noisy", "bursts, all lost", "outages, lost"),
    *("oscillation 8 s", "cellular up", "near zero", "walk"),
)
THROUGHPUT_SCENARIOS = frozenset({"fall 20 to 5", "rise 5 to 20", "noisy", "outages, lost", "oscillation 8 s"})
THROUGHPUT_SEEDS = 2
GRID = "grid"
PROCESSES = 2

Key = tuple[str, str, int]  # scenario, way, seed


def maker(way: str, settings: Settings) -> EstimatorMaker | None:
    """Return the maker of a way's estimator; None for arpd's own."""
    makers: dict[str, EstimatorMaker] = {
        BOUND: Oracle,
        "average": lambda _truth: ThroughputAverage(settings.link),
        "maximum": lambda _truth: WindowMaximum(settings.link),
    }
    return makers.get(way)


def play(key: Key) -> ScenarioResult:
    """Run one scenario one way with one seed."""
    name, way, seed = key
    scenario = SCENARIOS[name]
    if way == FLUID:
        return flow(scenario, seed)
    logging.disable(logging.CRITICAL)
    return run(
        scenario.settings,
        scenario.schedule(seed),
        scenario.duration_s,
        seed=seed,
        managed=True,
        model=scenario.model,
        foreign=scenario.foreign,
        into_peer=scenario.into_peer,
        has_peer=scenario.has_peer,
        topics=scenario.robot,
        make_estimator=maker(way, scenario.settings),
    )


def plays(name: str, way: str, seed: int) -> bool:
    """Return whether a way plays a scenario with this seed."""
    if way in THROUGHPUT:
        return name in THROUGHPUT_SCENARIOS and seed <= THROUGHPUT_SEEDS
    return way != FLUID or SCENARIOS[name].has_fluid


def measure_all(
    names: list[str], ways: list[str], seeds: int, on_picture: Callable[[str, dict[str, ScenarioResult]], None]
) -> dict[str, dict[str, list[Metrics]]]:
    """Return metrics by scenario and way, one entry per seed; call ``on_picture`` with the first seed's runs."""
    keys: list[Key] = [
        (name, way, seed) for name in names for seed in range(1, seeds + 1) for way in ways if plays(name, way, seed)
    ]
    found: dict[str, dict[str, list[Metrics]]] = {}
    with ProcessPoolExecutor(PROCESSES) as pool, progress("simulating", total=len(keys)) as shown:
        played = zip(keys, pool.map(play, keys), strict=True)
        done = 0
        for (name, seed), group in groupby(played, key=lambda each: (each[0][0], each[0][2])):
            shown.reach(done, name)
            results = {way: result for (_, way, _), result in group}
            done += len(results)
            bound, fluid = results.get(BOUND), results.get(FLUID)
            for way, result in results.items():
                metrics = (
                    carried(SCENARIOS[name], result)
                    if way == FLUID
                    else measure(SCENARIOS[name], result, bound=bound, fluid=fluid)
                )
                found.setdefault(name, {}).setdefault(way, []).append(metrics)
            if seed == 1 and (name not in FALLS or FALLS.keys() >= set(names)):  # a dozen alike
                on_picture(name, results)
        shown.reach(done)
    return found


def document(
    found: Mapping[str, Mapping[str, list[Metrics]]], seeds: int, took_s: float, grid: Sequence[Judged] = ()
) -> dict[str, Any]:
    return {
        "seeds": seeds,
        "took_s": round(took_s, 1),
        "scenarios": {
            name: {way: [_finite(metrics) for metrics in every] for way, every in ways.items()}
            for name, ways in found.items()
        },
        "grid": [judged.document() for judged in grid],
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
    quick = f"{QUICK_SEEDS} seeds, fewer scenarios, arpd, bound and fluid"
    parser = options_of(__doc__, "estimate", quick=quick, has_plot=True)
    parser.add_argument("--only", metavar="SCENARIO,...", help="these scenarios, by name or its beginning")
    parser.add_argument("--way", metavar="WAY,...", help=f"these of {', '.join(WAYS)}")
    parser.add_argument("--seeds", type=int, metavar="N", help=f"seeds from 1 to N (default {SEEDS})")
    parser.add_argument(
        "--grid", type=int, nargs="?", const=CELLS, metavar="N", help=f"play N cells of the grid, too (default {CELLS})"
    )
    options = parser.parse_args()
    names = list(QUICK) if options.quick else list(SCENARIOS)
    names = _chosen(options.only, (*SCENARIOS, GRID), "scenario") if options.only else names
    cells = options.grid or (CELLS if GRID in names else 0)
    names = [name for name in names if name != GRID]
    ways = [ARPD, BOUND, FLUID] if options.quick else list(WAYS)
    ways = _chosen(options.way, WAYS, "way") if options.way else ways
    seeds = options.seeds or (QUICK_SEEDS if options.quick else SEEDS)
    noted = conditions()
    pictures: dict[str, dict[str, ScenarioResult]] = {}
    started_s = time.monotonic()
    found = measure_all(names, ways, seeds, pictures.__setitem__)
    grid = play_grid(cells, processes=PROCESSES)
    took_s = time.monotonic() - started_s
    if not all(every[0]["carried"] > 0.0 for ways in found.values() for every in ways.values()):
        sys.exit("estimate: nothing was delivered in some scenario")
    is_partial = bool(options.quick or options.only or options.way)
    found_document = {"conditions": noted} | document(found, seeds, took_s, grid)
    print(scenario_tables(found_document), report(found_document), sep="\n\n")
    keep(found_document, options, "estimate", is_partial=is_partial, draw=partial(draw, pictures))
    return 0


if __name__ == "__main__":
    sys.exit(main())
