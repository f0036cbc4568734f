"""Measure arpd on a Raspberry Pi's share of this machine: reactions, late ticks, losses, latency and watchdog.

Usage: .venv/bin/python scripts/bench/pi.py [--quick] [--only N …] [--boards NAME …] [--rounds N] [--json FILE]

Needs root, as the simulated link does, and control groups with a quota of CPU, of version 1 or 2. Two rounds take half
an hour.

The robot's side (`arpd run`, `arpd relay`, and one process with all sources) runs in control groups that give each
thread one core of a Raspberry Pi, all of them four, and 1 GiB. The CEDDP has this machine's cores. The order of boards
and numbers of topics is random in every round. How slow a Pi's core is follows from published figures and from a
reference that runs here first (`scripts/bench/pi_boards.py`); the document has both. Latency is from just before
`publish` in the source to reception by DDS on the CEDDP. A sample is lost if it neither arrived until four seconds
after the end nor was withheld by arpd. The watchdog is systemd's, with the periods of the units.
"""

from __future__ import annotations

import os
import random
import sys
import time
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from arpd.model.errors import ArpdError
from scripts.bench.child import ChildError
from scripts.bench.overhead import FAST, QUICK, SLOW, Times, with_logs
from scripts.bench.overhead_cases import case_of
from scripts.bench.overhead_robot import OverheadError, Robot
from scripts.bench.overhead_sides import AFTER, Side
from scripts.bench.overhead_targets import DEMO_TOPICS, cpu, spans_of
from scripts.bench.pi_boards import CORES, MEMORY_BYTES, PI_4_MIPS, PI_4_S, PI_5_MIPS, SOURCES, THIS, boards, reference
from scripts.bench.pi_cgroup import SlowComputer, available
from scripts.bench.pi_watchdog import Watchdogs
from scripts.bench.record import conditions, keep, options_of
from scripts.bench.report import Target, about, milli, paragraphs, percent, shown, spread, table
from scripts.netns.simlink import SimLink

if TYPE_CHECKING:
    from collections.abc import Callable

    from scripts.bench.overhead_targets import Run
    from scripts.bench.pi_boards import Board
    from scripts.bench.report import Column, Form

SIZES = (DEMO_TOPICS, 50, 100)
NAMES = ("pi4", "pi5", "none")
_WATCHDOG_S = {"run": 10.0, "relay0": 20.0}  # WatchdogSec of systemd/arpd.service and arpd-relay.service
_DRAIN_S = 4.0


def measure(topics: int, board: Board, times: Times, workdir: Path, show: Callable[[str], None]) -> dict[str, Any]:
    """Return the figures of one robot on one board; a run that fails keeps what it found before."""
    began_s = time.monotonic()
    found: dict[str, Any] = {"topics": topics, "board": board.name, "spans": []}
    try:
        with (
            SlowComputer(board, f"arpd-pi-{os.getpid()}") as slow,
            Watchdogs(workdir, _WATCHDOG_S) as watchdogs,
            SimLink(f"pi-{os.getpid()}", rate_bytes_per_second=FAST) as link,
            ExitStack() as stack,
        ):
            show("starting")
            robot = Robot(
                case_of(topics),
                Side(name=AFTER),
                link,
                workdir,
                stack,
                sink_role="taker",
                placed=slow.place,
                environment=watchdogs.environment,
            )
            _play(robot, slow, times, found, show)
            found["watchdog"] = watchdogs.report()
    except (ArpdError, ChildError) as error:
        found["failed"] = str(error)
    return {**found, "took_s": time.monotonic() - began_s}


def _play(robot: Robot, slow: SlowComputer, times: Times, found: dict[str, Any], show: Callable[[str], None]) -> None:
    robot.await_carried()
    robot.start_control()
    found |= robot.found()
    time.sleep(2 * times.settle_s)
    before = _ticks(robot)
    show("publishing")
    robot.publish()
    found |= robot.settled()
    time.sleep(2 * times.settle_s)
    found["spans"].append(_span(robot, slow, "load", times.span_s))
    show("20 to 5 Mbit/s")
    found["fall"] = robot.react(SLOW, times.quiet_s)
    time.sleep(times.settle_s)
    found["spans"].append(_span(robot, slow, "paced", times.span_s))
    supply = robot.source.ask()
    found["ticks"] = {key: value - before[key] for key, value in _ticks(robot).items()}
    found["samples"] = {"expected": supply["expected"], **_fate(robot)}


