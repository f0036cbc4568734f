"""Finds this computer's address on the link, and notices addresses that are newer than ROS in this process."""

from __future__ import annotations

import math
import time
from ipaddress import ip_address
from typing import TYPE_CHECKING

from arpd.host.config.yaml_source import YamlSource
from arpd.host.interface import running_addresses
from arpd.host.kernel import ends_of_route, leads_here
from arpd.model.errors import LinkError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from arpd.model.settings import LinkDomain

_LOOK_S = 1.0
_SETTLED_S = 3.0  # a new interface gets its addresses one by one
_MOVED_S = 10.0  # in a shorter outage of Wi-Fi the route may lead elsewhere for a while, and the process bridges it


class Addresses:
    """Notices that the link interface has an address that ROS in this process does not use.

    Fast DDS 2.14 reads the addresses of its host once per process, without those of interfaces that are down. Measured:
    a node that is older than the link's address, or than its carrier, sends nothing over the link, and neither does a
    second node of the same process; the peer hears a new process within seconds. Make one of these before ROS starts,
    and ask it afterwards: ROS knows for certain only what is there both times.

    Parameters
    ----------
    interface : returns the current name of the link interface
    own : returns this computer's address on the link, the only one that the other end is told; None = all of them
    addresses : returns the addresses of every interface that is up
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        interface: Callable[[], str],
        *,
        own: Callable[[], str | None] = lambda: None,
        addresses: Callable[[], Mapping[str, frozenset[str]]] = running_addresses,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._interface = interface
        self._own, self._told = own, own()
        self._addresses = addresses
        self._clock = clock
        self._known = frozenset[str]().union(*addresses().values())
        self._new: frozenset[str] = frozenset()
        self._new_since_s = self._looked_s = -math.inf
        self._moved_s = math.inf

    def are_outdated(self) -> bool:
        """Return whether the link has had a new address for 3 s, or another one for 10 s; cheap enough for a tick."""
        if (now_s := self._clock()) - self._looked_s >= _LOOK_S:
            addresses = self._addresses()
            if self._looked_s == -math.inf:
                self._known &= frozenset[str]().union(*addresses.values())
            self._looked_s = now_s
            new = addresses.get(self._interface(), frozenset()) - self._known
            has_moved = self._told is not None and self._own() not in {None, self._told}
            self._moved_s = min(self._moved_s, now_s) if has_moved else math.inf
            if new != self._new:
                self._new, self._new_since_s = new, now_s
        return (bool(self._new) and now_s - self._new_since_s >= _SETTLED_S) or now_s - self._moved_s >= _MOVED_S

    def error(self) -> LinkError:
        """Return the error that ends the process, because only a new process uses the address."""
        return LinkError(f"{self._interface()} has an address that ROS in this process cannot use; start it again")


def own_address(file: Path | None, link: LinkDomain | None, *, is_far: bool) -> Callable[[], str | None]:
    """Return what finds this computer's address on the link, None where none is known.

    It is the one that is configured, or where that is not this computer's, the one from which a route leads to the
    other end. Host names are looked up now, once; one that both computers have leads to this one.

    Raises
    ------
    ConfigError
        If the file has an address of this computer for the other end, and none for this one. On loopback both are.
    """
    names = {link.own: True, link.peer: False} if link else {}
    ends = {name: found for name in names if name and (found := ends_of_route(name))}
    if link and file and (other := ends.get(link.peer)) and leads_here(other):
        own = ends.get(link.own)
        if ip_address(other[1]).is_loopback:
            is_meant = own is None or ip_address(own[1]).is_loopback
        else:
            is_meant = own is not None and leads_here(own)
        if not is_meant:
            key, programs = ("robot", "arpd and arpd-relay") if is_far else ("base", "arpd-peer and arpd-relay-far")
            check = "arpd check" if is_far else "arpd check --far"
            wrong = f"{link.peer} is an address of this computer, where {programs} belong"
            wrong += f"; start those ({check} is for them), or correct it"
            source = YamlSource(file)
            raise source.error([source.fault(("relay", key), wrong)])

    def find() -> str | None:
        for name, (_, end) in ends.items():
            source, address = ends_of_route(end) or ("127.0.0.1", "")
            if not ip_address(source).is_loopback and (source == address) is names[name]:
                return source
        return None

    return find
