"""The link interface of this host, followed through what can happen to it, and the host's memory."""

from __future__ import annotations

import logging
import re
import socket
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil

from arpd.adapters.host.netlink import read_backlog, read_device
from arpd.model.interface import InterfaceState, LinkCounters, continue_counters, state_of
from arpd.model.observation import MemoryState
from arpd.model.settings import AUTO

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

log = logging.getLogger(__name__)
_SYS_NET = Path("/sys/class/net")
_PROC_ROUTE = Path("/proc/net/route")


def likeliest_interface(
    *,
    sys_net: Path = _SYS_NET,
    route: Path = _PROC_ROUTE,
    names: Callable[[], Mapping[str, Any]] | None = None,
) -> str | None:
    """Return the interface that ``auto`` takes now, None when nothing tells.

    It is a wireless interface that is up, else the interface of the default route, else the only one besides loopback.

    Parameters
    ----------
    sys_net, route, names : the kernel's answers, for tests to give others
    """
    try:
        stats = (names or psutil.net_if_stats)()
    except OSError:
        return None
    others = [name for name in sorted(stats) if name != "lo"]
    for name in others:
        if (sys_net / name / "wireless").exists() and stats[name].isup:
            return name
    routed = _default_route(route)
    if routed in others:
        return routed
    return others[0] if len(others) == 1 else None


def read_counters(name: str) -> LinkCounters | None:
    """Return the counters an interface has now, as the kernel keeps them; None when there is none of that name.

    What its queue drops counts as dropped by the interface; drivers do not count it.
    """
    if (index := index_of(name)) is None or (device := read_device(index)) is None:
        return None
    queue = read_backlog(index)
    without_carrier = InterfaceState.NO_CARRIER if device.is_up else InterfaceState.DOWN
    return LinkCounters(
        interface=name,
        rx_bytes=device.rx_bytes,
        tx_bytes=device.tx_bytes,
        rx_packets=device.rx_packets,
        tx_packets=device.tx_packets,
        tx_dropped=device.tx_dropped + (queue.dropped_packets if queue else 0),
        backlog_bytes=queue.waiting_bytes if queue else None,
        state=InterfaceState.UP if device.is_running else without_carrier,
    )


def hardware_address(name: str) -> str:
    """Return an interface's Ethernet address as lower-case hexadecimal digits, empty when it has none."""
    addresses = psutil.net_if_addrs().get(name, [])
    found = next((address.address for address in addresses if address.family == psutil.AF_LINK), "")
    digits = re.sub("[^0-9a-f]", "", found.lower())
    return digits if digits.strip("0") else ""


def ipv4_addresses() -> dict[str, frozenset[str]]:
    """Return the IPv4 addresses of every interface that has any; none when the kernel does not tell."""
    try:
        every = psutil.net_if_addrs()
    except OSError:
        return {}
    found = {
        name: frozenset(address.address for address in addresses if address.family == socket.AF_INET)
        for name, addresses in every.items()
    }
    return {name: addresses for name, addresses in found.items() if addresses}


def index_of(name: str) -> int | None:
    """Return the kernel's number of an interface, None when there is none of that name."""
    try:
        return socket.if_nametoindex(name)
    except OSError:
        return None


def name_of(index: int) -> str | None:
    """Return the name of an interface, None when there is none of that number."""
    try:
        return socket.if_indextoname(index)
    except OSError:
        return None


