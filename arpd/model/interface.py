"""State and counters of the robot's link interface, as the kernel shows them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class InterfaceState(StrEnum):
    """Ability of an interface to carry anything."""

    UP = "up"
    NO_CARRIER = "no_carrier"  # switched on, without a cable or an access point
    DOWN = "down"  # switched off
    NO_ADDRESS = "no_address"  # it had one, which no interface has now
    GONE = "gone"  # no such interface, under this or another name

    @property
    def fault(self) -> str:
        """Reason why nothing is carried, to follow the interface's name; empty when it is up."""
        return _FAULTS[self]


_FAULTS = {
    InterfaceState.UP: "",
    InterfaceState.NO_CARRIER: "has no carrier",
    InterfaceState.DOWN: "is switched off",
    InterfaceState.NO_ADDRESS: "has lost its IPv4 address",
    InterfaceState.GONE: "is gone",
}


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkCounters:
    """Counters of an interface, as `arpd.host.interface` follows them.

    Parameters
    ----------
    interface : its name now
    rx_bytes, tx_bytes, rx_packets, tx_packets : counters that never fall, even if the interface is made again
    tx_dropped : the same for packets that the interface or its queue dropped before they left
    state : its state; never GONE, because then there is nothing to count
    backlog_bytes : bytes that wait in the interface's own queue (its qdisc), None where the kernel does not tell
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
        """True while it can carry anything."""
        return self.state is InterfaceState.UP


def state_of(counters: LinkCounters | None) -> InterfaceState:
    """Return the state of an interface that was just read; None = it could not be read."""
    return InterfaceState.GONE if counters is None else counters.state
