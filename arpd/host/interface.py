"""Reads the link interface of this host, also after renames and replacements, and the host's memory."""

from __future__ import annotations

import fcntl
import logging
import os
import re
import socket
import struct
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil

from arpd.host.netlink import read_backlog
from arpd.model.interface import InterfaceState, LinkCounters, continue_counters, state_of
from arpd.model.observation import MemoryState
from arpd.model.settings import AUTO

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

log = logging.getLogger(__name__)
_SYS_NET = Path("/sys/class/net")
_PROC_ROUTE = Path("/proc/net/route")
_TRIES = 2  # a rename between two questions costs one
# linux/sockios.h, linux/if.h
_GET_FLAGS = 0x8913
_REQUEST = struct.Struct("16sH22x")  # name, flags
_UP, _RUNNING = 0x1, 0x40


def likeliest_interface(
    *,
    sys_net: Path = _SYS_NET,
    route: Path = _PROC_ROUTE,
    names: Callable[[], Collection[str] | None] | None = None,
    is_running: Callable[[str], bool] | None = None,
) -> str | None:
    """Return the interface that ``auto`` means now, None if none stands out.

    It is a wireless interface that is up, else the interface of the default route, else the only one besides loopback.

    Parameters
    ----------
    sys_net, route, names, is_running : sources of the kernel's answers
    """
    others = [name for name in sorted((names or list_interfaces)() or ()) if name != "lo"]
    for name in others:
        if (sys_net / name / "wireless").exists() and (is_running or _is_running)(name):
            return name
    routed = _default_route(route)
    if routed in others:
        return routed
    return others[0] if len(others) == 1 else None


def read_counters(index: int) -> LinkCounters | None:
    """Return the kernel's counters of an interface, by its number; None if there is none.

    They include the drops of the queue, which drivers do not count. psutil reads all interfaces at once: 25 µs with
    one, 180 µs with 30. Its ``nowrap`` is off because it goes by name, so two interfaces that swap names would jump;
    `InterfaceReader` goes by number.
    """
    for _ in range(_TRIES):
        try:
            name = socket.if_indextoname(index)
            device = psutil.net_io_counters(pernic=True, nowrap=False)[name]
            flags = _read_flags(name)
        except (OSError, KeyError):
            continue
        queue = read_backlog(index)
        without_carrier = InterfaceState.NO_CARRIER if flags & _UP else InterfaceState.DOWN
        return LinkCounters(
            interface=name,
            rx_bytes=device.bytes_recv,
            tx_bytes=device.bytes_sent,
            rx_packets=device.packets_recv,
            tx_packets=device.packets_sent,
            tx_dropped=device.dropout + (queue.dropped_packets if queue else 0),
            backlog_bytes=queue.waiting_bytes if queue else None,
            state=InterfaceState.UP if flags & _RUNNING else without_carrier,
        )
    return None


def _read_flags(name: str) -> int:
    """Return the flags of an interface (netdevice(7)), without what `psutil.net_if_stats` asks all drivers besides."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        answer = fcntl.ioctl(asked, _GET_FLAGS, _REQUEST.pack(os.fsencode(name), 0))
    _, flags = _REQUEST.unpack(answer)
    return int(flags)


def hardware_address(name: str) -> str:
    """Return an interface's Ethernet address as lower-case hexadecimal digits, empty if none is known."""
    try:
        addresses = psutil.net_if_addrs().get(name, [])
    except OSError:
        return ""
    found = next((address.address for address in addresses if address.family == psutil.AF_LINK), "")
    digits = re.sub("[^0-9a-f]", "", found.lower())
    return digits if digits.strip("0") else ""


def ipv4_addresses() -> dict[str, frozenset[str]]:
    """Return the IPv4 addresses of every interface that has any; empty if the kernel does not answer."""
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
    """Return the kernel's number of an interface, None if there is none of that name."""
    try:
        return socket.if_nametoindex(name)
    except OSError:
        return None


