"""The table of `arpd topics`: one line per topic, the heaviest first, and what all of them publish."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.cli.output import FittedTable, wrapped
from arpd.model.quantities import format_number, format_payload, format_rate, printable
from arpd.report.wording import count

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from arpd.model.link_topics import LinkTopic, TopicList

_LONGEST_NAME = 250
_MOST_NAMED = 2
_WORDS = frozenset({"TYPE", "LINK", "FROM, TO"})  # columns that are flush left
_LEAST_MBIT = 0.01
_VARIES = 1.1
_LEGEND = "LINK: out from this host, in from beyond it; now: a node on the other side reads it. READERS: here + beyond."


def link_table(topics: Sequence[LinkTopic]) -> FittedTable:
    """Return a heading and a line per topic."""
    titles = ["TOPIC", "TYPE", "HZ", "SIZE", "LARGEST", "MBIT/S", "LINK", "READERS", "FROM, TO"]
    rows, ranks = [titles, *(_cells(topic) for topic in sorted(topics, key=_order))], [0, 3, 0, 1, 5, 0, 0, 4, 0]
    if not any(map(_varies, topics)):
        at = titles.index("LARGEST")
        rows, ranks = [[*row[:at], *row[at + 1 :]] for row in rows], [*ranks[:at], *ranks[at + 1 :]]
    return FittedTable(rows=rows, ranks=ranks, words=_WORDS)


def _varies(topic: LinkTopic) -> bool:
    """Return whether the size of its samples varies so much that the mean does not tell it."""
    traffic = topic.traffic
    return traffic is not None and (traffic.largest_bytes or 0) > _VARIES * (traffic.mean_bytes or 0.0)


def summary(listed: TopicList) -> list[str]:
    """Say what the topics publish together, and what to do next."""
    measured = [topic for topic in listed.topics if topic.traffic is not None]
    crossing = [topic for topic in measured if topic.is_crossing]
    unknown = len(listed.topics) - len(measured)
    crosses = f"{len(crossing)} of them cross the link now: {_publish(crossing)}" if crossing else "none crosses now"
    lines = [
        _LEGEND,
        f"{count(len(measured), 'topic')} measured for {listed.seconds:g} s: {_publish(measured)}; {crosses}"
        + (f"; {count(unknown, 'topic')} not measured" if unknown else ""),
    ]
    if measured and not any(topic.traffic and topic.traffic.samples for topic in measured):
        lines.append("Not one message arrived: do the nodes publish now?")
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


def _cells(topic: LinkTopic) -> list[str]:
    traffic = topic.traffic
    types = ", ".join(name.replace("/msg/", "/") for name in topic.types)
    return [
        printable(topic.name, longest=_LONGEST_NAME),
        printable(types, longest=_LONGEST_NAME),
        format_number(traffic.rate_hz if traffic else None),
        format_payload(traffic.mean_bytes if traffic else None),
        format_payload(traffic.largest_bytes if traffic else None),
        _mbit(traffic.bytes_per_second * 8e-6) if traffic else "-",
        _link(topic),
        f"{len(topic.readers)}+{len(topic.far_readers)}",
        "; ".join(_from(topic)),
    ]


def _mbit(mbit_per_second: float) -> str:
    return f"<{_LEAST_MBIT}" if 0 < mbit_per_second < _LEAST_MBIT else format_number(mbit_per_second)


def _link(topic: LinkTopic) -> str:
    """Say in which direction a topic crosses the link, or could."""
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
    shown = [printable(node.removeprefix("/"), longest=60) or "an unnamed node" for node in nodes[:_MOST_NAMED]]
    more = [f"{len(nodes) - _MOST_NAMED} more"] if len(nodes) > _MOST_NAMED else []
    return ", ".join((*shown, *more))


def _publish(topics: Iterable[LinkTopic]) -> str:
    return format_rate(sum(topic.traffic.bytes_per_second for topic in topics if topic.traffic))
