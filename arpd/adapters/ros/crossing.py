"""Topics that cross the link, from the hosts of their endpoints; pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from arpd.adapters.ros.bounds import LEAST_DEADLINE_NS
from arpd.model.endpoints import Direction

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping


@dataclass(frozen=True, kw_only=True, slots=True)
class Endpoint:
    """One writer or reader: its host, its participant, its deadline (ns, 0 = infinite), its node (empty = unknown)."""

    host: bytes
    participant: bytes
    deadline_ns: int
    node: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Crossing:
    """Direction, readers and writers of one topic.

    Parameters
    ----------
    direction : a topic with writers on both sides counts as sensing
    remote_readers : participants across the link from a writer that read it; each receives a unicast copy
    requests : node and requested deadline of every reader (ns, 0 = infinite)
    writers : nodes that write it; the empty name is a node whose name is unknown
    """

    direction: Direction
    remote_readers: int
    requests: tuple[tuple[str, int], ...] = ()
    writers: frozenset[str] = frozenset()

    @property
    def tightest_request_ns(self) -> int:
        """Tightest deadline that a reader requests and a writer can keep, 0 = none (ns)."""
        return min((ns for _, ns in self.requests if ns >= LEAST_DEADLINE_NS), default=0)


def crossing(*, robot_host: bytes, writers: Iterable[Endpoint], readers: Iterable[Endpoint]) -> Crossing:
    """Return the crossing of a topic from the hosts of its endpoints: pure."""
    writers, readers = tuple(writers), tuple(readers)
    writer_hosts = {writer.host for writer in writers}
    remote = {reader.participant for reader in readers if writer_hosts - {reader.host}}
    if not remote or not writer_hosts:
        direction = Direction.LOCAL
    elif robot_host in writer_hosts:
        direction = Direction.SENSING
    elif any(reader.host == robot_host for reader in readers):
        direction = Direction.ACTUATION
    else:
        direction = Direction.LOCAL  # between two other hosts
    return Crossing(
        direction=direction,
        remote_readers=_copies(writer_hosts, readers) if direction is not Direction.LOCAL else 0,
        requests=_requests(readers),
        writers=_nodes(writers),
    )


def joined_by(crossings: Mapping[str, Crossing]) -> Callable[[str, str], Mapping[str, Any]]:
    """Return what gives the fields of a publisher that the graph shows, by its node and topic; a new object each time.

    Parameters
    ----------
    crossings : topics of the graph
    """

    def fields(_node: str, topic: str) -> Mapping[str, Any]:
        if (crossing := crossings.get(topic)) is None:
            return {}
        return {
            "direction": crossing.direction,
            "remote_readers": crossing.remote_readers,
            "requested_deadline_ns": crossing.tightest_request_ns,
        }

    return fields


def _copies(writer_hosts: Collection[bytes], readers: Collection[Endpoint]) -> int:
    """Count the copies of a sample that cross the link: with writers on both sides, those of the side with more."""
    return max(len({reader.participant for reader in readers if reader.host != host}) for host in writer_hosts)


def crossing_without_hosts(*, writers: Iterable[Endpoint], readers: Iterable[Endpoint]) -> Crossing:
    """Return the crossing of a topic where the middleware does not name the hosts of endpoints: pure.

    A reader in another process than any writer may be across the link. Such a topic counts as sensing, with one copy.
    To plan a local topic only gives it a rate, but to leave out a topic that crosses would leave it unpaced; and copies
    that do not exist would take rate from every topic.
    """
    writers, readers = tuple(writers), tuple(readers)
    processes = {writer.participant for writer in writers}
    is_crossing = bool(processes) and any(reader.participant not in processes for reader in readers)
    return Crossing(
        direction=Direction.SENSING if is_crossing else Direction.LOCAL,
        remote_readers=int(is_crossing),
        requests=_requests(readers),
        writers=_nodes(writers),
    )


def _requests(readers: Iterable[Endpoint]) -> tuple[tuple[str, int], ...]:
    return tuple(sorted((reader.node, reader.deadline_ns) for reader in readers))


def _nodes(endpoints: Iterable[Endpoint]) -> frozenset[str]:
    return frozenset(endpoint.node for endpoint in endpoints)
