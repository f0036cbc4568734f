"""A first configuration file: guessed preferences of topics as YAML, with the reasons as comments."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import yaml
from pydantic import TypeAdapter

from arpd.model.kinds import NONE
from arpd.model.quantities import format_rate, printable
from arpd.model.settings import TopicSettings
from arpd.report.first_guess import WEAK_LINK_BYTES_PER_SECOND, wire_bytes_per_second

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from arpd.report.first_guess import FirstGuess

_WIDTH = 110
_LONGEST = 400
_TOPIC = TypeAdapter(TopicSettings)


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkChoice:
    """Where the link is, for the relay with two ends.

    Parameters
    ----------
    link_domain : ROS domain of the link
    robot, base : addresses of the two computers; None = unknown
    robot_is_guessed_from : interface whose address the robot's is; empty = somebody gave it
    interface : ``link.interface``
    """

    link_domain: int
    robot: str | None = None
    base: str | None = None
    robot_is_guessed_from: str = ""
    interface: str = "auto"


def first_file(guess: FirstGuess, link: LinkChoice, *, origin: str) -> str:
    """Return a whole configuration file, which `arpd check` accepts once one address of the link is known.

    Names, types and addresses come from outside: the YAML library writes every value, and comments have no control
    characters.

    Parameters
    ----------
    guess : preferences of the topics
    link : where the link is
    origin : words about the robot and the measurement, for the first line
    """
    lines = [*_comment(f"A first configuration of arpd, by `arpd topics --suggest`: {origin}."), *_HOW_TO, "#"]
    lines += _comment(_sums(guess))
    lines += ["", *_yaml({"link": {"interface": link.interface}}), "", *_relay(guess, link), ""]
    if not guess.topics:
        return "\n".join([*lines, "topics: []", ""])
    lines.append("topics:")
    for topic in guess.topics:
        words = "; ".join((topic.role.reason, *topic.remarks))
        lines += _indented([*_comment(words), *_yaml([_entry(topic.settings)])])
    return "\n".join([*lines, ""])


_HOW_TO = (
    "#",
    "# All weights and minimum rates are guesses by type. Change them, then try them before you install the file:",
    "#   arpd check FILE                                       names every fault",
    "#   arpd solve --config FILE --capacity 1mbit,5mbit       shows what each topic would get on which link",
    "#   sudo install -m 644 FILE /etc/arpd/arpd.yaml          on both computers; then restart arpd's services",
    "#",
    "# weight          who gets how much of a slow link: weight 2 gets twice as much link time as weight 1",
    "# min_rate_hz     the rate that a topic keeps as long as the link carries the minimum rates of all",
    "# max_rate_hz     add it where fewer samples will do. Without it: all that is published",
    "# max_depth       most samples that the publisher keeps for a slow link",
    "# latency_budget  samples older than this are not worth keeping (default 1s)",
    "# payload, source_rate_hz   measured; only `arpd solve` and `arpd simulate` read them",
)


def _sums(guess: FirstGuess) -> str:
    topics = [topic.settings for topic in guess.topics]
    floors = sum(wire_bytes_per_second(topic.payload_bytes, topic.min_rate_hz) for topic in topics)
    full = sum(wire_bytes_per_second(topic.payload_bytes, topic.source_rate_hz) for topic in topics)
    weak = format_rate(WEAK_LINK_BYTES_PER_SECOND)
    is_much = floors > WEAK_LINK_BYTES_PER_SECOND
    much = f" That is more than weak Wi-Fi carries ({weak}): lower some." if is_much else ""
    unknown = sum(topic.payload_bytes is None for topic in topics)
    besides = f" Topics of unknown size, which do not count: {unknown}." if unknown else ""
    return (
        f"All minimum rates together need {format_rate(floors)} of the link, with headers.{much} On a slower link "
        "the lightest weights fall below theirs first. At the measured rates everything needs "
        f"{format_rate(full)}.{besides}"
    )


def _relay(guess: FirstGuess, link: LinkChoice) -> Iterator[str]:
    yield from _comment(
        "A relay with two ends carries the topics of nodes whose code is not yours, under their own names. Both "
        "computers need arpd and this file. Start your nodes on both with ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST."
    )
    yield "relay:"
    yield from _indented(_comment("a ROS domain in which no node of yours lives"))
    yield from _indented(_yaml({"link_domain": link.link_domain}))
    yield from _indented(_comment(_of_robot(link)))
    yield from _indented(_yaml({"robot": link.robot or NONE}))
    base = (
        "" if link.base else "; not needed where the robot's address is known: the base computer's end finds the robot"
    )
    yield from _indented(_comment(f"address or name of the base computer on the link{base}"))
    yield from _indented(_yaml({"base": link.base or NONE}))
    yield from _indented(_comment("services and actions cross only where they are named, for example [/map_server/*]"))
    yield from _indented(["services: []", "actions: []"])
    if guess.groups:
        yield from _indented(_comment("a picture and its camera_info cross together or not at all: by the same stamp"))
        groups = [{"name": group.name, "topics": list(group.topics)} for group in guess.groups]
        yield from _indented(_yaml({"groups": groups}))


def _of_robot(link: LinkChoice) -> str:
    if link.robot is None:
        return "address or name of this robot on the link: PLEASE FILL IN"
    if link.robot_is_guessed_from:
        where = printable(link.robot_is_guessed_from)
        return f"this robot on the link: the address of {where} now. Write a name instead if the address may change"
    return "address or name of this robot on the link"


def _entry(settings: TopicSettings) -> Mapping[str, Any]:
    """Return one item of `topics`, without keys that say what holds anyway."""
    given = _TOPIC.dump_python(settings, mode="json", by_alias=True, exclude_defaults=True)
    entry = {"name": settings.name, "weight": settings.weight} | given
    return {key: int(v) if isinstance(v, float) and v.is_integer() else v for key, v in entry.items()}


def _yaml(value: Any) -> list[str]:
    text = yaml.safe_dump(value, sort_keys=False, default_flow_style=False, width=_LONGEST, allow_unicode=False)
    return str(text).splitlines()


def _comment(words: str) -> list[str]:
    shown = printable(words, longest=_LONGEST)
    return [f"# {line}" for line in textwrap.wrap(shown, _WIDTH, break_on_hyphens=False)]


def _indented(lines: Iterable[str]) -> list[str]:
    return [f"  {line}" for line in lines]
