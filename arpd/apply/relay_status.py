"""Status of a relay with one end, and its shards: pure."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

_MOST_TOPICS = 100


def shards(topics: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Split topics into shards of about the same size, each of which gets a DDS participant of its own.

    Whenever a participant gets or loses an endpoint, rmw_fastrtps sends the list of all its endpoints to every other
    participant. So the cost of a plan for a participant grows with the square of its topics.
    """
    number = max(1, -(-len(topics) // _MOST_TOPICS))
    bounds = [len(topics) * k // number for k in range(number + 1)]
    return [topics[begin:end] for begin, end in pairwise(bounds)]


def shard_name(name: str, number: int) -> str:
    """Return the name of the node of a shard: the first has the relay's own."""
    return name if number == 0 else f"{name}_{number + 1}"


@dataclass(frozen=True, kw_only=True, slots=True)
class RelayStatus:
    """State of a relay.

    Parameters
    ----------
    topics, flowing : topics asked for, and those that are carried and published
    unpublished, gone : topics without a publisher that were never carried, and that were
    refused : topics that cannot be carried, with the reason
    ignored : topics of which writers are ignored, with those
    """

    topics: tuple[str, ...] = ()
    flowing: tuple[str, ...] = ()
    unpublished: tuple[str, ...] = ()
    gone: tuple[str, ...] = ()
    refused: tuple[tuple[str, str], ...] = ()
    ignored: tuple[tuple[str, str], ...] = ()

    @property
    def line(self) -> str:
        """One line for ``systemctl status``."""
        line = f"relaying {len(self.flowing)} of {len(self.topics)} topics"
        if self.unpublished:
            line += f"; not published yet: {', '.join(self.unpublished)}"
        if self.gone:
            line += f"; no longer published: {', '.join(self.gone)}"
        for topic, reason in sorted(self.refused):
            line += f"; refused {topic}: {reason}"
        for topic, words in sorted(self.ignored):
            line += f"; on {topic} ignored {words}"
        return line
