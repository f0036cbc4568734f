"""What the graph shows of announced publishers and readers, kept until the graph or the readers change."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from arpd.adapters.ros.crossing import Crossing
    from arpd.model.endpoints import PublisherState, ReaderState


class Joined:
    """Fields of announced endpoints that the graph shows.

    ``of_publisher`` and ``of_reader`` are other objects after a change, and the same ones before it.

    Parameters
    ----------
    crossings : topics of the graph
    """

    def __init__(self, crossings: Mapping[str, Crossing]) -> None:
        self._driven: Mapping[str, Collection[str]] = {}
        self._readers: tuple[ReaderState, ...] = ()
        self.crossings = crossings
        self.of_reader = self._reader_fields
        self.of_publisher = self._publisher_fields

    def note_readers(self, readers: tuple[ReaderState, ...]) -> None:
        """Take the live readers: the requests of those that arpd drives bind no publisher."""
        if readers is self._readers:
            return
        self._readers = readers
        driven: dict[str, set[str]] = {}
        for reader in readers:
            if reader.is_driven:
                driven.setdefault(reader.topic, set()).add(reader.node)
        if driven != self._driven:
            self._driven = driven
            self.of_publisher = self._publisher_fields  # a new bound method, so another object

    def _publisher_fields(self, _node: str, topic: str) -> Mapping[str, Any]:
        if (crossing := self.crossings.get(topic)) is None:
            return {}
        return {
            "direction": crossing.direction,
            "remote_readers": crossing.remote_readers,
            "requested_deadline_ns": crossing.tightest_request_ns(besides=self._driven.get(topic, ())),
        }

    def _reader_fields(self, node: str, topic: str) -> Mapping[str, Any]:
        if (crossing := self.crossings.get(topic)) is None:
            return {}
        return {"requests_ns": crossing.requests_of(node), "offers_ns": crossing.offers_ns}


def unsettled(publishers: Iterable[PublisherState], readers: Collection[ReaderState]) -> frozenset[str]:
    """Return the topics with an announced reader for which the graph does not show what its endpoints announce.

    A writer or reader that another one of its node replaces keeps the numbers in the graph: these topics must be read.
    """
    offers_ns = {reader.topic: reader.offers_ns for reader in readers}
    announced_ns: dict[str, set[int]] = {}
    for publisher in publishers:
        if publisher.topic in offers_ns:
            announced_ns.setdefault(publisher.topic, set()).add(publisher.deadline_ns)
    late = {reader.topic for reader in readers if reader.requests_ns != (reader.deadline_ns,)}
    return frozenset(late | {topic for topic, offers in announced_ns.items() if offers != set(offers_ns[topic])})
