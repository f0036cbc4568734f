"""Compare arpd with everything a user would do instead: the demo robot over links that change.

Usage: .venv/bin/python -m scripts.bench.adapt [--quick] [--rounds N] [--only LINK,...] [--side SIDE,...] [--json FILE]
       .venv/bin/python -m scripts.bench.adapt --side SIDE,... --into FILE
       .venv/bin/python -m scripts.bench.adapt --report FILE
       .venv/bin/python -m scripts.bench.adapt --trains N

Needs root, as the simulated link does.

Twelve topics between two network namespaces, real rclpy and Fast DDS, a real rate-limited link. Each side has a run
and a robot of its own, over the same schedule; the order of sides is random in every round. A sample counts as lost if
it has not arrived four seconds after the end. Ages are those of the newest sample at the reader, 20 times a second.
arpd's estimate is compared with the link in every run (adapt_course.py, adapt_estimate.py); --trains measures instead
what single probe trains read (adapt_trains.py).
"""

from __future__ import annotations

import json
import math
import os
import random
import shutil
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from arpd.cli.progress import progress
from arpd.model.errors import ArpdError
from scripts.bench.adapt_course import course_of, estimates_over_time, reading
from scripts.bench.adapt_estimate import estimate_figures
from scripts.bench.adapt_figures import check, document
from scripts.bench.adapt_links import SEED, links, quick_link
from scripts.bench.adapt_plot import draw
from scripts.bench.adapt_sides import ARPD, DEFAULTS, SIDES, manner
from scripts.bench.adapt_targets import more_tables, report
from scripts.bench.adapt_trains import measure_trains, trains_report
from scripts.bench.adapt_watch import Processors, Reassembly
from scripts.bench.record import conditions, keep, options_of, read, write
from scripts.netns.simlink import SimLink
from scripts.robot.oracle import write_course
from scripts.robot.run import robot, run

if TYPE_CHECKING:
    from argparse import ArgumentParser
    from collections.abc import Iterator, Sequence

    from scripts.bench.adapt_links import Link


def play(link: Link, side_name: str, folder: Path) -> dict[str, Any]:
    """Run one side's robot over one link, and return the figures of the run."""
    folder.mkdir(parents=True)
    truth = folder / "truth.json"
    start_rate = link.rates.rate_at(0.0)
    write_course(truth, link.rates, link.losses)
    processors = Processors()

    def on_tick(_elapsed_s: float) -> None:
        processors.read(side)
        reassembly.read()

    with (
        SimLink(f"adapt-{os.getpid()}-{time.monotonic_ns() % 10**6}", rate_bytes_per_second=start_rate) as wire,
        robot(wire, folder, manner(side_name, link, truth)) as side,
        reading(side) as readings,
    ):
        reassembly = Reassembly(wire.ceddp)
        topics = run(
            side,
            link.rates,
            link.duration_s,
            on_tick=on_tick,
            loss_at=link.loss_at,
            # Called for the first time when the run begins.
            on_change=lambda _rate, _loss: write_course(truth, link.rates, link.losses, started_s=side.started_s),
        )
        results = [read(path) for path in (folder / "planner.json", folder / "base_driver.json")]
        final, fragments = side.final, reassembly.figures()
    samples = {topic: values for result in results for topic, values in result["samples"].items()}
    course = course_of(readings.buckets, readings.beliefs, started_s=side.started_s, duration_s=link.duration_s)
    return {
        **document(topics, samples, link.duration_s),
        "cpu": processors.shares(),
        "swaps": sum(sum(topic["swaps"].values()) for topic in final["topics"]) if final else 0,
        "reassembly": fragments,
        "estimate": estimate_figures(course, link),
        "estimates_over_time": estimates_over_time(course),
        "load_average": os.getloadavg()[0],
    }


def measure(
    chosen: Sequence[Link], sides: Sequence[str], rounds: int, seed: int, logs: Path
) -> Iterator[dict[str, Any]]:
    """Yield every run as it ends; in each round the order of links and sides is random."""
    rng = random.Random(seed)
    turns = [
        (number, link, side)
        for number in range(1, rounds + 1)
        for link in rng.sample(chosen, len(chosen))
        for side in rng.sample(sides, len(sides))
        if not link.sides or side in link.sides
    ]
    began_s = time.monotonic()
    with progress("measuring", total=len(turns)) as shown:
        for number, link, side in turns:
            shown.step(f"{link.name}, {side}, round {number}")
            folder = logs / f"{number}-{link.name}-{side}"
            try:
                done = {"link": link.name, "side": side, "round": number, **play(link, side, folder)}
            except ArpdError as error:
                print(f"{link.name}, {side}, round {number}: {error}", file=sys.stderr, flush=True)
                continue
            shutil.rmtree(folder, ignore_errors=True)
            print(f"{time.monotonic() - began_s:5.0f} s  {line(done)}", flush=True)
            yield done


def line(done: dict[str, Any]) -> str:
    """Return a run's figures in a line."""
    figures = done["all"]
    p99, age = (math.inf if figures[name] is None else figures[name] for name in ("latency_p99_s", "age_p99_s"))
    return (
        f"{done['link']:>11} {done['side']:>14}  latency p99 {p99:.3f} s  age p99 {age:.3f} s"
        f"  late {100 * figures['command_late_share']:.1f} %  {figures['goodput_bytes_per_second'] * 8e-6:.1f} Mbit/s"
        f"  machine {100 * done['cpu']['machine']:.0f} %"
    )


