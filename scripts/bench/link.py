"""Run arpd on the real link, the demo robot over namespaces, veth and token buckets, and the same in virtual time.

Usage: .venv/bin/python scripts/bench/link.py [--quick] [--rounds N] [--only TEXT] [--json FILE] [--plot FILE]

Needs root, as the simulated link does.

In every scenario the link does one thing: it stays, drops, rises or is gone for five seconds. Runs with and without
arpd alternate, each with a robot of its own. Truth is rate and queue of the kernel's token bucket, read fifty times a
second. Beliefs are arpd's status page, read ten times a second: every reaction time is known to a tenth of a second and
includes the reading. The same schedule then runs in virtual time with the same configuration.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.adapters.config.load import load_settings
from arpd.adapters.sim.link import LinkModel
from arpd.cli.progress import progress
from arpd.daemon.scenario import run as simulate
from arpd.model.errors import ArpdError
from arpd.model.probing import PeerReport
from arpd.model.wire import probe_wire_bytes
from scripts.bench.link_course import SCENARIOS, Run, virtual_course, with_outages
from scripts.bench.link_figures import figures
from scripts.bench.link_report import draw, save, table
from scripts.bench.link_sampler import sampling
from scripts.bench.record import conditions, options_of, target
from scripts.netns.simlink import SimLink
from scripts.robot.manner import RCLPY_DEFAULTS, WITH_ARPD
from scripts.robot.run import CONFIG, HTTP_PORT, lost_during, robot, run

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from arpd.adapters.sim.result import TopicResult
    from scripts.bench.link_course import Instant, Scenario

QUICK = ("20→5", "outage")


def real(scenario: Scenario, *, is_managed: bool, number: int, logs: Path) -> Run:
    """Run the real robot over the real link."""
    run_id = f"link-{os.getpid()}-{time.monotonic_ns() % 10**6}"
    folder = logs / f"{scenario.name.replace(' ', '-')}-{number}-{'with' if is_managed else 'without'}"
    with (
        SimLink(run_id, rate_bytes_per_second=scenario.rates.rate_at(0.0)) as link,
        robot(link, folder, WITH_ARPD if is_managed else RCLPY_DEFAULTS) as side,
        sampling(
            link.robot,
            is_managed=is_managed,
            url=f"http://127.0.0.1:{HTTP_PORT}/api/v1/status",
            report_wire_bytes=report_wire_bytes(),
        ) as sampler,
    ):
        topics = run(
            side,
            scenario.rates,
            scenario.duration_s,
            on_tick=lambda _elapsed_s: None,
            loss_at=lost_during(scenario.outages),
        )
        course = with_outages(sampler.course(started_s=side.started_s, duration_s=scenario.duration_s), scenario)
    return _run(scenario, "real", number, course, topics, is_managed=is_managed)


@cache
def report_wire_bytes() -> int:
    """Return the wire size of a report with one delay and no train, as nearly all are (bytes)."""
    from arpd.adapters.ros.probe_messages import encode_report

    report = PeerReport(peer="ceddp", received_at_s=0.0, interval_s=0.1, rx_bytes=0, rx_packets=0, delays_s=(0.0,))
    return probe_wire_bytes(len(encode_report(report).data))


def virtual(scenario: Scenario, *, is_managed: bool, number: int) -> Run:
    """Run the same in virtual time, with the same configuration."""
    result = simulate(
        load_settings(CONFIG, interfaces=None),
        scenario.rates,
        scenario.duration_s,
        seed=number,
        managed=is_managed,
        model=LinkModel(outages=scenario.outages),
    )
    course = virtual_course(result.moments, scenario)
    return _run(scenario, "virtual", number, course, result.topics, is_managed=is_managed)


def _run(
    scenario: Scenario,
    side: str,
    number: int,
    course: Sequence[Instant],
    topics: Sequence[TopicResult],
    *,
    is_managed: bool,
) -> Run:
    return Run(
        scenario=scenario.name,
        side=side,
        is_managed=is_managed,
        round=number,
        course=tuple(course),
        topics=tuple(topics),
        figures=figures(course, scenario),
        load=os.getloadavg()[0],
    )


def measure(scenarios: Sequence[Scenario], rounds: int, logs: Path) -> Iterator[Run]:
    """Yield every run as it ends; runs with and without arpd take turns to go first."""
    started_s = time.monotonic()
    turns = [
        (number, scenario, is_managed)
        for number in range(1, rounds + 1)
        for position, scenario in enumerate(scenarios)
        for is_managed in ((True, False) if (number + position) % 2 else (False, True))
    ]
    with progress("measuring", total=len(turns)) as shown:
        for number, scenario, is_managed in turns:
            shown.step(f"{scenario.name}, {'with' if is_managed else 'without'} arpd, round {number}")
            try:
                done = real(scenario, is_managed=is_managed, number=number, logs=logs)
            except ArpdError as error:
                print(f"{scenario.name}, round {number}: {error}", file=sys.stderr, flush=True)
                continue
            print(f"{time.monotonic() - started_s:5.0f} s {line(done)}", flush=True)
            yield done
            yield virtual(scenario, is_managed=is_managed, number=number)


def line(done: Run) -> str:
    """Return a run's figures in a line."""
    found = " ".join(
        f"{name.removesuffix('_s')} {'never' if value is None else format(value, '.3g')}"
        for name, value in done.figures.items()
    )
    return f"{done.scenario:>10} {'with' if done.is_managed else 'without':>7} load {done.load:.1f}  {found}"


def main() -> None:
    parser = options_of(__doc__, "link", quick="a drop and an outage, once: four minutes", has_plot=True)
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="times each scenario runs (default 3)")
    parser.add_argument("--only", default="", metavar="TEXT", help="scenarios whose name contains this")
    parser.add_argument("--logs", type=Path, help="folder for the processes' logs (default: a temporary one)")
    options = parser.parse_args()
    scenarios = [s for s in SCENARIOS if options.only in s.name and (not options.quick or s.name in QUICK)]
    if not scenarios:
        parser.error(f"--only {options.only}: no such scenario; there are {', '.join(s.name for s in SCENARIOS)}")
    logs = options.logs or Path(tempfile.mkdtemp(prefix="arpd-link-"))
    print(f"logs in {logs}", flush=True)
    about, runs = {"conditions": conditions()}, list[Run]()
    is_partial = bool(options.quick or options.only)
    rounds = 1 if options.quick else options.rounds
    path = target(options.json, "link.json", is_partial=is_partial)
    plot = target(options.plot, "link.png", is_partial=is_partial)
    for done in measure(scenarios, rounds, logs):
        runs.append(done)
        if path:
            save(about, runs, path)
    if not runs:
        sys.exit("link: no run ended")
    print(table(scenarios, runs))
    if path:
        print(path)
    if plot:
        draw(scenarios, runs, plot)
    if len(runs) < 4 * len(scenarios) * rounds:
        sys.exit("link: not every run ended")


if __name__ == "__main__":
    main()
