"""A first configuration file: guessed preferences of topics as YAML, with the reasons as comments."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import yaml
from pydantic import TypeAdapter

from arpd.model.kinds import NONE
from arpd.model.quantities import format_rate, printable
from arpd.model.settings import Settings, TopicSettings
from arpd.report.first_guess import WEAK_LINK_BYTES_PER_SECOND, FirstGuess, TopicGuess, wire_bytes_per_second

if TYPE_CHECKING:
    from collections.abc import Iterable

_WIDTH = 110
_LONGEST = 400
_TOPIC = TypeAdapter(TopicSettings)
_FILE = """\
{origin}
#
# All weights and minimum rates are guesses by type. Change them, then try them before you install the file:
#   arpd check FILE                                       names every fault
#   arpd solve --config FILE --capacity 1mbit,5mbit       shows what each topic would get on which link
#   sudo install -m 644 FILE /etc/arpd/arpd.yaml          on both computers; then restart arpd's services
#
# weight          who gets how much of a slow link: weight 2 gets twice as much link time as weight 1
# min_rate_hz     the rate that a topic keeps as long as the link carries the minimum rates of all
# max_rate_hz     add it where fewer samples will do. Without it: all that is published
# max_depth       most samples that the publisher keeps for a slow link
# latency_budget  samples older than this are not worth keeping (default 1s)
# payload, source_rate_hz   measured; only `arpd solve` and `arpd simulate` read them
#
{sums}

{link}

# A relay with two ends carries the topics of nodes whose code is not yours, under their own names. Both computers need
# arpd and this file. Start your nodes on both with ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST.
# link_domain: a ROS domain in which no node of yours lives. robot, base: address or name of each computer on the link;
# one may be none, then that end finds the other. {robot}
# Services and actions cross only where they are named, for example [/map_server/*].
{relay}

{topics}
"""


def first_file(guess: FirstGuess, settings: Settings, *, guessed_from: str, origin: str) -> str:
    """Return a whole configuration file, which `arpd check` accepts once one address of the link is known.

    Names, types and addresses come from outside: the YAML library writes every value, and comments have no control
    characters.

    Parameters
    ----------
    guess : preferences of the topics
    settings : where the link is: its interface, its domain, and the addresses of its ends
    guessed_from : interface whose address the robot's is; empty = somebody gave it
    origin : words about the robot and the measurement, for the first line
    """
    relay, robot = settings.relay, "" if settings.relay.robot else "PLEASE FILL IN relay.robot."
    if guessed_from:
        robot = f"That of {printable(guessed_from)} is guessed; write a name if it may change."
    groups = [{"name": group.name, "topics": list(group.topics)} for group in guess.groups]
    ends = {"link_domain": relay.link_domain, "robot": relay.robot or NONE, "base": relay.base or NONE}
    topics = [line for topic in guess.topics for line in _item(topic)]
    return _FILE.format(
        origin=_comment(f"A first configuration of arpd, by `arpd topics --suggest`: {origin}."),
        sums=_comment(_sums(guess)),
        link=_yaml({"link": {"interface": settings.link.interface}}),
        robot=robot,
        relay=_yaml({"relay": ends | {"services": [], "actions": [], "groups": groups}}),
        topics="\n".join(["topics:", *topics] if topics else ["topics: []"]),
    )


def _item(topic: TopicGuess) -> Iterable[str]:
    """Return one item of `topics` with its reason, without keys that say what holds anyway."""
    settings = topic.settings
    given = _TOPIC.dump_python(settings, mode="json", by_alias=True, exclude_defaults=True)
    entry = {"name": settings.name, "weight": settings.weight} | given
    whole = {key: int(v) if isinstance(v, float) and v.is_integer() else v for key, v in entry.items()}
    lines = f"{_comment('; '.join((topic.role.reason, *topic.remarks)))}\n{_yaml([whole])}".splitlines()
    return [f"  {line}" for line in lines]


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


def _yaml(value: Any) -> str:
    text = yaml.safe_dump(value, sort_keys=False, default_flow_style=None, width=_LONGEST, allow_unicode=False)
    return str(text).rstrip()


def _comment(words: str) -> str:
    lines = textwrap.wrap(printable(words, longest=_LONGEST), _WIDTH, break_on_hyphens=False)
    return "\n".join(f"# {line}" for line in lines)
