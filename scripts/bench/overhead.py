"""Measure what arpd itself costs: CPU, memory, bytes on the link, and the time of a new plan, by number of topics.

Usage: .venv/bin/python scripts/bench/overhead.py [--quick] [--only N …] [--seed N] [--json FILE]

Needs root, as the simulated link does.

Each number of topics has a robot of its own: one process has all sources, and `arpd relay` carries them to one reader
on the other host. It runs first without `arpd run` and `arpd peer`, then with them: at rest (the sources publish
nothing), at a rate of the link that carries everything, and at one that does not, so that pacing must act. Twelve
topics have the sizes, rates and preferences of the demo robot; otherwise all topics are alike.

CPU is the scheduler's account of all threads; nothing asks for the status page while it is measured. The kernel counts
bytes per flow, and the ports of the processes attribute them. Reaction times begin when the link's token bucket
changes; a subscriber times the gate, and arpd's decision log times plan and confirmation.
"""

from __future__ import annotations

import os
import random
import shutil
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from arpd.model.errors import ArpdError
from scripts.bench.child import ChildError
from scripts.bench.overhead_cases import DEMO_TOPICS, SYNTHETIC, Case, case_of
from scripts.bench.overhead_report import markdown
from scripts.bench.overhead_robot import OverheadError, Robot
from scripts.bench.record import conditions, keep, options_of
from scripts.netns.simlink import SimLink

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.cli.progress import Progress

FAST, SLOW = 20e6 / 8, 5e6 / 8
_LEAST_REACHED = 0.9  # of what the sources should have published


@dataclass(frozen=True, kw_only=True, slots=True)
class Times:
    """Durations of the parts of a run.

    Parameters
    ----------
    span_s : one measurement of CPU and bytes; the single one at rest takes twice as long (s)
    settle_s : pause after a change (s)
    quiet_s : time without a new plan that ends a reaction (s)
    rounds : number of falls and rises of the link; 0 = it falls once, without reaction times
    """

    span_s: float = 10.0
    settle_s: float = 4.0
    quiet_s: float = 4.0
    rounds: int = 2


QUICK = Times(span_s=2.5, settle_s=1.0, rounds=0)


def measure(case: Case, times: Times, workdir: Path, show: Callable[[str], None]) -> dict[str, Any]:
    """Return what arpd costs with one robot."""
    spans: list[dict[str, Any]] = []
    reactions: list[dict[str, Any]] = []
    run_id = f"overhead-{os.getpid()}-{len(case.topics)}"
    with SimLink(run_id, rate_bytes_per_second=FAST) as link, ExitStack() as stack:
        robot = Robot(case, link, workdir, stack)
        show("starting")
        robot.await_carried()
        time.sleep(times.settle_s)
        show("at rest, without arpd run and peer")
        spans.append(robot.measure("rest without", times.span_s))
        robot.start_control()
        robot.await_crossing()
        time.sleep(2 * times.settle_s)  # the first trains of probes are over
        show("at rest")
        spans.append(robot.measure("rest", 2 * times.span_s))
        robot.publish()
        show("publishing")
        settled_s = robot.settled_s()
        time.sleep(times.settle_s)
        rounds = 0 if settled_s is None else times.rounds
        if not rounds:
            spans.append(robot.measure("load", times.span_s))
            link.set_rate(SLOW)
            time.sleep(times.settle_s)
            spans.append(robot.measure("paced", times.span_s))
        for number in range(rounds):
            for phase, rate in (("paced", SLOW), ("load", FAST)):
                show(f"{link.rate_bytes_per_second * 8e-6:.0f} to {rate * 8e-6:.0f} Mbit/s, round {number + 1}")
                reactions.append(robot.react(rate, times.quiet_s))
                time.sleep(times.settle_s)
                spans.append(robot.measure(phase, times.span_s))
    return {
        "topics": len(case.topics),
        "relays": len(case.relays()),
        "offered_hz": case.offered_hz,
        "offered_bytes_per_second": case.offered_bytes_per_second,
        "least_payload_bytes": min(topic.payload_bytes for topic in case.topics),
        "most_payload_bytes": max(topic.payload_bytes for topic in case.topics),
        "settled_s": settled_s,
        "spans": spans,
        "reactions": reactions,
    }


