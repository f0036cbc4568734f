"""The robot's link interface as the kernel shows it: its counters, and the state it is in."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class InterfaceState(StrEnum):
    """Whether an interface can carry anything, and if not, why not."""

    UP = "up"
    NO_CARRIER = "no_carrier"  # switched on, and no cable or no access point
    DOWN = "down"  # switched off
    GONE = "gone"  # no interface of that name


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkCounters:
    """Counters of an interface, as psutil reads them.

    Parameters
    ----------
    interface : its name
    rx_bytes, tx_bytes : counters that never fall while the interface lives (bytes)
    rx_packets, tx_packets : the same (packets)
    tx_dropped : packets the interface dropped on the way out
    state : what it can do now; never GONE, for then there is nothing to count
    """

    interface: str
    rx_bytes: int
    tx_bytes: int
    rx_packets: int
    tx_packets: int
    tx_dropped: int
    state: InterfaceState

    @property
    def is_up(self) -> bool:
        """Whether it can carry anything."""
        return self.state is InterfaceState.UP