class InterfaceReader:
    """Reads one interface again and again; what happens to it is a state, said once in the log.

    The kernel's number tells an interface from its name: one that is renamed is followed, and one that comes back
    under its first or its last name is taken on, with totals that go on where they stood. It may come late, too: what
    ``auto`` stands for is chosen anew until the interface chosen has been up once.

    Parameters
    ----------
    name : the interface, as configured
    read, index_of, name_of : the kernel's answers, for tests to give others
    choose : what ``auto`` stands for now, None = nothing yet
    note : told of a change of its state or its name, with a logging level; it is logged by default
    """

    def __init__(
        self,
        name: str,
        *,
        read: Callable[[str], LinkCounters | None] = read_counters,
        index_of: Callable[[str], int | None] = index_of,
        name_of: Callable[[int], str | None] = name_of,
        choose: Callable[[], str | None] = likeliest_interface,
        note: Callable[[int, str], None] = log.log,
    ) -> None:
        self._configured = self._name = name
        self._read = read
        self._index_of = index_of
        self._name_of = name_of
        self._choose = choose
        self._note = note
        self._is_open = name == AUTO  # to another choice
        self._index: int | None = None
        self._raw: LinkCounters | None = None
        self._total: LinkCounters | None = None
        self._state: InterfaceState | None = None

    @property
    def name(self) -> str:
        """The name it has now, or had last; ``auto`` before there was any."""
        return self._name

    @property
    def index(self) -> int | None:
        """The kernel's number of the interface, None while it is gone."""
        return self._index

    def read(self) -> LinkCounters | None:
        """Return counters and state, None while the interface is gone; the counters never fall."""
        if self._is_open:
            self._take_choice()
        name = self._find()
        raw = None if name is None else self._read(name)
        if raw is not None:
            # Of an interface that is new to us, the past is not the link's.
            self._total = continue_counters(self._total or raw, self._raw or raw, raw)
            self._raw = raw
            self._is_open = self._is_open and not raw.is_up
        self._note_state(state_of(raw))
        return raw and self._total

    def _take_choice(self) -> None:
        if (chosen := self._choose()) is not None and chosen != self._configured:
            log.info("link.interface is auto: %s is the link", chosen)
            self._configured = self._name = chosen
            self._index = self._raw = self._total = self._state = None

    def _find(self) -> str | None:
        name = None if self._index is None else self._name_of(self._index)
        if name is None:
            found = ((candidate, self._index_of(candidate)) for candidate in (self._configured, self._name))
            name, self._index = next(((name, index) for name, index in found if index is not None), (None, None))
            self._raw = None
        elif name != self._name:
            self._note(logging.WARNING, f"the link interface {self._name} is now called {name}, and is followed")
        self._name = name or self._name
        return name

    def _note_state(self, state: InterfaceState) -> None:
        before, self._state = self._state, state
        if state is before or (before is None and state is InterfaceState.UP):
            return
        if self._total is not None:
            level = logging.WARNING if state.fault else logging.INFO
            self._note(level, f"the link interface {self._name} {state.fault or 'is up again'}")
        elif self._name == AUTO:
            yet = "link.interface is auto, and no interface looks like the link yet; it is taken when it comes"
            self._note(logging.WARNING, yet)
        else:
            self._note(logging.WARNING, f"the link interface {self._name} is not there yet; it is taken when it comes")


class MemoryReader:
    """Reads the host's memory; while the kernel does not tell, what it told last stands.

    Parameters
    ----------
    read : psutil's answer, for tests to give another
    """

    def __init__(self, read: Callable[[], Any] = psutil.virtual_memory) -> None:
        self._read = read
        self._last = MemoryState(total_bytes=0, available_bytes=0)  # not known yet: plan for little
        self._fault = ""

    def read(self) -> MemoryState:
        """Return the memory there is, and what new work could have of it."""
        try:
            memory = self._read()
        except (OSError, ValueError) as error:
            if (fault := str(error)) != self._fault:
                self._fault = fault
                log.warning("the kernel does not tell of its memory (%s); what it told last stands", fault)
            return self._last
        self._fault = ""
        self._last = MemoryState(total_bytes=memory.total, available_bytes=memory.available)
        return self._last


def _default_route(route: Path) -> str:
    """Interface of the IPv4 default route (/proc/net/route, proc_net(5)), empty if there is none."""
    try:
        lines = route.read_text().splitlines()[1:]
    except OSError:
        return ""
    fields = (line.split() for line in lines)
    return next((field[0] for field in fields if len(field) > 1 and field[1] == "00000000"), "")


def list_interfaces() -> list[str]:
    """Return the names of this host's network interfaces."""
    return sorted(psutil.net_if_stats())


def read_speed(name: str, *, sys_net: Path = _SYS_NET) -> float | None:
    """Return the nominal rate of an interface, None where there is none or it means nothing (bytes/s).

    Only hardware knows its own: a tunnel reports 10 Mbit/s whatever it runs over, a radio nothing.
    """
    if not (sys_net / name / "device").exists():
        return None
    try:
        stats = psutil.net_if_stats().get(name)
    except OSError:  # it vanished between two of psutil's questions
        return None
    return stats.speed * 1e6 / 8 if stats is not None and stats.speed > 0 else None
