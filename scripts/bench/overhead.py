"""Measure what arpd itself costs, by number of topics: CPU, memory, bytes on the link, and what a plan costs.

Usage: .venv/bin/python scripts/bench/overhead.py [--quick] [--before REV] [--only N …] [--rounds N]
       [--flap-minutes N] [--flap-topics N] [--json FILE]

Needs root, as the simulated link does. Three rounds take 25 minutes; with --before, about 40.

With --before, each robot runs once with arpd of that revision and once with arpd of this tree, by turns in every
round. Each has processes of its own: one has all sources, relays carry 250 topics each to one reader on the other host,
and `arpd run` and `arpd peer` join. They are measured at rest (the sources publish nothing), at a rate of the link that
carries everything, and at one that does not, so that pacing must act. Twelve topics have the sizes, rates and
preferences of the demo robot; otherwise all topics are alike. A run that fails is a figure too, with its reason; the
older arpd does not try that number of topics again.

CPU is the scheduler's account of all threads; nothing asks for the status page while it is measured. The kernel counts
bytes per flow, and the ports of the processes attribute them. Reaction times begin when the link's token bucket
changes; a subscriber times the price, and arpd's decision log times plan and confirmation. A plan's discovery is what
the kernel counts from its cause until a while after it, less what was there before.
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
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from arpd.model.errors import ArpdError
from scripts.bench.child import ChildError
from scripts.bench.overhead_cases import case_of
from scripts.bench.overhead_robot import Robot
from scripts.bench.overhead_sides import AFTER, BEFORE, Side, side_of
from scripts.bench.overhead_targets import (
    CONTROL,
    DEMO_TOPICS,
    PHASES,
    bytes_for_all,
    control,
    cpu,
    discovery_bytes,
    judge,
    runs_of,
    spans_of,
    went_wrong,
)
from scripts.bench.record import conditions, keep, options_of
from scripts.bench.report import NEVER, about, kilo, mbit, mib, paragraphs, percent, shown, spread, table, targets
from scripts.netns.simlink import SimLink

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from scripts.bench.overhead_cases import Case
    from scripts.bench.overhead_targets import Run, Span
    from scripts.bench.report import Column, Form

FAST, SLOW = 20e6 / 8, 5e6 / 8
SIZES = (DEMO_TOPICS, 100, 500, 1000)
_LEAST_REACHED = 0.9  # of what the sources should have published


@dataclass(frozen=True, kw_only=True, slots=True)
class Times:
    """Durations of the parts of a run.

    Parameters
    ----------
    span_s : one measurement of CPU and bytes (s)
    settle_s : pause after a change (s)
    quiet_s : time without a new plan that ends a reaction (s)
    """

    span_s: float = 8.0
    settle_s: float = 4.0
    quiet_s: float = 3.0


QUICK = Times(span_s=2.5, settle_s=1.5, quiet_s=2.0)


def measure(
    case: Case, side: Side, times: Times, workdir: Path, show: Callable[[str], None], *, steady_s: float = 0.0
) -> dict[str, Any]:
    """Return what arpd costs with one robot; a run that fails keeps what it found before.

    Parameters
    ----------
    steady_s : time at the slow rate in which nothing should change, once the swaps of the fall are over (s)
    """
    began_s = time.monotonic()
    spans: list[dict[str, Any]] = []
    plans: list[dict[str, Any]] = []
    found: dict[str, Any] = {
        "side": side.name,
        "topics": len(case.topics),
        "relays": len(case.relays()),
        "offered_hz": case.offered_hz,
        "offered_bytes_per_second": case.offered_bytes_per_second,
        "least_payload_bytes": min(topic.payload_bytes for topic in case.topics),
        "most_payload_bytes": max(topic.payload_bytes for topic in case.topics),
        "spans": spans,
        "plans": plans,
    }
    try:
        with SimLink(f"overhead-{os.getpid()}", rate_bytes_per_second=FAST) as link, ExitStack() as stack:
            show("starting")
            robot = Robot(case, side, link, workdir, stack)
            robot.await_carried()
            robot.start_control()
            found |= robot.found()
            time.sleep(2 * times.settle_s)  # the first trains of probes are over
            show("at rest")
            spans.append(robot.measure("rest", times.span_s))
            show("publishing")
            plans.append({"cause": "start", **robot.planning(lambda: _begin(robot), times.settle_s)})
            found |= {key: plans[0][key] for key in plans[0] if key.startswith(("planned", "confirmed"))}
            time.sleep(times.settle_s)  # the trains of probes that follow a first plan are over
            spans.append(robot.measure("load", times.span_s))
            show("20 to 5 Mbit/s")
            plans.append({"cause": "fall", **robot.planning(lambda: robot.react(SLOW, times.quiet_s), times.settle_s)})
            spans.append(robot.measure("paced", times.span_s))
            if steady_s:
                show(f"{steady_s / 60:.0f} minutes in which nothing changes")
                found["steady"] = robot.steady(steady_s)
    except (ArpdError, ChildError) as error:
        found["failed"] = str(error)
    else:
        found["complaints"] = complaints(found)
    return {**found, "took_s": time.monotonic() - began_s}


def _begin(robot: Robot) -> dict[str, Any]:
    robot.publish()
    return robot.settled()


def complaints(found: dict[str, Any]) -> list[str]:
    """Name what cannot be true, or is no figure: sources below their rate, a bypassed link, idle processes."""
    wrong = []
    for span in found["spans"]:
        is_busy = span["phase"] != "rest"
        published, carried = span["published_bytes_per_second"], span["interface_bytes_per_second"]
        if any(share <= 0.0 for share in span["cpu_share"].values()):
            wrong.append(f"{span['phase']}: a process used no CPU at all: {span['cpu_share']}")
        if is_busy and span["sent"] < _LEAST_REACHED * span["expected"]:
            wrong.append(f"{span['phase']}: {span['sent']} of {span['expected']:.0f} samples were published")
        if is_busy and published <= 0:
            wrong.append(
                f"{span['phase']}: what publishers announce to have published changed by {published:.0f} bytes/s while "
                f"{carried:.0f} were on the link; the daemon lost sight of publishers, or nothing was published"
            )
        if is_busy and published >= 1.1 * carried:
            wrong.append(
                f"{span['phase']}: {published:.0f} bytes/s published and {carried:.0f} on the link: it was bypassed"
            )
        if not sum(span["control_bytes_per_second"].values()):
            wrong.append(f"{span['phase']}: no byte of arpd's own on the link")
    if not any(span["phase"] == "paced" and span["withheld"] for span in found["spans"]):
        wrong.append("pacing had nothing to do")
    return wrong


def play(sizes: Sequence[int], sides: Sequence[Side], times: Times, *, rounds: int, seed: int) -> list[dict[str, Any]]:
    """Run every number of topics on every side, by turns; return all runs."""
    draw, runs = random.Random(seed), list[dict[str, Any]]()
    with progress("measuring", total=rounds * len(sizes) * len(sides)) as shown:
        for number in range(rounds):
            for topics in draw.sample(sizes, len(sizes)):
                for side in draw.sample(sides, len(sides)):
                    if side.name == BEFORE and any(map(went_wrong, runs_of({"runs": runs}, BEFORE, topics))):
                        continue
                    name = f"{topics} topics, {side.name}, round {number + 1}"

                    def show(what: str, name: str = name) -> None:
                        shown.reach(len(runs), f"{name}: {what}")

                    runs.append({"round": number, **_run(case_of(topics), side, times, show)})
                    print(f"{name}: {_said(runs[-1])}", flush=True)
    return runs


def _run(case: Case, side: Side, times: Times, show: Callable[[str], None], *, steady_s: float = 0.0) -> dict[str, Any]:
    name = f"overhead-{len(case.topics)}-{side.name}"
    return with_logs(name, lambda workdir: measure(case, side, times, workdir, show, steady_s=steady_s))


def with_logs(name: str, run: Callable[[Path], dict[str, Any]]) -> dict[str, Any]:
    """Give a run a folder for its logs, and return what it found; the folder of a run that failed stays."""
    workdir = Path(tempfile.mkdtemp(prefix=f"arpd-{name}-"))
    found = run(workdir)
    if "failed" in found:
        print(f"{name}: {found['failed']}; logs in {workdir}", file=sys.stderr, flush=True)
    else:
        shutil.rmtree(workdir)
    return found


def _said(found: dict[str, Any]) -> str:
    why = [found["failed"]] if "failed" in found else found["complaints"]
    return "; failed: ".join([f"{found['took_s']:.0f} s", *why])


def report(document: dict[str, Any]) -> str:
    rates = document["rates_bytes_per_second"]
    first = {run["topics"]: run for run in reversed(document["runs"])}
    sizes = sorted(first)

    def both(topics: int, say: Callable[[list[Run]], str]) -> str:
        """Return what both sides have; one of which every run failed has nothing."""
        said = [say(runs) or NEVER for side in (BEFORE, AFTER) if (runs := runs_of(document, side, topics))]
        return " → ".join(said) if set(said) != {NEVER} else NEVER

    def cost(head: str, figure: Callable[[Span], float], form: Form) -> Column:
        return head, lambda row: both(
            row[0], lambda runs: spread([figure(span) for span in spans_of(runs, row[1])], form)
        )

    def memory(runs: list[Run], phase: str) -> str:
        sizes_of = [span["rss_bytes"] for span in spans_of(runs, phase)]
        kinds = (*CONTROL, "relay") if sizes_of else ()
        return ", ".join(
            mib(max(size for each in sizes_of for name, size in each.items() if name.startswith(kind)))
            for kind in kinds
        )

    def counted(what: str) -> Column:
        def of(runs: list[Run], topics: int) -> str:
            number = min(run.get(what, 0) for run in runs)
            after = spread([run.get(f"{what}_s") for run in runs], "{:.1f} s")
            return f"{number}, {after}" if number >= topics else str(number)

        return what, lambda topics: both(topics, lambda runs: of(runs, topics))

    def plan(head: str, figure: Callable[[Run, Any], float | None], form: Form, *causes: str) -> Column:
        return head, lambda topics: both(
            topics,
            lambda runs: spread(
                [figure(run, each) for run in runs for each in run["plans"] if each["cause"] in causes], form
            ),
        )

    every = ("start", "fall")
    before = f"{document['before'][:12]} → this tree, by turns; " if document["before"] else ""
    rounds = max(len(runs_of(document, AFTER, topics)) for topics in sizes)
    busy = [
        span for run in document["runs"] for span in run["spans"] if run["side"] == AFTER and span["phase"] != "rest"
    ]
    return paragraphs(
        about(
            document,
            f"{before}median (worst) of {rounds} rounds. 12 topics are the demo robot's, otherwise all are alike. CPU "
            "in percent of one core, all relays together; memory of the largest. Link bytes of run and peer, both "
            f"ways; the link has {mbit(rates['fast'])}, in *paced* {mbit(rates['slow'])} Mbit/s",
        ),
        table(
            product(sizes, PHASES),
            ("topics", lambda row: row[0] if row[1] == "rest" else ""),
            ("offered", lambda row: _offered(first[row[0]]) if row[1] == "rest" else ""),
            ("", lambda row: PHASES[row[1]]),
            *(cost(f"{name} CPU %", partial(_cpu, name), percent) for name in (*CONTROL, "relay")),
            ("run, peer, relay MiB", lambda row: both(row[0], lambda runs: memory(runs, row[1]))),
            cost("link kB/s", control, kilo),
            cost("% of link", lambda span: 100 * control(span) / span["link_bytes_per_second"], "{:.2f}"),
        ),
        "Publishers that arpd finds, plans and confirms in the worst run, and when all are (found: from the start of "
        "run and peer; the others: from the first message). Then the seconds from the change of the link, "
        f"{mbit(rates['fast'])} → {mbit(rates['slow'])} Mbit/s. Discovery of a plan: all of the link, and what one "
        "process of the robot receives; for all: by the bytes per swap, if every topic is swapped.",
        table(
            sizes,
            ("topics", str),
            *map(counted, ("found", "planned", "confirmed")),
            plan("price s", lambda _, each: each["price_s"], "{:.2f}", "fall"),
            plan("plan s", lambda _, each: each["plan_s"], "{:.1f}", "fall"),
            plan("confirmed s", lambda _, each: each["confirmed_s"], "{:.1f}", "fall"),
            plan("swaps", lambda _, each: float(each["swaps"]), "{:.0f}", *every),
            plan("discovery kB", discovery_bytes, kilo, *every),
            plan("to one process kB", partial(discovery_bytes, where="listener_bytes"), kilo, *every),
            ("kB for all", lambda topics: both(topics, lambda runs: shown(bytes_for_all(runs), kilo))),
        ),
        targets(judge(document)),
        f"In {len(busy)} spans under load in which nothing changed: {sum(span['plans'] for span in busy)} plans, "
        f"{sum(span['swaps'] for span in busy):.0f} swaps.",
        "\n".join(f"- {failure}" for failure in _failures(document)),
    )


def _cpu(name: str, span: Span) -> float:
    return cpu(span, name)


def _offered(run: Run) -> str:
    return f"{run['offered_hz']:.0f} Hz, {mbit(run['offered_bytes_per_second'])} Mbit/s"


def _failures(document: dict[str, Any]) -> list[str]:
    found = []
    for run in [*document["runs"], *filter(None, [document.get("steady")])]:
        why = [run["failed"]] if "failed" in run else run.get("complaints", ())
        found += [f"{run['topics']} topics, {run['side']}: failed: {each}." for each in why]
    return list(dict.fromkeys(found))


def main() -> None:
    parser = options_of(__doc__, "overhead", quick="twelve topics, once: 50 seconds for each side")
    parser.add_argument("--before", metavar="REV", help="revision whose arpd is measured too, by turns")
    parser.add_argument(
        "--only", type=int, nargs="+", choices=SIZES, metavar="N", help=f"numbers of topics (default {SIZES})"
    )
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="runs of each (default 3)")
    parser.add_argument("--seed", type=int, default=1, help="another order of the numbers of topics and sides")
    parser.add_argument("--flap-minutes", type=float, default=0.0, metavar="N", help="once: time without any change")
    parser.add_argument("--flap-topics", type=int, default=100, metavar="N", help="topics of that robot (default 100)")
    options = parser.parse_args()
    noted = conditions()
    times, rounds = (QUICK, 1) if options.quick else (Times(), options.rounds)
    sizes: list[int] = options.only or ([DEMO_TOPICS] if options.quick else list(SIZES))
    sides = [Side(name=AFTER)]
    with ExitStack() as stack:
        if options.before:
            try:
                sides.insert(0, stack.enter_context(side_of(options.before)))
            except ArpdError as error:
                sys.exit(str(error))
        runs = play(sizes, sides, times, rounds=rounds, seed=options.seed)
    steady = None
    if options.flap_minutes:
        with progress("waiting") as shown:
            case, side = case_of(options.flap_topics), Side(name=AFTER)
            steady = _run(case, side, times, shown.step, steady_s=60 * options.flap_minutes)
    document = {
        "conditions": noted,
        "before": options.before,
        "rates_bytes_per_second": {"fast": FAST, "slow": SLOW},
        "runs": runs,
        "steady": steady,
    }
    keep(document, options, "overhead", is_partial=options.quick or bool(options.only))
    print(report(document))
    if any(map(went_wrong, [run for run in runs if run["side"] == AFTER])):
        sys.exit(1)


if __name__ == "__main__":
    main()
