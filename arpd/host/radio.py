"""Reads the bit rate at which a Wi-Fi interface transmits, through nl80211; it bounds the capacity estimate."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

log = logging.getLogger(__name__)

_SYS_NET = Path("/sys/class/net")
_BYTES_PER_S = 100_000 / 8  # nl80211 counts in 100 kbit/s (linux/nl80211.h, NL80211_RATE_INFO_BITRATE32)


def ask_stations(index: int) -> list[Any]:
    """Return nl80211's answers about the stations of an interface: its access point, or each of its clients."""
    from pyroute2.iwutil import IW  # noqa: PLC0415 - takes a quarter of a second, and only a radio needs it

    with IW() as nl80211:
        return list(nl80211.get_stations(index))


def transmit_rate(stations: Iterable[Any]) -> float | None:
    """Return the bit rate of the physical layer, None if no station has one (bytes/s).

    It is the rate of the fastest station, because any of them may be the peer and the bound must hold.

    Parameters
    ----------
    stations : answers to NL80211_CMD_GET_STATION, as pyroute2 decodes them
    """
    rates = [_rate_of(station) for station in stations]
    return max((rate * _BYTES_PER_S for rate in rates if rate), default=None)


def _rate_of(station: Any) -> int | None:
    info = station.get_attr("NL80211_ATTR_STA_INFO")
    rate = info and info.get_attr("NL80211_STA_INFO_TX_BITRATE")
    if not rate:
        return None
    # The older attribute has 16 bits, and the kernel leaves it out above 6.5 Gbit/s.
    found: int | None = rate.get_attr("NL80211_RATE_INFO_BITRATE32") or rate.get_attr("NL80211_RATE_INFO_BITRATE")
    return found


class Radio:
    """Reads the radio of an interface and logs each reason for an unknown rate once.

    Parameters
    ----------
    ask : asks nl80211 about the interface with a number of the kernel
    sys_net : folder where the kernel lists interfaces
    """

    def __init__(self, *, ask: Callable[[int], Iterable[Any]] = ask_stations, sys_net: Path = _SYS_NET) -> None:
        self._ask = ask
        self._sys_net = sys_net
        self._said = ""

    def read(self, interface: str, index: int | None) -> float | None:
        """Return the bit rate at which the radio transmits, None if there is no radio or no answer (bytes/s).

        Parameters
        ----------
        interface, index : name and kernel's number of the interface, None = gone
        """
        if index is None or not (self._sys_net / interface / "phy80211").exists():
            return None
        try:
            return transmit_rate(self._ask(index))
        except Exception as error:  # noqa: BLE001 - permission, driver or pyroute2; arpd works without the bound
            if (said := f"{type(error).__name__}: {error}") != self._said:
                self._said = said
                log.info("cannot read the bit rate of the radio of %s (%s); arpd goes without it", interface, said)
            return None
