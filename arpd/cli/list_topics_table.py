"""The table of `arpd topics`: one line per topic, the heaviest first, and what all of them publish."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.cli.columns import fitted, wrapped
from arpd.model.quantities import format_number, format_payload, format_rate, printable

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from arpd.model.link_topics import LinkTopic, TopicList

_LONGEST_NAME = 250
_MOST_NAMED = 2
_WORDS = frozenset({"TYPE", "FROM"})  # columns that are flush left


def link_table(topics: Iterable[LinkTopic], *, width: int) -> list[str]:
    """Return a heading and a line per topic, none wider than ``width``."""
    titles = ("TOPIC", "TYPE", "HZ", "SIZE", "LARGEST", "MBIT/S", "FROM", "READERS", "LINK")
    rows = [titles, *(_cells(topic) for topic in sorted(topics, key=_order))]
    columns = [
        [cell.ljust(max(map(len, column))) for cell in column] if title in _WORDS else column
        for title, column in zip(titles, zip(*rows, strict=True), strict=True)
    ]
    return fitted(list(zip(*columns, strict=True)), ranks=(0, 3, 0, 1, 5, 0, 2, 4, 0), width=width)


def summary(listed: TopicList) -> list[str]:
    """Say what the topics publish together, and what to do next."""
    measured = [topic for topic in listed.topics if topic.traffic is not None]
    crossing = [topic for topic in measured if topic.is_crossing]
    unknown = len(listed.topics) - len(measured)
    lines = [
        f"{_count(len(measured))} measured for {listed.seconds:g} s: {_publish(measured)}; "
        f"{len(crossing) or 'none'} of them cross the link now: {_publish(crossing)}"
        + (f"; {_count(unknown)} not measured" if unknown else "")
    ]
    if measured and not any(topic.traffic and topic.traffic.samples for topic in measured):
        lines += wrapped(
            "Not one message arrived. Do the nodes publish now? Nodes of another user may need "
            "FASTDDS_BUILTIN_TRANSPORTS=UDPv4 here, because shared memory has an owner.",
            100,
            indent=0,
        )
    if not any(topic.is_from_robot for topic in listed.topics):
        lines += wrapped(
            "No topic seems to be published on this host. A node that is older than an address of this host counts as "
            "one beyond: restart it, or set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST here.",
            100,
            indent=0,
        )
    return [*lines, "`arpd topics --suggest > arpd.yaml` writes a first configuration from this"]


def _order(topic: LinkTopic) -> tuple[bool, float, str]:
    """Put the heaviest first, and topics of unknown traffic last."""
    traffic = topic.traffic
    return traffic is None, -traffic.bytes_per_second if traffic else 0.0, topic.name


def _cells(topic: LinkTopic) -> Sequence[str]:
    traffic = topic.traffic
    types = ", ".join(name.replace("/msg/", "/") for name in topic.types)
    return (
        printable(topic.name, longest=_LONGEST_NAME),
        printable(types, longest=_LONGEST_NAME),
        format_number(traffic.rate_hz if traffic else None),
        format_payload(traffic.mean_bytes if traffic else None),
        format_payload(traffic.largest_bytes if traffic else None),
        format_number(traffic.bytes_per_second * 8e-6 if traffic else None),
        _named((*topic.writers, *topic.far_writers)) or "-",
        f"{len(topic.readers)}+{len(topic.far_readers)}",
        "; ".join(_link(topic)),
    )


def _link(topic: LinkTopic) -> Iterable[str]:
    """Say what a topic has to do with the link."""
    under = f" as {topic.relayed_as}" if topic.relayed_as else ""
    if topic.writers and topic.far_readers:
        yield f"crosses to {_named(topic.far_readers)}{under}"
    elif topic.writers:
        yield f"could cross{under}"
    if topic.far_writers and topic.readers:
        yield "comes over the link"
    elif topic.far_writers:
        yield "beyond this host; nobody here reads it"
    elif not topic.writers:
        yield "would come over the link: nobody publishes it now"
    if topic.is_latched:
        yield "latched"
    if topic.unmeasured and topic.writers:
        yield f"not measured: {printable(topic.unmeasured, longest=_LONGEST_NAME)}"


def _named(nodes: Sequence[str]) -> str:
    shown = [printable(node.removeprefix("/"), longest=60) or "an unnamed node" for node in nodes[:_MOST_NAMED]]
    more = [f"{len(nodes) - _MOST_NAMED} more"] if len(nodes) > _MOST_NAMED else []
    return ", ".join((*shown, *more))


def _publish(topics: Iterable[LinkTopic]) -> str:
    return format_rate(sum(topic.traffic.bytes_per_second for topic in topics if topic.traffic))


def _count(many: int) -> str:
    return f"{many} topic" if many == 1 else f"{many} topics"