def _span(robot: Robot, slow: SlowComputer, phase: str, for_s: float) -> dict[str, Any]:
    """Measure for a while, with the ages of the samples that arrive meanwhile, and the periods without a core."""
    robot.sink.ask(ages=True)
    before, began_s = slow.throttled(), time.monotonic()
    span = robot.measure(phase, for_s)
    after, lasted_s = slow.throttled(), time.monotonic() - began_s
    ages_s = robot.sink.ask(ages=True)["ages_s"]
    if not ages_s:
        raise OverheadError(f"{phase}: no sample arrived")
    return {
        **span,
        "latency_s": {f"p{share}": ages_s[share * len(ages_s) // 100] for share in (50, 99)},
        "throttled_share": {
            name: busiest(before[name], counts) * slow.board.quota()[1] * 1e-6 / lasted_s
            for name, counts in after.items()
        },
    }


def busiest(before: dict[int, int], after: dict[int, int]) -> int:
    """Return the most that a count of any thread has grown."""
    return max((count - before.get(thread, 0) for thread, count in after.items()), default=0)


def _ticks(robot: Robot) -> dict[str, int]:
    status = robot.status()
    if status is None:
        raise OverheadError("arpd run does not answer")
    return {key: status["totals"][key] for key in ("ticks", "ticks_late")}


def _fate(robot: Robot) -> dict[str, int]:
    """Stop the sources, and return what became of all samples from the robot."""
    sent = robot.source.ask(publish=False)["sent"]
    time.sleep(_DRAIN_S)
    status = robot.status()
    if status is None:
        raise OverheadError("arpd run does not answer")
    names = {topic.link_name for topic in robot.case.sensing}
    withheld = sum(topic["withheld"] for topic in status["topics"] if topic["topic"] in names)
    return {"sent": sent, "withheld": withheld, "received": robot.sink.ask(ages=True)["received"]}


def judge(document: dict[str, Any], topics: int, board: str) -> list[Target]:
    """Return what has to hold with so many topics on a board, over the runs that did not fail."""
    runs = _runs(document, topics, board)
    ticks = [run["ticks"]["ticks_late"] / max(1, run["ticks"]["ticks"]) for run in runs]
    lost = median(map(_lost, runs))
    beside = [_lost(run) for run in _runs(document, topics, THIS.name)]
    prices = [run["fall"]["price_s"] for run in runs]
    published = [run["samples"]["sent"] / max(1.0, run["samples"]["expected"]) for run in runs]
    restarts = [sum(each["restarts"] for each in run["watchdog"].values()) for run in runs]
    return [
        Target(
            "publishers confirmed", min(run.get("confirmed", 0) for run in runs) / topics, 1.0, "{:.0%}", at_least=True
        ),
        Target("late ticks", median(ticks), 0.01, "{:.1%}"),
        Target("more lost than without a quota", lost - (median(beside) if beside else 0.0), 0.001, "{:.2%}"),
        Target("samples published of those due", min(published), 0.95, "{:.0%}", at_least=True),
        Target("price after 20 → 5 Mbit/s", None if None in prices else max(prices), 0.5, "{:.2f} s"),
        Target("restarts by the watchdog", sum(restarts), 0),
    ]


def sizes(document: dict[str, Any]) -> str:
    """Return the table of sizes: what does not hold with how many topics on which board."""

    def cell(topics: int, board: str) -> str:
        if failed := [run["failed"] for run in _runs(document, topics, board, failed=True)]:
            return f"failed: {failed[0]}"
        if not _runs(document, topics, board):
            return ""
        missed = [each for each in judge(document, topics, board) if not each.is_met]
        return "; ".join(f"{each.what}: {shown(each.value, each.form)}" for each in missed) or "holds"

    names = [board["name"] for board in document["boards"]]
    numbers = sorted({run["topics"] for run in document["runs"]})
    return table(numbers, ("topics", str), *((name, partial(cell, board=name)) for name in names))


def report(document: dict[str, Any]) -> str:
    cells = [
        (topics, board, runs)
        for topics in sorted({run["topics"] for run in document["runs"]})
        for board in document["boards"]
        if (runs := _runs(document, topics, board["name"]))
    ]

    def column(head: str, figure: Callable[[Run], float | None], form: Form) -> Column:
        return head, lambda cell: spread(map(figure, cell[2]), form)

    def of_core(name: str) -> Callable[[tuple[int, dict[str, Any], list[Run]]], str]:
        """Return the CPU of a program while everything is carried, in parts of a core of the board."""
        return lambda cell: spread(
            [cpu(span, name) / (cell[1]["share"] or 1.0) for span in spans_of(cell[2], "load")], percent
        )

    def throttled(name: str) -> Callable[[tuple[int, dict[str, Any], list[Run]]], str]:
        return lambda cell: spread(
            [span["throttled_share"][name] for span in spans_of(cell[2], "load") if cell[1]["share"]], percent
        )

    def latency(phase: str, share: str) -> Callable[[Run], float]:
        return lambda run: float(spans_of([run], phase)[0]["latency_s"][share])

    targets = [
        f"{each.what} {each.bound}" for topics, board, _ in cells[:1] for each in judge(document, topics, board["name"])
    ]
    rounds = max(run["round"] for run in document["runs"]) + 1
    boards = ", ".join(f"{each['name']} {each['share']:.2f}" for each in document["boards"] if each["share"])
    return paragraphs(
        about(
            document,
            f"Rounds: {rounds}; median (worst). Each thread of the robot's side has a quota that makes a core of this "
            f"machine as slow as one of the board ({boards}), all threads have {document['cores']} such cores and "
            f"{document['memory_bytes'] / 2**20:.0f} MiB. A benchmark in pure Python takes {PI_4_S:.1f} s on a Pi 4, "
            f"{min(document['reference_s'].values()):.1f} s here; a Pi 5 is {PI_5_MIPS / PI_4_MIPS:.2f} times as fast",
        ),
        table(
            cells,
            ("topics", 0),
            ("board", lambda cell: cell[1]["name"]),
            column("price s", lambda run: run["fall"]["price_s"], "{:.2f}"),
            column("plan s", lambda run: run["fall"]["plan_s"], "{:.1f}"),
            column("confirmed s", lambda run: run["fall"]["confirmed_s"], "{:.1f}"),
            column("lost %", _lost, lambda share: f"{100 * share:.2f}"),
            column("latency ms, p50", latency("load", "p50"), milli),
            column("p99", latency("load", "p99"), milli),
            column("p99 paced", latency("paced", "p99"), milli),
            ("run CPU %", of_core("run")),
            ("relay CPU %", of_core("relay")),
            ("run slowed %", throttled("run")),
            ("relay slowed %", throttled("relay0")),
            ("silence s", lambda cell: max(map(_silence_s, cell[2])), "{:.1f}"),
        ),
        "Price, plan and confirmed: seconds from the change of the link, 20 → 5 Mbit/s. Latency: from the source to "
        "the CEDDP; paced: at 5 Mbit/s. CPU while everything is carried, of one core of the board. Slowed: periods of "
        "that time in which the busiest thread used up its core. Silence: the longest between two signs for the "
        "watchdog, which restarts run after 10 s and the relay after 20 s. A thread may use its quota of a period at "
        "once, so latency on a real Pi is some milliseconds longer. Caches and memory are this machine's.",
        f"What misses its target ({', '.join(targets)}):",
        sizes(document),
    )


def _runs(document: dict[str, Any], topics: int, board: str, *, failed: bool = False) -> list[Run]:
    """Return the runs of a cell that failed, or those that did not."""
    return [
        run for run in document["runs"] if (run["topics"], run["board"], "failed" in run) == (topics, board, failed)
    ]


def _lost(run: Run) -> float:
    """Return the share of the samples that neither arrived nor were withheld."""
    samples = run["samples"]
    kept: float = (samples["received"] + samples["withheld"]) / max(1, samples["sent"])
    return max(0.0, 1.0 - kept)


def _silence_s(run: Run) -> float:
    longest: float = max(each["longest_s"] for each in run["watchdog"].values())
    return longest


def main() -> None:
    parser = options_of(__doc__, "pi", quick="twelve topics, once, on a Pi 4 and on this machine: two minutes")
    parser.add_argument("--only", type=int, nargs="+", choices=SIZES, metavar="N", help=f"topics (default {SIZES})")
    parser.add_argument("--boards", nargs="+", choices=NAMES, metavar="NAME", help=f"default {' '.join(NAMES)}")
    parser.add_argument("--rounds", type=int, default=2, metavar="N", help="runs of each (default 2)")
    parser.add_argument("--seed", type=int, default=1, help="another order")
    options = parser.parse_args()
    can, why = available()
    if not can:
        sys.exit(why)
    noted, here_s = conditions(), reference()
    known = boards(min(here_s.values()))
    times, rounds = (QUICK, 1) if options.quick else (Times(), options.rounds)
    chosen = [known[name] for name in options.boards or (("pi4", "none") if options.quick else NAMES)]
    sizes: list[int] = options.only or ([DEMO_TOPICS] if options.quick else list(SIZES))
    cells = [(topics, board) for topics in sizes for board in chosen]
    draw, runs = random.Random(options.seed), list[dict[str, Any]]()
    with progress("measuring", total=rounds * len(cells)) as shown:
        for number in range(rounds):
            for topics, board in draw.sample(cells, len(cells)):
                name = f"{topics} topics, {board.name}, round {number + 1}"

                def show(what: str, name: str = name) -> None:
                    shown.reach(len(runs), f"{name}: {what}")

                work = partial(measure, topics, board, times, show=show)
                runs.append({"round": number, **with_logs("pi", work)})
                said = f"; failed: {runs[-1]['failed']}" if "failed" in runs[-1] else ""
                print(f"{name}: {runs[-1]['took_s']:.0f} s{said}", flush=True)
    document = {
        "conditions": noted,
        "reference_s": here_s,
        "sources": SOURCES,
        "boards": [
            {**asdict(board), **({"quota_us": board.quota()} if board.share is not None else {})} for board in chosen
        ],
        "cores": CORES,
        "memory_bytes": MEMORY_BYTES,
        "rates_bytes_per_second": {"fast": FAST, "slow": SLOW},
        "runs": runs,
    }
    keep(document, options, "pi", is_partial=options.quick or bool(options.only) or bool(options.boards))
    print(report(document))
    if any("failed" in run for run in runs):
        sys.exit(1)


if __name__ == "__main__":
    main()