def assembled(
    chosen: Sequence[Link], sides: Sequence[str], runs: Sequence[dict[str, Any]], about: dict[str, Any], seed: int
) -> dict[str, Any]:
    """Return the document of all runs."""
    return {
        "conditions": about,
        "seed": seed,
        "links": [
            {
                "name": link.name,
                "what": link.what,
                "duration_s": link.duration_s,
                "rates": [(step.start_s, step.rate_bytes_per_second) for step in link.rates.steps],
                "losses": [(step.start_s, step.loss) for step in link.losses],
            }
            for link in chosen
        ],
        "sides": {side: SIDES[side] for side in SIDES if side in sides},
        "runs": list(runs),
    }


def renewed(old: dict[str, Any], fresh: dict[str, Any]) -> dict[str, Any]:
    """Return a document in which fresh runs replace those of the same links and sides; its key ``apart`` names them.

    Links that the document does not have are added.

    Raises
    ------
    ValueError
        If a link has changed: its sides would not be comparable.
    """
    courses = {link["name"]: json.dumps(link) for link in old["links"]}
    new = [link for link in fresh["links"] if link["name"] not in courses]
    if other := [
        link["name"] for link in fresh["links"] if link not in new and courses[link["name"]] != json.dumps(link)
    ]:
        raise ValueError(f"{', '.join(other)}: not the links of the document")
    replaced = {(run["link"], run["side"]) for run in fresh["runs"]}
    kept = [run for run in old["runs"] if (run["link"], run["side"]) not in replaced]
    apart = {"sides": list(fresh["sides"]), "conditions": fresh["conditions"]}
    sides = {**old["sides"], **fresh["sides"]}
    return {**old, "links": [*old["links"], *new], "sides": sides, "runs": [*kept, *fresh["runs"]], "apart": apart}


def main() -> None:
    parser = options_of(__doc__, "adapt", quick="a short step down with two sides, as CI runs it", has_plot=True)
    parser.add_argument("--rounds", type=int, default=1, metavar="N", help="times everything runs (default 1)")
    parser.add_argument("--only", default="", metavar="LINK,...", help="these links")
    parser.add_argument("--side", default="", metavar="SIDE,...", help=f"these sides of {', '.join(SIDES)}")
    parser.add_argument("--seed", type=int, default=SEED, metavar="N", help="of bursts and order (default %(default)s)")
    parser.add_argument("--logs", type=Path, metavar="DIR", help="folder for logs of runs that fail")
    parser.add_argument("--into", type=Path, metavar="FILE", help="replace the runs of these sides in a document")
    parser.add_argument("--report", type=Path, metavar="FILE", help="measure nothing; print the tables of this file")
    parser.add_argument("--trains", type=int, metavar="N", help="measure only what N probe trains of each kind read")
    options = parser.parse_args()
    if options.trains:
        read_by_trains = {"conditions": conditions(), **measure_trains(options.trains)}
        print(trains_report(read_by_trains))
        write(read_by_trains, options.json)
        return
    if options.report:
        reported = read(options.report)
        print(report(reported), more_tables(reported), sep="\n\n")
        if options.plot:
            draw(reported, options.plot)
        return
    known = {link.name: link for link in ((quick_link(),) if options.quick else links(options.seed))}
    chosen = _chosen(parser, "--only", options.only, known)
    every = (DEFAULTS, ARPD) if options.quick else SIDES
    sides = list(_chosen(parser, "--side", options.side, {side: side for side in every}))
    logs = options.logs or Path(tempfile.mkdtemp(prefix="arpd-adapt-"))
    about = conditions()
    rounds = 1 if options.quick else options.rounds
    runs = list(measure(chosen, sides, rounds, seed=options.seed, logs=logs))
    found = assembled(chosen, sides, runs, about, options.seed)
    if options.into:
        found = renewed(read(options.into), json.loads(json.dumps(found)))
        options.json = options.into
    is_partial = options.quick or bool(options.only) or bool(options.side)
    if runs:
        print(report(found), more_tables(found), sep="\n\n")
    wrong = [f"{done['link']}, {done['side']}: {what}" for done in runs for what in check(done)]
    turns = rounds * sum(not link.sides or side in link.sides for link in chosen for side in sides)
    if len(runs) < turns:
        wrong.append(f"only {len(runs)} of {turns} runs ended; logs in {logs}")
    if runs:
        keep(found, options, "adapt", is_partial=is_partial, draw=None if wrong else partial(draw, found))
    if wrong:
        sys.exit("adapt: " + "\n       ".join(wrong))


def _chosen(parser: ArgumentParser, option: str, text: str, known: dict[str, Any]) -> list[Any]:
    names = [name for name in text.split(",") if name] or list(known)
    if unknown := [name for name in names if name not in known]:
        parser.error(f"{option}: no {', '.join(unknown)}; there are {', '.join(known)}")
    return [known[name] for name in names]


if __name__ == "__main__":
    main()
