"""Whether this host has an address on the link that its ROS nodes do not know of."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from arpd.adapters.host.interface import ipv4_addresses
from arpd.model.errors import LinkError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_LOOK_S = 1.0
_SETTLED_S = 3.0  # an interface that comes gets its addresses one by one


class Addresses:
    """Notices that the link interface has an address that ROS in this process does not tell anybody.

    Fast DDS 2.14 reads the addresses of its host once in a process. Measured: a node older than the address of the link
    sends nothing by it, nor does a second node of the same process; a new process is heard within seconds.

    Parameters
    ----------
    interface : names the link interface now
    addresses : those of every interface
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        interface: Callable[[], str],
        *,
        addresses: Callable[[], Mapping[str, frozenset[str]]] = ipv4_addresses,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._interface = interface
        self._addresses = addresses
        self._clock = clock
        self._known = frozenset[str]().union(*addresses().values())
        self._strange: frozenset[str] = frozenset()
        self._strange_since_s = self._looked_s = clock()

    def are_outdated(self) -> bool:
        """Whether the link has had a new address for a while; asked at every tick."""
        if (now_s := self._clock()) - self._looked_s >= _LOOK_S:
            self._looked_s = now_s
            strange = self._addresses().get(self._interface(), frozenset()) - self._known
            if strange != self._strange:
                self._strange, self._strange_since_s = strange, now_s
        return bool(self._strange) and now_s - self._strange_since_s >= _SETTLED_S

    def error(self) -> LinkError:
        """Return what to end the process with: another one is heard."""
        return LinkError(f"{self._interface()} has an address that ROS here does not know of; start this again")
