"""`arpd simulate`: arpd on a recorded link, beside the same robot without arpd and with an oracle."""

from __future__ import annotations

from dataclasses import asdict, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic_core import to_json
from rich.text import Text

from arpd.cli.options import Command, add_config, add_json, config_of, within
from arpd.cli.output import fitted, progress, show
from arpd.daemon.scenario import Moment, Scenario, ScenarioResult, Way
from arpd.daemon.summary import WARM_UP_S, Summary, summarize
from arpd.host.config.load import load_settings
from arpd.model.endpoints import Direction
from arpd.model.errors import UsageError
from arpd.model.link import LinkState
from arpd.model.quantities import DURATION, SIZE, format_duration, format_number, format_payload, format_rate, printable
from arpd.report.wording import count
from arpd.sim.demo import demo_settings, demo_topics
from arpd.sim.link import LinkModel
from arpd.sim.robot import configured_topics
from arpd.sim.schedule import RateSchedule
from arpd.sim.trace import LinkTrace, read_trace
from arpd.web.json_text import plain

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Mapping, Sequence

    from rich.table import Table

    from arpd.model.settings import Settings
    from arpd.sim.result import SimTopic, TopicResult

    Comparison = Mapping[Way, ScenarioResult]
    Figures = Mapping[str, Callable[[TopicResult], float | None]]

_LEAST_S, _MOST_S = 20.0, 86_400.0  # the first 10 s are start-up
_DEFAULT_S = 60.0  # when the trace is shorter
_MOST_DELAY_S, _MOST_OVERHEAD_S = 10.0, 0.1
_MOST_QUEUE_BYTES, _MOST_AGGREGATE = 2.0**30, 1024
_MBIT = 1e6 / 8  # bytes
_MOST_EVENTS = 25
_LINK = LinkModel()
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
    about = "this topic of the configuration crosses towards the robot; may be repeated"
    parser.add_argument("--actuation", action="append", default=[], metavar="TOPIC", help=about)
    link = parser.add_argument_group("the link, besides its rate")

    def add(option: str, reader: Callable[[str], Any], default: float, metavar: str, about: str) -> None:
        link.add_argument(option, type=reader, default=default, metavar=metavar, help=about)

    size = within(0.0, _MOST_QUEUE_BYTES, parse=SIZE.parse, spell=SIZE.spell)
    costs = "link time a transmission costs besides its bytes"
    add("--loss", within(0.0, 1.0, parse=float), 0.0, "SHARE", "of packets lost, besides the trace's (default 0)")
    add("--delay", _duration(0.0, _MOST_DELAY_S), _LINK.delay_s, "TIME", "one way, without a queue (default 2ms)")
    add("--queue", size, _LINK.queue_bytes, "SIZE", "queue in front of the link (default 256kB)")
    add("--packet-overhead", _duration(0.0, _MOST_OVERHEAD_S), 0.0, "TIME", costs)
    add("--aggregate", within(1, _MOST_AGGREGATE, parse=int), 1, "N", "packets that may share it (default 1)")
    about = "sender: its interface, where a full queue makes a write wait; middle: between the hosts (default sender)"
    link.add_argument("--bottleneck", choices=("sender", "middle"), default="sender", help=about)
    add_json(parser, "print JSON, with the course ten times a second")


def _simulate(options: argparse.Namespace) -> int:
    trace, duration_s = _trace(options)
    config, settings, configured = _robot(options)
    robot = configured or demo_topics()
    model = LinkModel(
        delay_s=options.delay,
        queue_bytes=int(options.queue),
        pushes_back=options.bottleneck == "sender",
        loss=options.loss,
        losses=trace.losses,
        packet_overhead_s=options.packet_overhead,
        aggregate_packets=options.aggregate,
    )
    scenario = Scenario(settings, trace.rates, duration_s, seed=options.seed, model=model, topics=robot)
    ways: dict[Way, ScenarioResult] = {}
    with progress(f"simulating {format_duration(duration_s)} three ways", total=len(Way)) as reach:
        for way in Way:
            reach(len(ways), way)
            ways[way] = replace(scenario, way=way).play()
    summaries = {way: summarize(result, start_s=WARM_UP_S, end_s=duration_s) for way, result in ways.items()}
    if options.json:
        asked = {"config": config and str(config), "trace": trace.name, "duration_s": duration_s, "seed": options.seed}
        link = {name: value for name, value in asdict(model).items() if name != "losses"}
        document = asked | {
            "warm_up_s": WARM_UP_S,
            "link": link,
            "robot": {"is_demo": not configured, "topics": robot},
            "ways": {
                way: {"summary": summaries[way], "topics": result.topics, "course": _course(result.moments)}
                for way, result in ways.items()
            },
        }
        print(to_json(plain(document), indent=2, inf_nan_mode="null").decode())
        return 0
    why = "no configuration has a payload and a source_rate_hz" if config else "--config names another"
    head = [
        *_head(trace.name, ways, model, robot),
        *([] if configured else [f"         the demo robot; {why}"]),
        "ways     arpd; without it (rclpy's defaults, unpaced); arpd with an oracle for its estimator",
        f"runs     {format_duration(duration_s)} each, seed {options.seed}",
    ]
    show(*map(Text, head), "", fitted(_overall(summaries), ranks=(0, 0, 2, 1)))
    rates: Figures = {
        "DELIVERED, HZ": lambda topic: topic.received / duration_s,
        "LOST, %": lambda topic: 100 * topic.loss_ratio,
    }
    delays: Figures = {
        "P50, MS": lambda topic: _times(1e3, topic.latency_p50_s),
        "P99, MS": lambda topic: _times(1e3, topic.latency_p99_s),
        "AGE P99": lambda topic: _times(1e3, topic.age_p99_s),
    }
    show("", _topics(robot, ways, rates), "", _topics(robot, ways, delays), "")
    _show_events(ways[Way.ARPD].moments)
    return 0