def _telling(shown: Progress, number: int, topics: int) -> Callable[[str], None]:
    return lambda what: shown.reach(number, f"{topics} topics: {what}")


def check(found: dict[str, Any]) -> None:
    """Refuse nonsense: sources below their rate, a bypassed link, idle processes.

    Raises
    ------
    OverheadError
        If a figure cannot be true.
    """
    for span in found["spans"]:
        where = f"{found['topics']} topics, {span['phase']}"
        is_busy = not span["phase"].startswith("rest")
        if any(share <= 0.0 for share in span["cpu_share"].values()):
            raise OverheadError(f"{where}: a process used no CPU at all: {span['cpu_share']}")
        if is_busy and span["sent"] < _LEAST_REACHED * span["expected"]:
            raise OverheadError(f"{where}: {span['sent']} of {span['expected']:.0f} samples were published")
        # Without run, nothing counts what was published.
        published, carried = span.get("published_bytes_per_second", 0.0), span["interface_bytes_per_second"]
        if is_busy and published <= 0:
            raise OverheadError(
                f"{where}: what publishers announce to have published changed by {published:.0f} bytes/s while "
                f"{carried:.0f} were on the link; the daemon lost sight of publishers, or nothing was published"
            )
        if is_busy and published >= 1.1 * carried:
            raise OverheadError(
                f"{where}: {published:.0f} bytes/s published and {carried:.0f} on the link: it was bypassed"
            )
        if span["phase"] != "rest without" and not sum(span["control_bytes_per_second"].values()):
            raise OverheadError(f"{where}: no byte of arpd's own on the link")
    is_paced = any(span["phase"] == "paced" and span["withheld"] for span in found["spans"])
    if found["settled_s"] is not None and not is_paced:
        raise OverheadError(f"{found['topics']} topics: pacing had nothing to do")


def main() -> None:
    parser = options_of(__doc__, "overhead", quick="twelve topics, without reaction times: half a minute")
    sizes = sorted([*SYNTHETIC, DEMO_TOPICS])
    parser.add_argument("--only", type=int, nargs="+", choices=sizes, metavar="N", help=f"numbers of topics ({sizes})")
    parser.add_argument("--rounds", type=int, default=2, metavar="N", help="times the link falls and rises (default 2)")
    parser.add_argument("--seed", type=int, default=1, help="another order of the numbers of topics")
    options = parser.parse_args()
    chosen: list[int] = options.only or ([DEMO_TOPICS] if options.quick else sizes)
    document: dict[str, Any] = {
        "conditions": conditions(),
        "rates_bytes_per_second": {"fast": FAST, "slow": SLOW},
        "cases": [],
        "failures": [],
    }
    order = random.Random(options.seed).sample(chosen, len(chosen))
    with progress("measuring", total=len(order)) as shown:
        for number, topics in enumerate(order):
            workdir = Path(tempfile.mkdtemp(prefix=f"arpd-overhead-{topics}-"))
            began_s = time.monotonic()
            try:
                found = measure(
                    case_of(topics),
                    QUICK if options.quick else Times(rounds=options.rounds),
                    workdir,
                    _telling(shown, number, topics),
                )
                check(found)
            except (ArpdError, ChildError) as error:
                print(f"overhead: {topics} topics: {error}; logs in {workdir}", file=sys.stderr, flush=True)
                document["failures"].append({"topics": topics, "why": str(error)})
                continue
            shutil.rmtree(workdir)
            print(f"{topics} topics in {time.monotonic() - began_s:.0f} s", flush=True)
            document["cases"].append(found)
            document["cases"].sort(key=lambda case: case["topics"])
    if document["cases"]:
        print(markdown(document))
    keep(document, options, "overhead", is_partial=options.quick or bool(options.only))
    if document["failures"]:
        sys.exit(1)


if __name__ == "__main__":
    main()
