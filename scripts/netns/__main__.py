"""Run commands on two hosts, `robot` and `base`, joined by one slow link inside this machine.

The hosts are network namespaces joined by a veth pair. Each direction passes a token bucket (--rate) behind a queue of
256 kB, as a Wi-Fi driver has; --loss drops packets where they arrive. In both hosts Fast DDS uses UDP only, so that
ROS 2 traffic crosses the link instead of shared memory. Without root, the link lives in a user namespace, if the system
allows it.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from typing import TYPE_CHECKING, Any

from arpd.cli.options import within
from arpd.model.errors import ArpdError
from arpd.sim.schedule import RateSchedule
from scripts.netns.namespaces import HOST_NAMES
from scripts.netns.simlink import OUTER_PID, SimLink, usable_link

if TYPE_CHECKING:
    import subprocess

EPILOG = r"""
examples:
  scripts/simlink
      keep a 20 Mbit/s link until Ctrl-C and show the commands that enter the hosts
  scripts/simlink --rate 0:20mbit,20:5mbit,50:20mbit --duration 70 \
      --robot '.venv/bin/arpd run' --base '.venv/bin/arpd peer'
      run two commands over a link that narrows and recovers

Commands run in arpd's folder. Exit code: 0; the code of the first command that fails, which also ends the other one;
2 usage; 130 on Ctrl-C while commands run.
"""
POLL_S = 0.02


def main() -> int:
    options = parse_arguments()
    # A shell starts `simlink &` with SIGINT ignored, which the commands inside would inherit.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    schedule: RateSchedule = options.rate
    usable, reason = usable_link("scripts.netns", sys.argv[1:])
    if not usable:
        say(f"error: {reason}")
        return 1
    link = SimLink(
        f"cli-{os.getpid()}",
        rate_bytes_per_second=schedule.rate_at(0.0),
        loss=options.loss,
        bottleneck=options.bottleneck,
    )
    commands: dict[str, subprocess.Popen[Any]] = {}
    try:
        with link:
            for host in HOST_NAMES:
                if text := getattr(options, host):
                    commands[host] = link.popen(host, ["bash", "-c", text])
            if not commands:
                say_how_to_enter(link)
            code = play(link, schedule, commands, options.duration)
            for name, counters in link.counters().items():
                say(f"{name} received {counters.rx_bytes} bytes in {counters.rx_packets} packets")
    except ArpdError as error:
        say(f"error: {error}")
        return error.exit_code
    except KeyboardInterrupt:
        return 130 if commands else 0
    return code


def play(
    link: SimLink, schedule: RateSchedule, commands: dict[str, subprocess.Popen[Any]], duration_s: float | None
) -> int:
    """Follow the schedule until the commands have ended, one has failed, or the time is up."""
    start_s = time.monotonic()
    while True:
        elapsed_s = time.monotonic() - start_s
        rate = schedule.rate_at(elapsed_s)
        if rate != link.rate_bytes_per_second:
            link.set_rate(rate)
            say(f"{elapsed_s:.1f} s: {rate * 8e-6:g} Mbit/s")
        for name, process in commands.items():
            if process.poll():
                code = process.returncode if process.returncode > 0 else 128 - process.returncode
                say(f"the command on {name} failed with exit code {code}")
                return code
        if commands and all(process.poll() == 0 for process in commands.values()):
            return 0
        if duration_s is not None and elapsed_s >= duration_s:
            return 0
        time.sleep(POLL_S)


def say_how_to_enter(link: SimLink) -> None:
    say(f"the link is up at {link.rate_bytes_per_second * 8e-6:g} Mbit/s; Ctrl-C removes it. Enter a host with:")
    outer_pid = os.environ.get(OUTER_PID)
    prefix = "sudo "
    if outer_pid is not None:
        prefix = f"nsenter -t $(pgrep -P {outer_pid}) --user --mount --net --pid --preserve-credentials "
    environment = " ".join(f"{name}={value}" for name, value in link.ros_environment().items())
    for host in link.hosts:
        say(f"  {prefix}ip netns exec {host.namespace} env {environment} bash    # {host.address}")


def say(text: str) -> None:
    print(f"simlink: {text}", file=sys.stderr, flush=True)


def rate_over_time(text: str) -> RateSchedule:
    try:
        return RateSchedule.parse(text if ":" in text else f"0:{text}")
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="scripts/simlink", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--rate",
        type=rate_over_time,
        default="20mbit",
        help="of each direction, constant or over time (S:RATE,...; the last one holds); default %(default)s",
    )
    share = within(0.0, 1.0, parse=float)
    parser.add_argument("--loss", type=share, default=0.0, metavar="P", help="packet loss, 0..1 (default 0)")
    parser.add_argument("--bottleneck", choices=("sender", "middle"), default="sender", help="default %(default)s")
    parser.add_argument("--robot", metavar="CMD", help="command for the robot (bash -c)")
    parser.add_argument("--base", metavar="CMD", help="command for the base computer (bash -c)")
    parser.add_argument("--duration", type=float, metavar="S", help="end everything after S seconds, without a failure")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
