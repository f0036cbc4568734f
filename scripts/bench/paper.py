"""The paper's evaluation, Figures 3 and 4 of Jalil & Kobayashi, with real ROS 2 over simulated links.

Usage: .venv/bin/python scripts/bench/paper.py [--quick] [--rounds N] [--seconds S] [--json FILE] [--plot FILE]

Needs root, as the simulated link does.

Eleven sensors publish on the robot, each with a publisher of its own; a planner on the CEDDP reads them all and answers
at the rate of one, each sensor in its turn; the robot receives the commands. Plain rclpy on both sides, no arpd. As in
the paper, a sensor publishes at the DEADLINE rate; the fixed configurations are DEPTH 1 and 5000 at 100, 200, 500 and
1000 Hz, and (R, D) is the optimum of Eq. (4) for each of these as Rmax. Both links take turns with all configurations
in an order that is random in each round.

Latency is counted per sample, from the call of `publish()`: sensing until the planner's DDS thread has it, end to end
until the robot's DDS thread has the command that answers it. A sample is lost that has not arrived when nothing has for
longer than a heartbeat, or eight seconds after the last one left. Where `publish()` blocks because the link is full, a
sensor cannot keep its rate: that is the middleware's doing, and the rate reached is part of the result. Where a process
had no time to keep it, the turn is void.

A second table says what a lost packet costs with rclpy's heartbeat of 3 s, and with the 50 ms of arpd's profile for
Fast DDS.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from scripts.bench.child import ChildError
from scripts.bench.paper_cells import RMAX_HZ, WIFI, WIRED, figure_turns, loss_turns, optimum, quick_turns, shuffled
from scripts.bench.paper_figures import draw
from scripts.bench.paper_report import nonsense, table, voids
from scripts.bench.paper_robot import Robot
from scripts.bench.record import conditions, keep, target

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scripts.bench.paper_cells import Turn

ROUNDS, SECONDS = 2, 4.0


def measure(turns: list[Turn], rounds: int, seconds: float) -> Iterator[dict[str, Any]]:
    """Yield every turn and what came of it, or why nothing did."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="arpd-paper-")))
        robots = {key: Robot(*key, folder) for key in sorted({(t.link, t.heartbeat) for t in turns}, key=repr)}
        for robot in robots.values():
            robot.open()
            stack.callback(robot.close)
        shown = stack.enter_context(progress("measuring", total=rounds * len(turns)))
        for number in range(1, rounds + 1):
            for turn in shuffled(turns, seed=number):
                shown.step(f"round {number}: {describe(turn)}")
                robot = robots[turn.link, turn.heartbeat]
                about = {
                    "experiment": turn.experiment,
                    "link": turn.link.name,
                    "link_loss": turn.loss,
                    "heartbeat": turn.heartbeat,
                    "round": number,
                    "load": os.getloadavg()[0],
                }
                yield {**about, **asdict(turn.configuration), **_played(robot, turn, seconds)}


def _played(robot: Robot, turn: Turn, seconds: float) -> dict[str, Any]:
    """Return what came of a turn; with new processes once more if one ended, for there are many turns to lose."""
    failed = ""
    for _ in range(2):
        try:
            return robot.play(turn, seconds=seconds)
        except ChildError as error:
            failed = str(error)
            print(f"{describe(turn)}: {failed}", file=sys.stderr, flush=True)
            robot.close()
            robot.open()
    return {"failed": failed}


def describe(turn: Turn) -> str:
    """Name a turn in a few words."""
    cell = turn.configuration
    return f"{turn.link.name}, {cell.payload_bytes} B at {cell.deadline_hz} Hz, DEPTH {cell.depth}"


def line(run: dict[str, Any]) -> str:
    """Say in a line what came of a turn."""
    name = f"{run['link']:>8} {run['payload_bytes']:>5} B {run['deadline_hz']:>5} Hz DEPTH {run['depth']:>4}"
    if "failed" in run:
        return f"{name}  {run['failed']}"
    p99_s, lost = run["end_to_end"]["p99_s"], run["lost"] / max(1, run["published"])
    latency = "nothing came" if p99_s is None else f"p99 {p99_s * 1e3:8.1f} ms"
    return (
        f"{name}  {latency}  lost {lost:6.2%}  reached {run['reached_ratio']:4.0%}  blocked {run['blocked_ratio']:4.0%}"
        f"  link {run['used_ratio']:4.0%}  load {run['load']:.1f} {run['void'] and 'void: ' + run['void']}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="three configurations on one link: half a minute")
    parser.add_argument("--rounds", type=int, metavar="N", help=f"default {ROUNDS}")
    parser.add_argument("--seconds", type=float, metavar="S", help=f"of load in each turn (default {SECONDS:g})")
    parser.add_argument("--json", type=Path, metavar="FILE", help="default results/paper.json")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="default results/paper.png: -latency, -loss added")
    options = parser.parse_args()
    rounds = options.rounds or (1 if options.quick else ROUNDS)
    seconds = options.seconds or (2.0 if options.quick else SECONDS)
    turns = quick_turns() if options.quick else [*figure_turns(), *loss_turns()]
    document: dict[str, Any] = {
        "conditions": {**conditions(), "seconds": seconds},
        "links": [asdict(link) for link in (WIFI, WIRED)],
        "optima": [dict(zip(("rmax_hz", "rate_hz", "depth"), (hz, *optimum(hz)), strict=True)) for hz in RMAX_HZ],
        "runs": [],
    }
    started_s = time.monotonic()
    with suppress(KeyboardInterrupt):  # whole rounds, and what there is of one more, are kept
        for run in measure(turns, rounds, seconds):
            document["runs"].append(run)
            print(f"{time.monotonic() - started_s:5.0f} s {line(run)}", flush=True)
    if len(document["runs"]) < len(turns):
        sys.exit("paper: interrupted before a round was whole; nothing is kept")
    if faults := [*nonsense(document), *(voids(document) if options.quick else [])]:
        sys.exit("\n".join(f"paper: {fault}" for fault in faults))
    print(f"\n{table(document)}\n")
    keep(document, target(options.json, "paper.json", is_partial=options.quick))
    if plot := target(options.plot, "paper.png", is_partial=options.quick):
        for path in draw(document, plot):
            print(path)


if __name__ == "__main__":
    main()
