"""Topics that cross the link, from the hosts of their endpoints, and the nodes that may announce them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from arpd.model.endpoints import Direction
from arpd.model.names import ROS_TOPICS, is_internal
from arpd.ros.names import LEAST_DEADLINE_NS, PUBLISHERS_TOPIC, REPORT_TOPIC, is_full_name, off_link

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from arpd.ros.graph import Endpoint, GraphView
    from arpd.ros.rmw import Rmw

_MOST_TOPICS = 3000  # so that a graph full of topics does not take the processor
_ROBOT = b""  # in the place of a host


@dataclass(frozen=True, kw_only=True, slots=True)
class Crossing:
    """Direction, readers and writers of one topic.

    Parameters
    ----------
    direction : a topic with writers on both sides counts as sensing
    remote_readers : participants across the link from a writer that read it; each receives a unicast copy
    requested_ns : tightest deadline that a reader requests and a writer can keep, 0 = none (ns)
    writers : nodes that write it; the empty name is a node whose name is unknown
    """

    direction: Direction
    remote_readers: int
    requested_ns: int = 0
    writers: frozenset[str] = frozenset()


@dataclass(frozen=True, kw_only=True, slots=True)
class Graph:
    """The part of the ROS graph that concerns the daemon, at one moment; at first nothing is known.

    Parameters
    ----------
    crossings : every topic of the robot
    topics : number of topics in each direction
    announcers : nodes that may announce publishers; the empty name is an unknown node
    peers : writers of receiver reports; None = not known
    remote_participants : processes with ROS nodes on other hosts than the robot; 1 where hosts are unknown
    """

    crossings: Mapping[str, Crossing] = field(default_factory=dict)
    topics: Counter[Direction] = field(default_factory=Counter)
    announcers: frozenset[str] = frozenset()
    peers: int | None = None
    remote_participants: int = 1

    def shows_writer(self, node: str, topic: str) -> bool:
        """Return whether a node may announce a publisher of the topic, and writes it.

        A writer whose node is unknown may be that of any node that the graph does not name. It stays so where a process
        returned after an outage that it did not notice: it sees no reason to name its nodes again.
        """
        writers = self.crossings[topic].writers if topic in self.crossings else frozenset()
        if node in writers:
            return node in self.announcers or "" in self.announcers
        return node not in self.announcers and "" in self.announcers and "" in writers

    def fields_of(self, topic: str) -> Mapping[str, Any]:
        """Return the fields of a publisher that the graph shows."""
        if (crossing := self.crossings.get(topic)) is None:
            return {}
        return {
            "direction": crossing.direction,
            "remote_readers": crossing.remote_readers,
            "requested_deadline_ns": crossing.requested_ns,
        }


def read_graph(view: GraphView, rmw: Rmw, *, first: Collection[str] = (), here: Collection[bytes] = ()) -> Graph:
    """Return the crossing of every topic, without those of ROS and of arpd itself, and who may announce them.

    Parameters
    ----------
    first : topics that are read first, in case there are too many
    here : hosts of endpoints that are this one, besides that of this process
    """
    robot = frozenset({view.own.host, *here}) if rmw.tells_hosts else None
    # What a relay carries comes last, in the place of what others have in the link's domain under that name.
    full = sorted(filter(is_full_name, view.types), key=lambda name: off_link(name) != name)
    names = {off_link(name): name for name in full if off_link(name) != name or not is_internal(name)}
    topics = sorted(names, key=lambda topic: topic not in first)[:_MOST_TOPICS]

    def readers(topic: str) -> Collection[Endpoint]:
        found = view.readers(name := names[topic])
        # Between two ends one process a host reads; where it was killed and runs again, the graph shows both for 20 s.
        return found if name == topic or robot is None else {_side(each, robot): each for each in found}.values()

    hosts = {writer.participant: writer.host for topic in ROS_TOPICS for writer in view.writers(topic)}
    crossings = {
        topic: crossing(
            # The daemon's own writer of /diagnostics is no traffic of the robot.
            writers=[writer for writer in view.writers(names[topic]) if writer.node != view.own.node],
            readers=readers(topic),
            robot=robot,
        )
        for topic in topics
    }
    return Graph(
        crossings=crossings,
        topics=Counter(crossing.direction for crossing in crossings.values()),
        announcers=_nodes(view.writers(PUBLISHERS_TOPIC)),
        peers=len(view.writers(REPORT_TOPIC)),
        remote_participants=1 if robot is None else sum(host not in robot for host in hosts.values()),
    )


def crossing(
    *, writers: Collection[Endpoint], readers: Collection[Endpoint], robot: Collection[bytes] | None
) -> Crossing:
    """Return the crossing of a topic: pure.

    Parameters
    ----------
    robot : hosts of endpoints that are the robot; None where the middleware does not name the hosts. A reader in
        another process than any writer may be across the link then. Such a topic counts as sensing, with one copy: to
        plan a local topic only gives it a rate, but to leave out a topic that crosses would leave it unpaced; and
        copies that do not exist would take rate from every topic
    """
    if robot is None:
        processes = {writer.participant for writer in writers}
        copies = int(bool(processes) and any(reader.participant not in processes for reader in readers))
        direction = Direction.SENSING if copies else Direction.LOCAL
    else:
        sides = {_side(writer, robot) for writer in writers}
        beyond = [{each.participant for each in readers if _side(each, robot) != side} for side in sides]
        copies = max(map(len, beyond), default=0)  # with writers on both sides, those of the side with more
        direction = Direction.LOCAL  # also between two other hosts
        if copies and _ROBOT in sides:
            direction = Direction.SENSING
        elif copies and any(_side(reader, robot) == _ROBOT for reader in readers):
            direction = Direction.ACTUATION
    return Crossing(
        direction=direction,
        remote_readers=copies if direction is not Direction.LOCAL else 0,
        requested_ns=min((each.deadline_ns for each in readers if each.deadline_ns >= LEAST_DEADLINE_NS), default=0),
        writers=_nodes(writers),
    )


def _side(endpoint: Endpoint, robot: Collection[bytes]) -> bytes:
    return _ROBOT if endpoint.host in robot else endpoint.host


def _nodes(endpoints: Iterable[Endpoint]) -> frozenset[str]:
    return frozenset(endpoint.node for endpoint in endpoints)
