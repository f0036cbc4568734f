"""`arpd simulate`: arpd on a recorded link, beside the same robot without arpd and with an oracle."""

from __future__ import annotations

import json
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from arpd.cli.comparison import Asked, comparison_document, show_comparison
from arpd.cli.options import Command, add_config, add_json, config_of, within
from arpd.cli.progress import progress
from arpd.daemon.compare import compare
from arpd.host.config.load import load_settings
from arpd.model.errors import UsageError
from arpd.model.quantities import format_duration, parse_duration, parse_size, printable, spell_duration, spell_size
from arpd.sim.demo import demo_settings, demo_topics
from arpd.sim.link import LinkModel
from arpd.sim.robot import configured_topics
from arpd.sim.schedule import RateSchedule
from arpd.sim.trace import LinkTrace, read_trace

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from arpd.model.settings import Settings
    from arpd.sim.robot import SimTopic

_LEAST_S, _MOST_S = 20.0, 86_400.0  # the first 10 s are start-up
_DEFAULT_S = 60.0  # when the trace is shorter
_DRAIN_S = 10.0  # the link goes on after the end of the run
_MOST_DELAY_S, _MOST_OVERHEAD_S = 10.0, 0.1
_MOST_QUEUE_BYTES, _MOST_AGGREGATE = 2.0**30, 1024
_TEXT = """\
Run a robot over a simulated link, three times with the same seed: with arpd, without it (rclpy's defaults, unpaced),
and with an oracle that knows the link in place of arpd's estimator. It runs the daemon's own code in virtual time: no
ROS, no root, no waiting.

The robot publishes the topics of the configuration (payload and source_rate_hz), to one reader each; with
relay.link_domain the relay's two ends carry them. Without a configuration, or without such topics, it is the demo
robot. --trace reads CSV (time_s,rate_bit_per_s and perhaps loss; one row per change, the last one holds), rows of
seconds and Mbit/s, and mahimahi's packet-delivery traces (a line of milliseconds per 1500 bytes; repeated).

examples:
  arpd simulate --config robot.yaml --trace walk.csv
  arpd simulate --config robot.yaml --rate 0:20mbit,20:5mbit,50:20mbit      no trace at hand
  arpd simulate --config robot.yaml --trace lte.up --duration 5min --delay 30ms --loss 0.01
  arpd simulate --config robot.yaml --rate 0:20mbit --packet-overhead 200us --aggregate 16     like 802.11n
  arpd simulate --config new.yaml --trace walk.csv --json | jq .ways.arpd.summary"""


def _add_options(parser: argparse.ArgumentParser) -> None:
    add_config(parser, otherwise="the demo robot's where that does not exist")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--trace", type=Path, metavar="FILE", help="the link's rate, and perhaps loss, over time")
    source.add_argument("--rate", metavar="SECONDS:RATE,...", help="the same in place, like 0:20mbit,20:5mbit")
    parser.add_argument(
        "--duration",
        type=_duration(_LEAST_S, _MOST_S),
        metavar="TIME",
        help="length of the run, like 5min (default: the trace's, at least 60s)",
    )
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of phases and losses (default %(default)s)")
    parser.add_argument(
        "--actuation",
        action="append",
        default=[],
        metavar="TOPIC",
        help="this topic of the configuration crosses towards the robot; may be repeated",
    )
    _add_link(parser.add_argument_group("the link, besides its rate"))
    add_json(parser, "print JSON, with the course ten times a second")


def _add_link(group: argparse._ArgumentGroup) -> None:
    share = within(0.0, 1.0, parse=float)
    delay, overhead = _duration(0.0, _MOST_DELAY_S), _duration(0.0, _MOST_OVERHEAD_S)
    size = within(0.0, _MOST_QUEUE_BYTES, parse=parse_size, spell=spell_size)
    packets = within(1, _MOST_AGGREGATE, parse=int)
    group.add_argument("--loss", type=share, metavar="SHARE", help="of packets lost, besides the trace's (default 0)")
    group.add_argument("--delay", type=delay, metavar="TIME", help="one way, without a queue (default 2ms)")
    group.add_argument("--queue", type=size, metavar="SIZE", help="queue in front of the link (default 256kB)")
    group.add_argument(
        "--bottleneck",
        choices=("sender", "middle"),
        default="sender",
        help="sender: its interface, where a full queue makes a write wait; middle: between the hosts (default sender)",
    )
    costs = "link time a transmission costs besides its bytes"
    group.add_argument("--packet-overhead", type=overhead, metavar="TIME", help=costs)
    group.add_argument("--aggregate", type=packets, metavar="N", help="packets that may share it (default 1)")


def _simulate(options: argparse.Namespace) -> int:
    given = {
        "loss": options.loss,
        "delay_s": options.delay,
        "queue_bytes": None if options.queue is None else int(options.queue),
        "packet_overhead_s": options.packet_overhead,
        "aggregate_packets": options.aggregate,
    }
    properties = {name: value for name, value in given.items() if value is not None}
    trace, duration_s = _trace(options)
    config, settings, configured = _robot(options)
    asked = Asked(
        config=config,
        trace=trace,
        duration_s=duration_s,
        seed=options.seed,
        model=LinkModel(pushes_back=options.bottleneck == "sender", losses=trace.losses, **properties),
        robot=configured or demo_topics(),
        is_demo=not configured,
    )
    number = count()
    with progress(f"simulating {format_duration(duration_s)} three ways", total=3) as reach:
        comparison = compare(
            settings,
            trace.rates,
            duration_s,
            seed=asked.seed,
            model=asked.model,
            topics=asked.robot,
            on_way=lambda way: reach(next(number), way),
        )
    if options.json:
        print(json.dumps(comparison_document(asked, comparison), indent=2, allow_nan=False))
    else:
        show_comparison(asked, comparison)
    return 0


def _robot(options: argparse.Namespace) -> tuple[Path | None, Settings, tuple[SimTopic, ...]]:
    """Return the configuration's file, its settings, and the topics of which it says what they publish."""
    config = config_of(options)
    if config is None:
        if options.actuation:
            raise UsageError("--actuation is for the topics of a configuration; name it with --config")
        return None, demo_settings(), ()
    settings = load_settings(config, interfaces=None)  # the file may belong to another computer
    configured = configured_topics(settings, actuation=options.actuation)
    known = {topic.prefix + topic.name for topic in configured}
    for name in options.actuation:
        if name not in known:
            raise UsageError(
                f"--actuation {name}: {config} does not say what it publishes; "
                f"give it payload and source_rate_hz under topics"
            )
    return config, settings, configured


def _trace(options: argparse.Namespace) -> tuple[LinkTrace, float]:
    """Return the trace, long enough for the run, and the length of the run (s)."""
    if options.trace is not None:
        trace = read_trace(options.trace)
    else:
        try:
            rates = RateSchedule.parse(options.rate)
        except ValueError as error:
            raise UsageError(f"--rate: {error}") from None
        trace = LinkTrace(name=printable(options.rate), rates=rates, losses=(), duration_s=rates.duration_s)
    duration_s = options.duration or min(_MOST_S, max(_DEFAULT_S, trace.duration_s))
    return trace.lasting(duration_s + _DRAIN_S), duration_s


def _duration(least_s: float, most_s: float) -> Callable[[str], float]:
    return within(least_s, most_s, parse=parse_duration, spell=spell_duration)


SIMULATE = Command(_TEXT, _add_options, _simulate)
