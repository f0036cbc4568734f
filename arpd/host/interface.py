"""Reads the link interface of this host, also after it was made anew, and the host's memory."""

from __future__ import annotations

import logging
import math
import os
import socket
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import psutil

from arpd.host.netlink import read_counters
from arpd.model.interface import InterfaceState, LinkCounters, state_of
from arpd.model.observation import MemoryState
from arpd.model.settings import AUTO

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

T = TypeVar("T")
log = logging.getLogger(__name__)
SYS_NET = Path("/sys/class/net")
_PROC_ROUTE = Path("/proc/net/route")  # the main table: a VPN that takes all traffic by rules of its own is not in it
_DISCARD_PORT = 9  # nothing is sent there
_COUNTERS = ("rx_bytes", "tx_bytes", "rx_packets", "tx_packets", "tx_dropped")
_CHOOSE_S, _LOST_S = 1.0, 10.0
_ADDRESS_S, _RENEWED_S = 1.0, 3.0  # between two looks at the addresses, and for one that comes back
_UNKNOWN = MemoryState(total_bytes=0, available_bytes=0)  # so plan for little


def list_interfaces() -> list[str] | None:
    """Return the names of this host's network interfaces, None if the kernel does not tell."""
    try:
        return sorted(name for _, name in socket.if_nameindex())
    except OSError:
        return None


def index_of(name: str) -> int | None:
    """Return the kernel's number of an interface, None if there is none of that name."""
    try:
        return socket.if_nametoindex(name)
    except OSError:
        return None


def likeliest_interface() -> str | None:
    """Return the interface that ``auto`` means now, None if none stands out.

    It is a wireless interface that is up, else the interface of the default route, else the only one besides loopback.
    """
    if radios := running_radios():
        return radios[0]
    others = [name for name in list_interfaces() or () if name != "lo"]
    if (routed := _default_route()) in others:
        return routed
    return others[0] if len(others) == 1 else None


def interface_to(address: str) -> str | None:
    """Return the interface of the route to an address or a host name, None if there is none. Nothing is sent."""
    own: str | None = of_route(address, lambda route: route.getsockname()[0])
    return next((name for name, addresses in ipv4_addresses().items() if own in addresses), None)


def of_route(address: str, read: Callable[[socket.socket], T]) -> T | None:
    """Return what a socket with a route to an address or a host name tells, None without a route. Nothing is sent."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as route:
            route.connect((address, _DISCARD_PORT))
            return read(route)
    except (OSError, UnicodeError):  # a name with an empty label cannot be asked for
        return None


def _default_route() -> str:
    """Return the interface of the IPv4 default route (/proc/net/route, proc_net(5)), empty if there is none."""
    try:
        lines = _PROC_ROUTE.read_text(errors="replace").splitlines()[1:]
    except OSError:
        return ""
    fields = (line.split() for line in lines)
    return next((field[0] for field in fields if len(field) > 1 and field[1] == "00000000"), "")


def is_radio(name: str) -> bool:
    """Return whether an interface is a radio."""
    return os.access(SYS_NET / name / "wireless", os.F_OK)  # `Path.exists` raises where a sandbox hides /sys


def is_port(name: str) -> bool:
    """Return whether an interface is a port of a bridge, which then has its address."""
    return os.access(SYS_NET / name / "master", os.F_OK)  # as above


def running_radios() -> list[str]:
    """Return the radios that have a carrier."""
    return [
        name for name in list_interfaces() or () if is_radio(name) and (found := read_counters(name)) and found.is_up
    ]


def hardware_address(name: str) -> str:
    """Return an interface's Ethernet address as lower-case hexadecimal digits, empty if none is known."""
    try:
        digits = (SYS_NET / name / "address").read_text().strip().replace(":", "")
    except OSError:
        return ""
    return digits if digits.strip("0") else ""


def ipv4_addresses() -> dict[str, frozenset[str]]:
    """Return the IPv4 addresses of every interface that has any; empty if the kernel does not answer."""
    try:
        every = psutil.net_if_addrs()
    except OSError:
        return {}
    found: dict[str, frozenset[str]] = {}
    for label, addresses in every.items():
        name = label.partition(":")[0]  # glibc tells the label of an address, as eth0:1, for the name of its interface
        own = {address.address for address in addresses if address.family == socket.AF_INET}
        found[name] = found.get(name, frozenset()) | own
    return {name: own for name, own in found.items() if own}


def running_addresses() -> dict[str, frozenset[str]]:
    """Return the IPv4 addresses of every interface that is up and has a carrier: those that Fast DDS takes."""
    try:
        states = psutil.net_if_stats()
    except OSError:
        return {}
    return {name: addresses for name, addresses in ipv4_addresses().items() if name in states and states[name].isup}


