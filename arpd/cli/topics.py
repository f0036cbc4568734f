"""`arpd topics`: what crosses the link or could, measured, and a first configuration from it."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

from arpd import __version__
from arpd.cli.options import Command, add_config, config_of, within
from arpd.cli.output import fitted, progress, show
from arpd.host import interface as host
from arpd.host.config.first_file import first_file
from arpd.host.config.load import load_settings, local_domain
from arpd.host.kernel import link_interface
from arpd.model.errors import ArpdError, UsageError
from arpd.model.kinds import NONE, address
from arpd.model.names import compile_patterns, is_hidden, is_internal
from arpd.model.quantities import format_number, format_payload, format_rate, printable
from arpd.model.settings import RelaySettings, Settings
from arpd.report.first_guess import first_guess
from arpd.report.wording import count, listed
from arpd.ros.rmw import require_middleware

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.table import Table

    from arpd.model.link_topics import LinkTopic, TopicList

_SECONDS = 5.0
_MOST_SECONDS = 600.0
_LINK_DOMAINS = (77, 78)  # the second where the nodes live in the first
_LONGEST_NAME = 250
_MOST_NAMED = 2
_LEGEND = "LINK: out from this host, in from beyond it; now: a node on the other side reads it. READERS: here + beyond."


_TEXT = """\
Run on the robot while its nodes run. List the topics that cross the link or could, with type, rate and size. Topics
that are published on this host are measured for some seconds; those of the other side are not, because that would bring
them over the link once more. No daemon is needed, and nothing is changed. Drivers that work only for readers (such as
image_transport's compressed pictures) work meanwhile; a large topic is read until 32 MB and ten messages have come.
--suggest writes a first configuration instead, for a robot that has none: weight and minimum rate of a topic are
guessed by its type and its measured rate, each with its reason.

examples:
  arpd topics
  arpd topics --suggest > arpd.yaml          then: arpd check arpd.yaml
  arpd topics --suggest --robot robot.local > arpd.yaml
  arpd topics --seconds 20 --json | jq '.topics[] | {name, traffic}'

exit codes: 0 done, 1 there are no topics, 2 wrong usage, 69 ROS is not there, 78 FILE is wrong"""


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seconds",
        type=within(0.1, _MOST_SECONDS, parse=float),
        default=_SECONDS,
        metavar="N",
        help="time to measure (s, default %(default)g)",
    )
    parser.add_argument("--all", action="store_true", help="list topics of ROS and of arpd and hidden ones, too")
    output = parser.add_mutually_exclusive_group()
    output.add_argument("--suggest", action="store_true", help="print a first configuration file")
    output.add_argument("--json", action="store_true", help="print JSON")
    link = parser.add_argument_group("with --suggest")
    link.add_argument(
        "--robot", type=_address, metavar="ADDRESS", help="this robot on the link (default: its address there now)"
    )
    link.add_argument(
        "--base", type=_address, metavar="ADDRESS", help="the computer at the other end (default: it finds the robot)"
    )
    add_config(parser, otherwise="the defaults where that does not exist")


def _list_topics(options: argparse.Namespace) -> int:
    if (options.robot or options.base) and not options.suggest:
        raise UsageError("--robot and --base go into a configuration; give --suggest, too")
    config = config_of(options)
    settings = Settings() if config is None else load_settings(config, interfaces=None)
    found = _measured(options, settings.relay)
    if not found.topics:
        raise ArpdError(_nothing_found(found))
    if options.json:
        topics = [asdict(topic) | {"is_crossing": topic.is_crossing} for topic in found.topics]
        print(json.dumps(asdict(found) | {"topics": topics}, indent=2))
    elif options.suggest:
        _suggest(found, options, settings)
    else:
        show(_table(found.topics))
        print("\n".join(["", *_summary(found, settings)]))
    if found.cannot_tell_hosts and not options.json:
        _remark(found.cannot_tell_hosts)
    return 0


def _address(word: str) -> str:
    if word == NONE:
        raise argparse.ArgumentTypeError(f"{NONE} is no address; leave the option out")
    try:
        return address(word)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _measured(options: argparse.Namespace, relay: RelaySettings) -> TopicList:
    from arpd.ros.runtime import any_user_heard, ros_node

    require_middleware()

    def is_of_interest(topic: str) -> bool:
        return options.all or not (is_internal(topic) or is_hidden(topic))

    with (
        progress(f"measuring for {options.seconds:g} s", total=options.seconds) as shown,
        any_user_heard(),
        ros_node(f"arpd_topics_{os.getpid()}") as node,
    ):
        from arpd.ros.topic_measuring import TopicSurvey

        survey = TopicSurvey(node, prefix=relay.link_prefix, is_of_interest=is_of_interest, on_progress=shown)
        return survey.run(options.seconds)


def _nothing_found(found: TopicList) -> str:

    def value(name: str) -> str:
        return os.environ.get(name) or "not set"

    return f"""\
no topics in ROS domain {found.domain_id}. Check, in this order:
  the robot's nodes run now                       ros2 node list
  ROS_DOMAIN_ID is that of the nodes              here: {value("ROS_DOMAIN_ID")}
  ROS_AUTOMATIC_DISCOVERY_RANGE is not OFF        here: {value("ROS_AUTOMATIC_DISCOVERY_RANGE")}
  LOCALHOST there hides nodes of other computers  run this on the computer with the nodes
  ROS_LOCALHOST_ONLY is the same as the nodes'    here: {value("ROS_LOCALHOST_ONLY")}
  RMW_IMPLEMENTATION is the same                  here: {value("RMW_IMPLEMENTATION")}"""


def _suggest(found: TopicList, options: argparse.Namespace, settings: Settings) -> None:
    """Print a configuration whose link is where the options say, or that in force, or this host's interfaces."""
    here, relay = local_domain(), settings.relay
    domains = (relay.link_domain, *_LINK_DOMAINS)
    robot, base, guessed_from = options.robot or relay.robot, options.base or relay.base, ""
    if robot is None:
        interface = link_interface(settings.link.interface, base)
        robot = min(host.ipv4_addresses().get(interface, ()), default=None)
        guessed_from = interface if robot else ""
    link_domain = next(domain for domain in domains if domain is not None and domain != here)
    settings = replace(settings, relay=RelaySettings(link_domain=link_domain, robot=robot, base=base))
    guess = first_guess(found.topics)
    origin = f"arpd {__version__} on {platform.node()}, {len(found.topics)} topics in {found.seconds:g} s"
    sys.stdout.write(first_file(guess, settings, guessed_from=guessed_from, origin=origin))
    _remark("weights and minimum rates are guesses: read them, then `arpd check FILE`")


def _remark(words: str) -> None:
    print(f"arpd: {words}", file=sys.stderr)


def _table(topics: Sequence[LinkTopic]) -> Table:
    """Return a heading and a line per topic, the heaviest first, and topics of unknown traffic last."""
    titles = ["TOPIC", "TYPE", "HZ", "SIZE", "MBIT/S", "LINK", "READERS", "FROM, TO"]
    loads = {topic.name: topic.traffic.bytes_per_second if topic.traffic else -1.0 for topic in topics}
    rows = [_cells(topic) for topic in sorted(topics, key=lambda topic: (-loads[topic.name], topic.name))]
    return fitted([titles, *rows], ranks=[0, 3, 0, 1, 0, 0, 4, 0], words={"TYPE", "LINK", "FROM, TO"})


def _summary(found: TopicList, settings: Settings) -> list[str]:
    measured = [topic for topic in found.topics if topic.traffic is not None]
    crossing = [topic for topic in measured if topic.is_crossing]
    unknown = len(found.topics) - len(measured)
    far = f"{len(crossing)} of them, {_publish(crossing)}, have" if crossing else "none has"
    lines = [
        _LEGEND,
        f"{count(len(measured), 'topic')} measured for {found.seconds:g} s: {_publish(measured)}; {far} readers beyond "
        "the link" + (f"; {count(unknown, 'topic')} not measured" if unknown else ""),
    ]
    if measured and not any(topic.traffic and topic.traffic.samples for topic in measured):
        lines.append("Not one message arrived: do the nodes publish now?")
    if not any(topic.is_from_robot for topic in found.topics):
        lines += [
            "No topic seems to be published on this host. A node that is older than an address of this host counts as",
            "one beyond: restart it, or set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST here.",
        ]
    names = {name for topic in found.topics for name in (topic.name, topic.relayed_as)}
    configured = (*settings.relay.topic_names, *(topic.name for topic in settings.topics))
    if absent := [each for each in configured if not any(map(compile_patterns([each]).fullmatch, names))]:
        lines.append(f"The configuration names {listed(absent)}; no topic here is called so")
    return [*lines, "`arpd topics --suggest > arpd.yaml` writes a first configuration from this"]


def _cells(topic: LinkTopic) -> list[str]:
    traffic = topic.traffic
    types = ", ".join(name.replace("/msg/", "/") for name in topic.types)
    return [
        printable(topic.name, longest=_LONGEST_NAME),
        printable(types, longest=_LONGEST_NAME),
        format_number(traffic.rate_hz if traffic else None),
        format_payload(traffic.mean_bytes if traffic else None),
        format_number(traffic.bytes_per_second * 8e-6 if traffic else None),
        _way(topic),
        f"{len(topic.readers)}+{len(topic.far_readers)}",
        "; ".join(_from(topic)),
    ]


def _way(topic: LinkTopic) -> str:
    is_out, is_in = bool(topic.writers), bool(topic.far_writers) or not topic.writers
    way = "both" if is_out and is_in else "out" if is_out else "in"
    return f"{way}, now" if topic.is_crossing else way


def _from(topic: LinkTopic) -> Iterable[str]:
    """Say who publishes a topic and who reads it on the other side, and what else is to know."""
    writers = _named((*topic.writers, *topic.far_writers)) or "nobody now"
    readers = topic.far_readers if topic.writers else topic.readers
    under = f" as {printable(topic.relayed_as, longest=_LONGEST_NAME)}" if topic.relayed_as else ""
    yield f"{writers} to {_named(readers)}{under}" if readers else f"{writers}{under}"
    if topic.is_latched:
        yield "latched"
    if topic.unmeasured and topic.writers:
        yield f"not measured: {printable(topic.unmeasured, longest=_LONGEST_NAME)}"


def _named(nodes: Sequence[str]) -> str:
    return listed([printable(node.removeprefix("/"), longest=60) or "an unnamed node" for node in nodes], _MOST_NAMED)


def _publish(topics: Iterable[LinkTopic]) -> str:
    return format_rate(sum(topic.traffic.bytes_per_second for topic in topics if topic.traffic))


TOPICS = Command(_TEXT, _add_options, _list_topics)
