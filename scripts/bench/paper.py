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
    ARPD,
    DEFAULT,
    FIGURES,
    HEARTBEAT_S,
    LIVE,
    LOSS,
    RMAX_HZ,
    SENSORS,
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
from scripts.bench.paper_robot import Robot
from scripts.bench.paper_summary import REACHED_RATIO
from scripts.bench.paper_verdict import (
    LIKE,
    cells,
    milliseconds,
    named,
    nonsense,
    percent,
    rounds,
    short,
    verdicts,
    voids,
)
from scripts.bench.record import conditions, keep, options_of
from scripts.bench.report import about, details, paragraphs, table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from scripts.bench.paper_cells import LinkProfile, Turn
    from scripts.bench.paper_verdict import Cell, Verdict

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
                shown.step(f"round {number}: {_named(turn)}")
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
            print(f"{_named(turn)}: {failed}", file=sys.stderr, flush=True)
            robot.close()
            robot.open()
    return {"failed": failed}


def _named(turn: Turn) -> str:
    return named({"experiment": turn.experiment, "link": turn.link.name, **asdict(turn.configuration)})


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


def report(document: dict[str, Any]) -> str:
    figures, judged = cells(document, FIGURES), verdicts(document)
    links = "; ".join(
        f"{link['name']} {link['rate_bytes_per_second'] * 8 / 1e6:g} Mbit/s, queue {link['queue_bytes'] / 1e3:g} kB, "
        f"loss {percent(link['loss'])} %"
        for link in document["links"]
    )
    slowed = sum((cell.middle("reached_ratio") or 1.0) < REACHED_RATIO for cell in figures)
    what = (
        f"{rounds(document)} a configuration; {links}. Latency is end to end, sensor → planner → actuator, in ms "
        "(range over rounds); lost: of all samples of the twelve topics. Void: this machine could not generate the "
        "load, or not answer it"
    )
    return paragraphs(
        about(document, what),
        "The optimum for each payload and Rmax beside every fixed configuration. p99: below that of all that lose "
        f"nothing. Loss: not above that of any with a like latency (p99 within a factor {LIKE:g}).",
        table(
            dict.fromkeys(each.optimum.link for each in judged),
            ("link", str),
            ("optima with the lower p99", partial(_won, judged, lambda each: each.slower_than)),
            ("with no more loss", partial(_won, judged, lambda each: each.lossier_than)),
        ),
        f"Of {len(figures)} configurations, publish() kept {slowed} below {percent(REACHED_RATIO)} % of their rate, a "
        f"reader's socket overflowed in {sum(cell.overflows > 0 for cell in figures)}, which is this machine's fault, "
        f"and {sum(not cell.runs for cell in figures)} are void.",
        details(
            "Every optimum beside the fixed configurations at its Rmax",
            "Quicker: the best fixed configuration that loses nothing and has no higher p99, at any rate. Where "
            "neither fills the link, nothing queues.",
            table(
                judged,
                ("link", lambda each: each.optimum.link),
                ("payload B", lambda each: each.optimum.payload_bytes),
                ("Rmax Hz", lambda each: each.rmax_hz),
                ("optimum", lambda each: each.optimum.name_in_link),
                ("p50", lambda each: each.optimum.p50_s, milliseconds),
                ("p99", lambda each: each.optimum.shown_p99),
                ("lost %", lambda each: each.optimum.lost_ratio, percent),
                ("link % full", lambda each: each.optimum.used_ratio, percent),
                ("DEPTH 1 at Rmax: p99", partial(_at_rmax, 1, lambda cell: cell.shown_p99)),
                ("lost %", partial(_at_rmax, 1, lambda cell: cell.lost_ratio), percent),
                ("DEPTH 5000 at Rmax: p99", partial(_at_rmax, 5000, lambda cell: cell.shown_p99)),
                ("lost %", partial(_at_rmax, 5000, lambda cell: cell.lost_ratio), percent),
                ("rate reached %", partial(_at_rmax, 5000, lambda cell: cell.middle("reached_ratio")), percent),
                ("quicker", _quicker),
            ),
        ),
        _of_a_lost_packet(cells(document, LOSS)),
        _under_arpd(cells(document, LIVE), document["conditions"]["seconds"]),
    )


