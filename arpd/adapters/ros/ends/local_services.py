"""Services that nodes on this side of the link serve, read from the live ROS graph."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from arpd.adapters.ros.ends.survey import namesakes
from arpd.adapters.ros.graph import known_node_of, participant_of
from arpd.adapters.ros.names import is_full_name
from arpd.apply.relay.offers import ServiceOffer

if TYPE_CHECKING:
    from collections.abc import Callable

_EVERY_LOOK = 10  # every tenth look at a service reads its servers, even when their number is unchanged


@dataclass(frozen=True, slots=True)
class _Found:
    """Servers of a service when they were last read: their number, ghosts included, and the first that is no ghost."""

    servers: int
    offer: ServiceOffer | None


class LocalServices:
    """Finds the services of other processes; those of this process, ghosts above all, do not count.

    Most looks at a service only count its servers.

    Parameters
    ----------
    node : any node of this process in the local domain
    """

    def __init__(self, node: Any) -> None:
        self._node = node
        self._found: dict[str, _Found] = {}
        self._looks = 0

    def look(self, allows: Callable[[str], bool]) -> dict[str, ServiceOffer]:
        """Return the services with an allowed name, as they are now."""
        self._looks += 1
        names = [name for name, _ in self._node.get_service_names_and_types() if allows(name) and is_full_name(name)]
        self._found = {name: self._find(name, number) for number, name in enumerate(sorted(names))}
        return {name: found.offer for name, found in self._found.items() if found.offer is not None}

    def type_of(self, name: str) -> str | None:
        """Return the type of a service that the last look found, None for any other name."""
        found = self._found.get(name)
        return None if found is None or found.offer is None else found.offer.type_name

    def is_served(self, name: str, *, ghosts: int) -> bool:
        """Return whether another process on this side serves this name.

        Parameters
        ----------
        ghosts : servers of this name in this process
        """
        return self._count(name) > ghosts and bool(self._servers(name))

    def _find(self, name: str, number: int) -> _Found:
        found = self._found.get(name)
        servers = self._count(name)
        if found is not None and found.servers == servers and (self._looks + number) % _EVERY_LOOK:
            return found
        offers = self._servers(name) if servers else []
        named = [offer for offer in offers if offer.node]
        if offers and not named:
            return _Found(-1, None)  # the next look reads them again
        return _Found(servers, min(named, key=lambda offer: offer.node, default=None))

    def _count(self, name: str) -> int:
        with self._node.handle:  # Node.count_services would check the name again
            return int(self._node.handle.get_count_services(name))

    def _servers(self, name: str) -> list[ServiceOffer]:
        """Return the servers of other processes: the readers of the DDS topic that carries the requests."""
        readers = self._node.get_subscriptions_info_by_topic(f"rq{name}Request", no_mangle=True)
        ours = namesakes(self._node)
        return [
            ServiceOffer(type_name=_ros_type(reader.topic_type), node=known_node_of(reader))
            for reader in readers
            if participant_of(reader) not in ours
        ]


def _ros_type(dds_type: str) -> str:
    """Return ``example_interfaces/srv/AddTwoInts`` for ``example_interfaces::srv::dds_::AddTwoInts_Request_``."""
    return dds_type.replace("::dds_::", "::").removesuffix("_Request_").replace("::", "/")