class InterfaceReader:
    """Reads one interface repeatedly.

    An interface that returns under its name continues the old totals. ``auto`` may mean another one later: until one
    was up; if it was no radio, when a radio comes, when it has been away for ten seconds, as a cable that a robot boots
    with, or when the route has led elsewhere as long, as back to a bridge that started again; and another radio, or the
    one that gets the address, in the place of one that is gone, because that was renamed, or replaced.

    Parameters
    ----------
    name : the interface, as configured
    read : the kernel's answer
    route : returns the interface of the route to the other end, None where that is not known
    choose : returns the interface that ``auto`` means without a route, None = none yet
    is_radio : whether an interface is one
    addresses : returns the addresses of every interface
    clock : monotonic clock (s)

    Attributes
    ----------
    name : of the interface; ``auto`` before there was one
    state : when it was read last
    """

    def __init__(
        self,
        name: str,
        *,
        read: Callable[[str], LinkCounters | None] = read_counters,
        route: Callable[[], str | None] = lambda: None,
        choose: Callable[[], str | None] = likeliest_interface,
        is_radio: Callable[[str], bool] = is_radio,
        addresses: Callable[[], Mapping[str, frozenset[str]]] = ipv4_addresses,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = name
        self._read = read
        self._route, self._choose, self._is_radio = route, choose, is_radio
        self._clock = clock
        self._may_choose = self._is_auto = name == AUTO
        self._was_up = False
        self._away_s = math.inf  # since when it is not up
        self._elsewhere_s = math.inf  # since when the route leads to another one
        self._chosen_s = -math.inf  # when another one was looked for
        self._addresses = addresses
        self._own: frozenset[str] = frozenset()  # addresses that the interface had last
        self._addressed_s = math.inf  # when it, or one in its place, had any last
        self._looked_s = -math.inf
        self._raw: LinkCounters | None = None
        self._total: LinkCounters | None = None
        self.state = InterfaceState.GONE

    def read(self) -> LinkCounters | None:
        """Return counters, which never fall, and state; None while the interface is gone."""
        now_s = self._clock()
        may_choose = self._may_choose or (self._is_auto and self._raw is None)
        if may_choose and (not self._was_up or now_s - self._chosen_s >= _CHOOSE_S):
            self._choose_again(now_s)
        if (raw := self._read(self.name)) is None and self._is_auto and (heir := self._heir()):
            log.info("link.interface is auto: %s has the address of %s, so arpd uses it", heir, self.name)
            self.name, raw = heir, self._read(heir)
        if raw is not None and raw.is_up and self._has_lost_address(now_s):
            raw = replace(raw, state=InterfaceState.NO_ADDRESS)
        if raw is not None:
            # The first reading of an interface adds nothing, because its past traffic is not the link's.
            self._total = _continued(self._total or raw, self._raw or raw, raw)
        if raw is not None and raw.is_up:
            self._was_up, self._away_s = True, math.inf
            self._may_choose = self._may_choose and not self._is_radio(self.name)
        else:
            self._away_s = min(self._away_s, now_s)
        self._raw = raw
        self.state = state_of(raw)
        return raw and self._total

    def _heir(self) -> str:
        """Return the interface that has an address of this one, which is gone; empty if there is none."""
        every = self._addresses() if self._own else {}
        return next((name for name, addresses in every.items() if addresses & self._own), "")

    def _has_lost_address(self, now_s: float) -> bool:
        if now_s - self._looked_s >= _ADDRESS_S or not self._own:
            self._looked_s, every = now_s, self._addresses()
            self._own = every.get(self.name) or self._own
            if not every or any(self._own & each for each in every.values()):  # a bridge takes that of its port
                self._addressed_s = now_s
        return now_s - self._addressed_s >= _RENEWED_S and not is_port(self.name)

    def _choose_again(self, now_s: float) -> None:
        self._chosen_s = now_s
        route = self._route()
        self._elsewhere_s = math.inf if route in {None, self.name} else min(self._elsewhere_s, now_s)
        if (chosen := route or self._choose()) is None or chosen == self.name:
            return
        is_lost = self._may_choose and now_s - min(self._away_s, self._elsewhere_s) >= _LOST_S
        if not self._was_up or is_lost or self._is_radio(chosen):
            log.info("link.interface is auto: arpd uses %s", chosen)
            self.name, self._raw, self._own, self._addressed_s = chosen, None, frozenset(), math.inf


def _continued(total: LinkCounters, before: LinkCounters, now: LinkCounters) -> LinkCounters:
    """Continue totals from one reading to the next; none of them falls.

    A counter that falls has wrapped, or its driver or queue has started again. Nobody knows what it counted since the
    last reading, so it adds nothing.
    """
    grown = {name: max(0, getattr(now, name) - getattr(before, name)) for name in _COUNTERS}
    return replace(now, **{name: getattr(total, name) + more for name, more in grown.items()})


def read_memory(before: MemoryState = _UNKNOWN) -> MemoryState:
    """Return the host's memory, in all and for new work; what was read before while the kernel does not answer."""
    try:
        memory = psutil.virtual_memory()
    except (OSError, ValueError):
        return before
    return MemoryState(total_bytes=memory.total, available_bytes=memory.available)


def read_number(path: Path) -> int | None:
    """Return the number in a file of the kernel's, None if there is none."""
    try:
        return int(path.read_text())
    except (OSError, ValueError):
        return None
