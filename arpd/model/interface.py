"""The robot's link interface as the kernel shows it: its counters, and the state it is in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

_COUNTERS = ("rx_bytes", "tx_bytes", "rx_packets", "tx_packets", "tx_dropped")


class InterfaceState(StrEnum):
    """Whether an interface can carry anything, and if not, why not."""

    UP = "up"
    NO_CARRIER = "no_carrier"  # switched on, and no cable or no access point
    DOWN = "down"  # switched off
    GONE = "gone"  # no such interface, under this name or another

    @property
    def fault(self) -> str:
        """Why nothing is carried, to be said after the interface's name; empty when something is."""
        return _FAULTS[self]


_FAULTS = {
    InterfaceState.UP: "",
    InterfaceState.NO_CARRIER: "has no carrier",
    InterfaceState.DOWN: "is switched off",
    InterfaceState.GONE: "is gone",
}


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkCounters:
    """Counters of an interface, as `arpd.adapters.host.interface` follows them.

    Parameters
    ----------
    interface : the name it has now
    rx_bytes, tx_bytes : counters that never fall, whatever becomes of the interface (bytes)
    rx_packets, tx_packets : the same (packets)
    tx_dropped : packets the interface or its queue dropped on the way out, the same
    state : what it can do now; never GONE, for then there is nothing to count
    backlog_bytes : what waits in the interface's own queue (its qdisc), None where the kernel does not tell (bytes)
    """

    interface: str
    rx_bytes: int
    tx_bytes: int
    rx_packets: int
    tx_packets: int
    tx_dropped: int
    state: InterfaceState
    backlog_bytes: int | None = None

    @property
    def is_up(self) -> bool:
        """Whether it can carry anything."""
        return self.state is InterfaceState.UP


def state_of(counters: LinkCounters | None) -> InterfaceState:
    """Name the state of an interface that was just read; None = it could not be."""
    return InterfaceState.GONE if counters is None else counters.state


def continue_counters(total: LinkCounters, before: LinkCounters, now: LinkCounters) -> LinkCounters:
    """Carry totals on from one raw reading to the next, past counters that started anew.

    A counter of 32 bits wraps, and it wraps alone: bytes run ahead of packets, and one direction of the other. What
    starts at zero because the driver or the interface itself did takes the other counters with it. So a lone counter
    that falls from the upper half of 32 bits went on behind 2^32, and any other fall began at zero.

    Parameters
    ----------
    total : what was told last
    before, now : raw readings, one after the other

    Returns
    -------
    The totals now; each is at least what it was.
    """
    fallen = [name for name in _COUNTERS if getattr(now, name) < getattr(before, name)]
    is_wrap = len(fallen) == 1 and 2**31 <= getattr(before, fallen[0]) < 2**32
    grown = {name: getattr(now, name) - getattr(before, name) for name in _COUNTERS}
    for name in fallen:
        grown[name] = grown[name] + 2**32 if is_wrap else getattr(now, name)
    totals = {name: getattr(total, name) + grown[name] for name in _COUNTERS}
    return replace(now, **totals)