def _head(name: str, ways: Comparison, model: LinkModel, robot: Sequence[SimTopic]) -> Sequence[str]:
    rates = [moment.truth_bytes_per_second for moment in ways[Way.ARPD].moments]
    low, mean, high = (format_rate(rate) for rate in (min(rates), sum(rates) / len(rates), max(rates)))
    path = f"delay {format_duration(model.delay_s)}, queue {format_payload(model.queue_bytes)}"
    published = format_rate(sum(topic.payload_bytes * topic.rate_hz for topic in robot))
    return (
        f"link     {printable(name)}: {low} to {high}, mean {mean}; {path}",
        f"robot    {count(len(robot), 'topic')} with {published} of payload",
    )


def _robot(options: argparse.Namespace) -> tuple[Path | None, Settings, tuple[SimTopic, ...]]:
    """Return the configuration's file, its settings, and the topics of which it says what they publish."""
    config = config_of(options)
    # The file may belong to another computer.
    settings = demo_settings() if config is None else load_settings(config, interfaces=None)
    configured = () if config is None else configured_topics(settings, actuation=options.actuation)
    known = {topic.prefix + topic.name for topic in configured}
    for name in options.actuation:
        if name not in known:
            raise UsageError(
                f"--actuation {printable(name)}: no payload and source_rate_hz of it stand in "
                f"{config or 'a configuration; give --config'}"
            )
    return config, settings, configured


def _trace(options: argparse.Namespace) -> tuple[LinkTrace, float]:
    if options.trace is not None:
        trace = read_trace(options.trace)
    else:
        try:
            rates = RateSchedule.parse(options.rate)
        except ValueError as error:
            raise UsageError(f"--rate: {error}") from None
        trace = LinkTrace(name=printable(options.rate), rates=rates, losses=(), duration_s=rates.duration_s)
    return trace, options.duration or min(_MOST_S, max(_DEFAULT_S, trace.duration_s))


def _duration(least_s: float, most_s: float) -> Callable[[str], float]:
    return within(least_s, most_s, parse=DURATION.parse, spell=DURATION.spell)


def _course(moments: Sequence[Moment]) -> Mapping[str, tuple[Any, ...]]:
    """Return the course of a run by columns; null = it does not exist."""
    return {field.name: tuple(getattr(moment, field.name) for moment in moments) for field in fields(Moment)}


def _overall(summaries: Mapping[Way, Summary]) -> Sequence[Sequence[str]]:
    best = summaries[Way.ORACLE].goodput_bytes_per_second
    rows: dict[str, Callable[[Summary], float | None]] = {
        "delivered, Mbit/s": lambda way: way.goodput_bytes_per_second / _MBIT,
        "of the oracle's, %": lambda way: 100 * way.goodput_bytes_per_second / best if best else None,
        "of the link carried, %": lambda way: 100 * way.carried_share,
        "budget, mean, Mbit/s": lambda way: _times(1 / _MBIT, way.budget_mean_bytes_per_second),
        "longest queue, ms": lambda way: 1e3 * way.queue_peak_s,
        "99 % of queues below, ms": lambda way: 1e3 * way.queue_p99_s,
        "estimate off, median, %": lambda way: _times(100, way.error_median),
        "estimate off, p90, %": lambda way: _times(100, way.error_p90),
        "plans per minute": lambda way: way.plans_per_minute,
        "QoS swaps per minute": lambda way: way.swaps_per_minute,
        "measuring, % of link": lambda way: 100 * way.measuring_share,
    }
    titles = [f"FROM {WARM_UP_S:g} S ON", *(way.upper() for way in summaries)]
    return [
        titles,
        *([title, *(format_number(cell(way)) for way in summaries.values())] for title, cell in rows.items()),
    ]


def _topics(robot: Sequence[SimTopic], ways: Comparison, figures: Figures) -> Table:
    """Return figures per topic over the whole run, three ways each; a narrow one shows arpd's, or the first."""
    titles = [f"{figure if way is Way.ARPD else ''}\n{way}" for figure in figures for way in ways]
    rows = [["TOPIC, WHOLE RUN", "SOURCE\nHZ", *titles]]
    for topic, *results in zip(robot, *(way.topics for way in ways.values()), strict=True):
        arrow = " (to robot)" if topic.direction is Direction.ACTUATION else ""
        cells = (format_number(cell(result)) for cell in figures.values() for result in results)
        rows.append([printable(topic.name) + arrow, format_number(topic.rate_hz, digits=4), *cells])
    many = len(figures)
    return fitted(rows, ranks=[0, many + 2, *(rank for place in range(many) for rank in (place, many, many + 1))])


def _show_events(moments: Sequence[Moment]) -> None:
    rows = [["", "EVENT", "BUDGET"]]
    for before, moment in pairwise(moments):
        at_s, is_out = f"{moment.t_s:.1f} s", moment.state is LinkState.OUTAGE
        if is_out != (before.state is LinkState.OUTAGE):
            rows.append([at_s, "outage" if is_out else "outage over", ""])
        if moment.cause:
            rows.append([at_s, moment.cause, format_rate(moment.level_bytes_per_second)])
    show(fitted(rows[: _MOST_EVENTS + 1], words=rows[0]) if rows[1:] else "arpd made no plan")
    if (more := len(rows) - 1 - _MOST_EVENTS) > 0:
        show(f"and {more} more; --json has the whole course")


def _times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value


SIMULATE = Command(_TEXT, _add_options, _simulate)
