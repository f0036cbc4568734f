"""Run the same robot over the same link twice, with rclpy's defaults and with arpd, and compare.

A planner on `base` reads eleven sensors on `robot` and sends commands back; the link between them drops and recovers
by schedule. Both hosts are network namespaces of this machine, the link is a real rate-limited veth pair, and every
process is the real one.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import socket
import subprocess
import sys
import tempfile
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live

from arpd.cli.progress import progress
from arpd.model.errors import ArpdError
from arpd.sim.schedule import RateSchedule
from scripts.netns.simlink import SimLink, available, user_namespace_argv
from scripts.robot.manner import RCLPY_DEFAULTS, WITH_TWO_ENDS
from scripts.robot.proxy import window
from scripts.robot.report import Pair, as_document, final_table, live_view, losses_text, pair_up, verdict
from scripts.robot.run import HTTP_PORT, DemoError, Side, play, robot, run

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

FULL = "0:20mbit,20:5mbit,50:20mbit"
QUICK = "0:20mbit,8:5mbit,26:20mbit"
_TAIL_S = {FULL: 20.0, QUICK: 12.0}
_NESTED = "ARPD_DEMO_NESTED"
_LISTENER = "ARPD_DEMO_LISTENER"
_LEGEND = (
    "loss: sent on the link and never received.  withheld: pacing chose a fresher sample instead.",
    "stalled: not published because publish() blocked.  age: of the newest sample at the reader, sampled at 20 Hz.",
    "In both runs the readers hold two seconds of each topic, and the sensors' writers ten samples.",
)


def parse(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="scripts/demo",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="examples:\n  scripts/demo\n  scripts/demo --quick --json\n  scripts/demo --serve\n"
        '  scripts/demo --schedule "0:10mbit,15:2mbit,40:10mbit"',
    )
    parser.add_argument("--quick", action="store_true", help="a shorter schedule: the whole demo in about two minutes")
    parser.add_argument("--schedule", help=f"rates of the link over time (default {FULL!r})")
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of tables")
    parser.add_argument("--serve", action="store_true", help="keep the robot with arpd running; print the metrics URL")
    parser.add_argument(
        "--simulated", action="store_true", help="use the built-in simulated link (virtual time, no ROS)"
    )
    parser.add_argument("--logs", type=Path, help="folder for the processes' logs (default: a temporary one)")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    arguments = sys.argv[1:] if argv is None else argv
    args = parse(arguments)
    console = Console(stderr=args.json)
    text = args.schedule or (QUICK if args.quick else FULL)
    try:
        schedule = RateSchedule.parse(text)
    except ValueError as error:
        console.print(f"--schedule: {error}")
        return 2
    duration_s = schedule.duration_s + _TAIL_S.get(text, 15.0)
    try:
        usable, reason = (False, "") if args.simulated else _namespaces(arguments, is_serving=args.serve)
        if args.serve and not usable:
            raise DemoError(f"--serve needs the real link ({reason or 'not the simulated one'})")
        if usable:
            logs = args.logs or Path(tempfile.mkdtemp(prefix="arpd-demo-"))
        if args.serve:
            serve(logs, schedule, duration_s, console)
            return 0
        if usable:
            console.print(f"logs in {logs}", highlight=False, soft_wrap=True)
            pairs = compare_for_real(logs, schedule, duration_s, console)
        else:
            why = f"no network namespaces here ({reason}): " if reason else ""
            console.print(f"{why}using the built-in simulated link, in virtual time", highlight=False, soft_wrap=True)
            pairs = compare_simulated(schedule, duration_s)
    except ArpdError as error:
        console.print(f"scripts/demo: {error}", style="red", highlight=False, soft_wrap=True)
        return error.exit_code
    except KeyboardInterrupt:
        return 130
    if args.json:
        print(json.dumps(as_document(pairs), indent=2))
    else:
        # A pipe has no width: rich would cut the table to 80 columns.
        wide = console if console.is_terminal else Console(width=160)
        wide.print(final_table(pairs))
        for sentence in (verdict(pairs)[1], *losses_text(pairs), *_LEGEND):
            console.print(sentence, soft_wrap=True, highlight=False)
    return 0


def compare_for_real(logs: Path, schedule: RateSchedule, duration_s: float, console: Console) -> list[Pair]:
    """Run both sides over the real link, one after the other."""
    results = []
    for is_managed in (False, True):
        name = "with arpd" if is_managed else "without arpd"
        with ExitStack() as stack:
            with progress(f"{name}: starting the robot"):
                side = stack.enter_context(_robot(logs, schedule, is_managed=is_managed))
            show = stack.enter_context(_watching(side, schedule, duration_s, name, console))
            results.append(run(side, schedule, duration_s, on_tick=show))
    return pair_up(*results)


def serve(logs: Path, schedule: RateSchedule, duration_s: float, console: Console) -> None:
    """Keep the robot with arpd running, the schedule repeating, until Ctrl-C."""

    def rate_at(elapsed_s: float) -> float:
        return schedule.rate_at(elapsed_s % duration_s)

    inherited = os.environ.get(_LISTENER)
    listener = socket.socket(fileno=int(inherited)) if inherited else _listen()
    with (
        suppress(KeyboardInterrupt),
        _robot(logs, schedule, is_managed=True) as side,
        window(side.link.robot, HTTP_PORT, listener=listener) as url,
    ):
        console.print(f"arpd is running; metrics: {url}/metrics   page: {url}/   Ctrl-C ends it", soft_wrap=True)
        play(side, rate_at, math.inf, on_tick=lambda _elapsed_s: None)


@contextmanager
def _robot(logs: Path, schedule: RateSchedule, *, is_managed: bool) -> Iterator[Side]:
    run_id = f"demo-{os.getpid()}-{int(is_managed)}"
    folder = logs / ("with" if is_managed else "without")
    with (
        SimLink(run_id, rate_bytes_per_second=schedule.rate_at(0.0)) as link,
        robot(link, folder, WITH_TWO_ENDS if is_managed else RCLPY_DEFAULTS) as side,
    ):
        yield side


def compare_simulated(schedule: RateSchedule, duration_s: float) -> list[Pair]:
    """Run both sides in virtual time."""
    from arpd.daemon.scenario import run as simulate
    from arpd.sim.demo import demo_settings

    sides = []
    with progress(f"simulating {duration_s:.0f} s", total=2) as shown:
        for is_managed in (False, True):
            shown.step("with arpd" if is_managed else "without arpd")
            sides.append(simulate(demo_settings(), schedule, duration_s, seed=1, managed=is_managed).topics)
    return pair_up(*sides)


@contextmanager
def _watching(
    side: Side, schedule: RateSchedule, duration_s: float, name: str, console: Console
) -> Iterator[Callable[[float], None]]:
    """Yield a function that shows the run: as a live table on a terminal, not at all in a pipe."""
    if not console.is_terminal:
        yield lambda _elapsed_s: None
        return
    with Live(console=console, auto_refresh=False, transient=True) as live:

        def show(elapsed_s: float) -> None:
            view = live_view(
                elapsed_s=elapsed_s,
                duration_s=duration_s,
                truth=schedule.rate_at(elapsed_s),
                side=name,
                status=side.status(),
                arrivals=side.arrivals,
            )
            live.update(view, refresh=True)

        yield show


def _listen() -> socket.socket:
    try:
        return socket.create_server(("127.0.0.1", HTTP_PORT))
    except OSError as error:
        raise DemoError(f"cannot listen on port {HTTP_PORT} ({error}); is another --serve running?") from error


def _namespaces(arguments: list[str], *, is_serving: bool) -> tuple[bool, str]:
    """Return whether namespaces work here, or why not; without root, restart as root of a user namespace first."""
    usable, reason = available()
    if usable or os.geteuid() == 0 or os.environ.get(_NESTED):
        return usable, reason
    if subprocess.run(user_namespace_argv(["true"]), capture_output=True, check=False).returncode == 0:
        command = user_namespace_argv([sys.executable, "-m", "scripts.robot.demo", *arguments])
        environment = {**os.environ, _NESTED: "1"}
        if is_serving:
            # A socket stays in the namespace that made it, so this one is reachable from outside.
            listener = _listen()
            listener.set_inheritable(True)
            environment[_LISTENER] = str(listener.fileno())
        os.execve(command[0], command, environment)
    return False, reason


if __name__ == "__main__":
    sys.exit(main())