class InterfaceReader:
    """Reads one interface repeatedly and logs each change of its state once.

    The reader follows a renamed interface by the kernel's number. An interface that returns under its first or its last
    name continues the old totals. The interface may appear late: the reader chooses again for ``auto`` until the chosen
    interface has been up once.

    Parameters
    ----------
    name : the interface, as configured
    read, index_of : the kernel's answers, by number and by name
    choose : returns the interface that ``auto`` means now, None = none yet
    note : called with a logging level and a text at every change of state or name
    """

    def __init__(
        self,
        name: str,
        *,
        read: Callable[[int], LinkCounters | None] = read_counters,
        index_of: Callable[[str], int | None] = index_of,
        choose: Callable[[], str | None] = likeliest_interface,
        note: Callable[[int, str], None] = log.log,
    ) -> None:
        self._configured = self._name = name
        self._read = read
        self._index_of = index_of
        self._choose = choose
        self._note = note
        self._may_choose = name == AUTO
        self._index: int | None = None
        self._raw: LinkCounters | None = None
        self._total: LinkCounters | None = None
        self._state: InterfaceState | None = None

    @property
    def name(self) -> str:
        """Current or last name; ``auto`` before there was an interface."""
        return self._name

    @property
    def index(self) -> int | None:
        """Kernel's number of the interface, None while it is gone."""
        return self._index

    def read(self) -> LinkCounters | None:
        """Return counters, which never fall, and state; None while the interface is gone."""
        if self._may_choose:
            self._take_choice()
        if (raw := self._find()) is not None:
            # The first reading of an interface adds nothing, because its past traffic is not the link's.
            self._total = continue_counters(self._total or raw, self._raw or raw, raw)
            self._raw = raw
            self._may_choose = self._may_choose and not raw.is_up
        self._note_state(state_of(raw))
        return raw and self._total

    def _take_choice(self) -> None:
        if (chosen := self._choose()) is not None and chosen != self._configured:
            log.info("link.interface is auto: arpd uses %s", chosen)
            self._configured = self._name = chosen
            self._index = self._raw = self._total = self._state = None

    def _find(self) -> LinkCounters | None:
        raw = None if self._index is None else self._read(self._index)
        if raw is None:
            found = (self._index_of(name) for name in (self._configured, self._name))
            self._index = next((index for index in found if index is not None), None)
            self._raw = None
            raw = None if self._index is None else self._read(self._index)
        elif raw.interface != self._name:
            text = f"the link interface {self._name} is now called {raw.interface}; arpd follows it"
            self._note(logging.WARNING, text)
        self._name = raw.interface if raw is not None else self._name
        return raw

    def _note_state(self, state: InterfaceState) -> None:
        before, self._state = self._state, state
        if state is before or (before is None and state is InterfaceState.UP):
            return
        if self._total is not None:
            level = logging.WARNING if state.fault else logging.INFO
            self._note(level, f"the link interface {self._name} {state.fault or 'is up again'}")
        elif self._name == AUTO:
            text = "link.interface is auto and no interface looks like the link yet; arpd uses the first that does"
            self._note(logging.WARNING, text)
        else:
            self._note(logging.WARNING, f"the link interface {self._name} is not there yet; arpd waits for it")


class MemoryReader:
    """Reads the host's memory; while the kernel does not answer, the last values stay.

    Parameters
    ----------
    read : psutil's answer
    """

    def __init__(self, read: Callable[[], Any] = psutil.virtual_memory) -> None:
        self._read = read
        self._last = MemoryState(total_bytes=0, available_bytes=0)  # unknown, so plan for little

    def read(self) -> MemoryState:
        """Return the total memory and the memory available to new work."""
        with suppress(OSError, ValueError):
            memory = self._read()
            self._last = MemoryState(total_bytes=memory.total, available_bytes=memory.available)
        return self._last


def _default_route(route: Path) -> str:
    """Return the interface of the IPv4 default route (/proc/net/route, proc_net(5)), empty if there is none."""
    try:
        lines = route.read_text().splitlines()[1:]
    except OSError:
        return ""
    fields = (line.split() for line in lines)
    return next((field[0] for field in fields if len(field) > 1 and field[1] == "00000000"), "")


def list_interfaces() -> list[str] | None:
    """Return the names of this host's network interfaces, None if the kernel does not tell.

    `psutil.net_if_stats` also asks every driver for its speed, and fails as a whole where one such question is not
    possible, for example under qemu-user.
    """
    try:
        return sorted(name for _, name in socket.if_nameindex())
    except OSError:
        return None


def _is_running(name: str) -> bool:
    try:
        return bool(_read_flags(name) & _RUNNING)
    except OSError:
        return False
