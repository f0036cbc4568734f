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
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from rich.console import Console

from arpd.cli.output import progress
from arpd.model.errors import ArpdError
from arpd.sim.result import TopicResult
from arpd.sim.schedule import RateSchedule
from scripts.bench.robots import demo_robot
from scripts.bench.sides import SIDES, Side
from scripts.bench.world import world_of
from scripts.netns.simlink import Bottleneck, usable_link
from scripts.robot.proxy import HTTP_PORT, window
from scripts.robot.report import Pair, as_document, final_table, pair_up, verdict

if TYPE_CHECKING:
    from scripts.bench.account import Account
    from scripts.bench.links import Course

FULL = "0:20mbit,20:5mbit,50:20mbit"
QUICK = "0:20mbit,8:5mbit,26:20mbit"
TAIL_S = {FULL: 20.0, QUICK: 12.0}
_LISTENER = "ARPD_DEMO_LISTENER"
_SHOW_S = 0.5
_LEGEND = (
    "loss: sent and never received.  withheld: pacing chose a fresher sample instead.",
    "stalled: not published because publish() blocked.  age: of the newest sample at the reader, sampled at 20 Hz.",
    "In both runs the readers hold two seconds of each topic, and the sensors' writers ten samples.",
)


class DemoError(ArpdError):
    """A part of the demo did not start, or the link was bypassed."""


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="scripts/demo",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="examples:\n  scripts/demo\n  scripts/demo --quick --json\n  scripts/demo --serve\n"
        '  scripts/demo --bottleneck middle --schedule "0:10mbit,15:2mbit,40:10mbit"',
    )
    parser.add_argument("--quick", action="store_true", help="a shorter schedule: the whole demo in about two minutes")
    parser.add_argument("--schedule", help=f"rates of the link over time (default {FULL!r})")
    about = "samples wait in the sender's own interface, as with Wi-Fi, or between the hosts; default %(default)s"
    parser.add_argument("--bottleneck", choices=get_args(Bottleneck), default="sender", help=about)
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of tables")
    parser.add_argument("--serve", action="store_true", help="keep the robot with arpd running; print the metrics URL")
    return parser.parse_args()


def main() -> int:
    args = parse()
    console = Console(stderr=args.json)
    text = args.schedule or (QUICK if args.quick else FULL)
    try:
        schedule = RateSchedule.parse(text)
    except ValueError as error:
        console.print(f"--schedule: {error}")
        return 2
    duration_s = schedule.duration_s + TAIL_S.get(text, 15.0)
    try:
        if args.serve:
            serve(schedule, duration_s, console, args.bottleneck)
            return 0
        _need_link()
        logs = Path(tempfile.mkdtemp(prefix="arpd-demo-"))
        console.print(f"logs in {logs}", highlight=False, soft_wrap=True)
        pairs = compare(logs, schedule, duration_s, args.bottleneck)
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
        for sentence in (verdict(pairs)[1], *_LEGEND):
            console.print(sentence, soft_wrap=True, highlight=False)
    return 0


def compare(logs: Path, schedule: RateSchedule, duration_s: float, bottleneck: Bottleneck = "sender") -> list[Pair]:
    """Run both sides over the real link, one after the other."""
    sides = (("plain", "without"), ("two_ends", "with"))
    return pair_up(*(_run(SIDES[side], logs / name, schedule, duration_s, bottleneck) for side, name in sides))


def _run(
    side: Side, logs: Path, schedule: RateSchedule, duration_s: float, bottleneck: Bottleneck
) -> list[TopicResult]:
    robot, course = demo_robot(), _course(schedule)
    with (
        progress(f"{logs.name} arpd", total=duration_s) as shown,
        world_of(robot, replace(side, warm_up_s=0.0), bottleneck=bottleneck, rate=course[0][1], logs=logs) as world,
    ):
        shown(0.0, "starting the robot")
        times_s = [k * _SHOW_S for k in range(int(duration_s / _SHOW_S))]
        events = [
            (at_s, partial(shown, at_s, f"the link carries {schedule.rate_at(at_s) * 8e-6:.1f} Mbit/s"))
            for at_s in times_s
        ]
        account, spent = world.play(course, duration_s, events=events)
    if spent["unmatched"] or spent["ended"]:
        raise DemoError(f"without a reader: {spent['unmatched']}; ended: {spent['ended']}; see {logs}")
    results = [_result(account, topic.name, topic.rate_hz) for topic in robot.topics]
    crossed = (spent["to_base_mbit"] + spent["to_robot_mbit"]) * duration_s / 8e-6
    delivered = sum(result.delivered_bytes for result in results)
    if crossed < 0.5 * delivered:
        raise DemoError(f"only {crossed:.0f} bytes crossed the link for {delivered} delivered: the link was bypassed")
    return results


def _course(schedule: RateSchedule) -> Course:
    return [(step.start_s, schedule.rate_at(step.start_s), 0.0) for step in schedule.steps]


def _result(account: Account, name: str, rate_hz: float) -> TopicResult:
    found, withheld = account.topics[name], account.withheld.get(name, 0)

    def seconds(milliseconds: float | None) -> float | None:
        return None if milliseconds is None else milliseconds * 1e-3

    return TopicResult(
        topic=name,
        source_rate_hz=rate_hz,
        expected=found["offered"],
        offered=found["published"],
        withheld=withheld,
        sent=found["published"] - withheld,
        received=found["delivered"],
        doubled=found["doubled"],
        reordered=found["out_of_order"],
        delivered_bytes=found["delivered"] * found["bytes"],
        latency_p50_s=seconds(found["p50_ms"]),
        latency_p99_s=seconds(found["p99_ms"]),
        latency_max_s=seconds(found["max_ms"]),
        age_p50_s=found["age_p50_s"],
        age_p99_s=found["age_p99_s"],
    )


def serve(schedule: RateSchedule, duration_s: float, console: Console, bottleneck: Bottleneck) -> None:
    """Keep the robot with arpd running, the schedule repeating, until Ctrl-C."""
    # A socket stays in the namespace that made it, so this one is reachable from outside a user namespace.
    inherited = os.environ.get(_LISTENER)
    listener = socket.socket(fileno=int(inherited)) if inherited else _listen()
    listener.set_inheritable(True)
    os.environ[_LISTENER] = str(listener.fileno())
    _need_link()
    logs = Path(tempfile.mkdtemp(prefix="arpd-demo-"))
    course, side = _course(schedule), replace(SIDES["two_ends"], warm_up_s=0.0)
    with (
        suppress(KeyboardInterrupt),
        world_of(demo_robot(), side, bottleneck=bottleneck, rate=course[0][1], logs=logs) as world,
        ExitStack() as stack,
        window(world.link.robot, HTTP_PORT, listener=listener) as url,
    ):
        world.start(stack)
        world.begin(math.inf)
        console.print(f"arpd is running; metrics: {url}/metrics   page: {url}/   Ctrl-C ends it", soft_wrap=True)
        while True:
            world.follow(course, time.monotonic(), duration_s)


def _need_link() -> None:
    usable, reason = usable_link("scripts.robot.demo", sys.argv[1:])
    if not usable:
        raise DemoError(f"no real link here ({reason}); in virtual time: arpd simulate --rate {FULL}")


def _listen() -> socket.socket:
    try:
        return socket.create_server(("127.0.0.1", HTTP_PORT))
    except OSError as error:
        raise DemoError(f"cannot listen on port {HTTP_PORT} ({error}); is another --serve running?") from error


if __name__ == "__main__":
    sys.exit(main())