def _at_rmax(depth: int, figure: Callable[[Cell], Any], verdict: Verdict) -> Any:
    """Return a figure of the fixed configuration at the optimum's Rmax; the short form has not every one."""
    return next((figure(cell) for cell in verdict.at_rmax if cell.depth == depth), "")


def _quicker(verdict: Verdict) -> str:
    if not verdict.slower_than:
        return ""
    best = min(verdict.slower_than, key=lambda cell: cell.p99_s or 0.0)
    return f"{best.name_in_link}: {best.shown_p99}, link {percent(best.used_ratio)} % full"


def _won(judged: list[Verdict], better: Callable[[Verdict], tuple[Cell, ...]], link: str) -> str:
    here = [each for each in judged if each.optimum.link == link and each.optimum.runs]
    return f"{sum(not better(each) for each in here)} of {len(here)}"


def _of_a_lost_packet(found: list[Cell]) -> str:
    if not found:
        return ""
    return paragraphs(
        f"The cost of a lost packet, {found[0].payload_bytes} B over {found[0].link}, with rclpy's heartbeat of "
        f"{HEARTBEAT_S[DEFAULT]:g} s and the {milliseconds(HEARTBEAT_S[ARPD])} ms of arpd's Fast DDS profile:",
        table(
            sorted(found, key=lambda cell: (cell.link_loss, cell.depth, cell.heartbeat == ARPD)),
            ("packets lost %", lambda cell: cell.link_loss, percent),
            ("R, D", lambda cell: cell.name_in_link),
            ("heartbeat", lambda cell: cell.heartbeat),
            ("p50 ms", lambda cell: cell.p50_s, milliseconds),
            ("p99 ms (range over rounds)", lambda cell: cell.shown_p99),
        ),
    )


def _under_arpd(found: list[Cell], seconds: float) -> str:
    if not found:
        return ""
    return paragraphs(
        f"The same robot under `arpd run` with `policy: uniform`, which measures Rmax, and with arpd's Fast DDS "
        f"profile. Its sources publish at {found[0].deadline_hz} Hz; what pacing withholds is not lost:",
        table(
            found,
            ("link", lambda cell: cell.link),
            ("payload B", lambda cell: cell.payload_bytes),
            ("Rmax Hz", lambda cell: cell.middle("uniform", "max_rate_hz"), short),
            ("R Hz", lambda cell: cell.middle("uniform", "rate_hz"), short),
            ("D", lambda cell: cell.middle("uniform", "depth"), "{:.0f}"),
            ("of one sensor at the planner Hz", lambda cell: _came_hz(cell, seconds), short),
            ("p50 ms", lambda cell: cell.p50_s, milliseconds),
            ("p99 ms", lambda cell: cell.shown_p99),
            ("sensing p99 ms", lambda cell: cell.middle("sensing", "p99_s"), milliseconds),
            ("lost %", lambda cell: cell.lost_ratio, percent),
            ("link % full", lambda cell: cell.used_ratio, percent),
        ),
    )


def _came_hz(cell: Cell, seconds: float) -> float | None:
    count = cell.middle("sensing", "count")
    return None if count is None else count / SENSORS / seconds


def main() -> None:
    parser = options_of(__doc__, "paper", quick="three configurations and arpd on one link: a minute", has_plot=True)
    parser.add_argument("--rounds", type=int, metavar="N", help=f"default {ROUNDS}")
    parser.add_argument("--seconds", type=float, metavar="S", help=f"of load in each turn (default {SECONDS:g})")
    options = parser.parse_args()
    number = options.rounds or (1 if options.quick else ROUNDS)
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
        for run in measure(turns, number, seconds):
            document["runs"].append(run)
            print(f"{time.monotonic() - started_s:5.0f} s {line(run)}", flush=True)
    if len(document["runs"]) < len(turns):
        sys.exit("paper: interrupted before a round was whole; nothing is kept")
    if faults := [*nonsense(document), *(voids(document) if options.quick else [])]:
        sys.exit("\n".join(f"paper: {fault}" for fault in faults))
    keep(document, options, "paper", is_partial=options.quick, draw=partial(draw, document))
    print(report(document))


if __name__ == "__main__":
    main()
