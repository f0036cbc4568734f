"""Repeat the paper's evaluation, Figures 3 and 4 of Jalil & Kobayashi, with real ROS 2 over simulated links.

Usage: .venv/bin/python scripts/bench/paper.py [--quick] [--rounds N] [--seconds S] [--json FILE] [--plot FILE]

Needs root, as the simulated link does.

Eleven sensors publish on the robot, each with a publisher of its own. A planner on the CEDDP reads them all and answers
at the rate of one sensor, each sensor in its turn; the robot receives the commands. Both ends are plain rclpy, without
arpd. As in the paper, a sensor publishes at the DEADLINE rate. The fixed configurations are DEPTH 1 and 5000 at 100,
200, 500 and 1000 Hz, and (R, D) is the optimum of Eq. (4) for each of these as Rmax. Both links take turns with all
configurations; the order is random in each round.

Latency is counted per sample, from the call of `publish()`: sensing until the planner's DDS thread has the sample, end
to end until the robot's DDS thread has the command that answers it. A sample counts as lost if it has not arrived
eight seconds after the last one left, or when nothing has arrived for longer than a heartbeat. If `publish()` blocks
because the link is full, a sensor cannot keep its rate; the middleware causes that, and the reached rate is part of the
result. If a process had no CPU time to keep the rate, the turn is void.

A second table shows the cost of a lost packet with rclpy's heartbeat of 3 s, and with the 50 ms of arpd's profile for
Fast DDS. A third one has the same robot under `arpd run` with `policy: uniform`, which finds Rmax, R and D itself: all
publishers are AdaptivePublishers, their sources publish at one rate, and what pacing withholds is not lost. The
pictures are two files: -latency and -loss are added to the name of --plot.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from scripts.bench.child import ChildError
from scripts.bench.paper_cells import (
    LIVE,
    RMAX_HZ,
    WIFI,
    WIRED,
    figure_turns,
    live_turns,
    loss_turns,
    optimum,
    quick_turns,
    shuffled,
)
from scripts.bench.paper_figures import draw
from scripts.bench.paper_live_robot import LiveRobot
from scripts.bench.paper_report import nonsense, table, voids
from scripts.bench.paper_robot import Robot
from scripts.bench.record import conditions, keep, options_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scripts.bench.paper_cells import LinkProfile, Turn

ROUNDS, SECONDS = 2, 4.0


def measure(turns: list[Turn], rounds: int, seconds: float) -> Iterator[dict[str, Any]]:
    """Yield every turn with its figures, or with the reason why it failed."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="arpd-paper-")))
        keys = sorted({_robot_of(turn) for turn in turns}, key=repr)
        robots = {key: LiveRobot(key[0], folder) if key[2] else Robot(key[0], key[1], folder) for key in keys}
        for robot in robots.values():
            robot.open()
            stack.callback(robot.close)
        shown = stack.enter_context(progress("measuring", total=rounds * len(turns)))
        for number in range(1, rounds + 1):
            for turn in shuffled(turns, seed=number):
                shown.step(f"round {number}: {describe(turn)}")
                robot = robots[_robot_of(turn)]
                about = {
                    "experiment": turn.experiment,
                    "link": turn.link.name,
                    "link_loss": turn.loss,
                    "heartbeat": turn.heartbeat,
                    "round": number,
                    "load": os.getloadavg()[0],
                }
                yield {**about, **asdict(turn.configuration), **_played(robot, turn, seconds)}


def _robot_of(turn: Turn) -> tuple[LinkProfile, str, bool]:
    """Return what a turn needs of a robot: its link, its heartbeat, and whether arpd runs on it."""
    return turn.link, turn.heartbeat, turn.experiment == LIVE


def _played(robot: Robot | LiveRobot, turn: Turn, seconds: float) -> dict[str, Any]:
    """Return the figures of a turn; if a process ends, try once more with new processes."""
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
    if turn.experiment == LIVE:
        return f"{turn.link.name}, {cell.payload_bytes} B under arpd"
    return f"{turn.link.name}, {cell.payload_bytes} B at {cell.deadline_hz} Hz, DEPTH {cell.depth}"


def line(run: dict[str, Any]) -> str:
    """Return a turn's figures in a line."""
    name = f"{run['link']:>8} {run['payload_bytes']:>5} B {run['deadline_hz']:>5} Hz DEPTH {run['depth']:>4}"
    if "failed" in run:
        return f"{name}  {run['failed']}"
    if found := run.get("uniform"):
        name += f"  arpd: {found['rate_hz']:.1f} Hz DEPTH {found['depth']:.0f}"
    p99_s, lost = run["end_to_end"]["p99_s"], run["lost"] / max(1, run["published"])
    latency = "nothing came" if p99_s is None else f"p99 {p99_s * 1e3:8.1f} ms"
    return (
        f"{name}  {latency}  lost {lost:6.2%}  reached {run['reached_ratio']:4.0%}  blocked {run['blocked_ratio']:4.0%}"
        f"  link {run['used_ratio']:4.0%}  load {run['load']:.1f} {run['void'] and 'void: ' + run['void']}"
    )


def main() -> None:
    parser = options_of(__doc__, "paper", quick="three configurations and arpd on one link: a minute", has_plot=True)
    parser.add_argument("--rounds", type=int, metavar="N", help=f"default {ROUNDS}")
    parser.add_argument("--seconds", type=float, metavar="S", help=f"of load in each turn (default {SECONDS:g})")
    options = parser.parse_args()
    rounds = options.rounds or (1 if options.quick else ROUNDS)
    seconds = options.seconds or (2.0 if options.quick else SECONDS)
    turns = quick_turns() if options.quick else [*figure_turns(), *loss_turns(), *live_turns()]
    document: dict[str, Any] = {
        "conditions": {**conditions(), "seconds": seconds},
        "links": [asdict(link) for link in (WIFI, WIRED)],
        "optima": [dict(zip(("rmax_hz", "rate_hz", "depth"), (hz, *optimum(hz)), strict=True)) for hz in RMAX_HZ],
        "runs": [],
    }
    started_s = time.monotonic()
    with suppress(KeyboardInterrupt):  # the turns so far are kept
        for run in measure(turns, rounds, seconds):
            document["runs"].append(run)
            print(f"{time.monotonic() - started_s:5.0f} s {line(run)}", flush=True)
    if len(document["runs"]) < len(turns):
        sys.exit("paper: interrupted before a round was whole; nothing is kept")
    if faults := [*nonsense(document), *(voids(document) if options.quick else [])]:
        sys.exit("\n".join(f"paper: {fault}" for fault in faults))
    print(f"\n{table(document)}\n")
    keep(document, options, "paper", is_partial=options.quick, draw=partial(draw, document))


if __name__ == "__main__":
    main()
