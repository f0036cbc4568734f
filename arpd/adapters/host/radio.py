"""The bit rate a Wi-Fi interface transmits at, through nl80211: no estimate, but a bound for one."""

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
    """Return what nl80211 tells of the stations an interface talks to: the access point, or each of its clients."""
    from pyroute2.iwutil import IW  # noqa: PLC0415 - a quarter of a second, and only where there is a radio

    with IW() as nl80211:
        return list(nl80211.get_stations(index))


def transmit_rate(stations: Iterable[Any]) -> float | None:
    """Return the bit rate of the physical layer, None when no station tells one (bytes/s).

    With several stations, it is that of the fastest: which of them is the peer is not known, and a bound must hold.

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
    """Reads the radio of an interface; every reason not to know its rate is None, and is said once in the log.

    Parameters
    ----------
    ask : asks nl80211 about an interface, by the kernel's number
    sys_net : where the kernel lists interfaces
    """

    def __init__(self, *, ask: Callable[[int], Iterable[Any]] = ask_stations, sys_net: Path = _SYS_NET) -> None:
        self._ask = ask
        self._sys_net = sys_net
        self._said = ""

    def read(self, interface: str, index: int | None) -> float | None:
        """Return the bit rate that the radio transmits at, None where there is no radio or it does not tell (bytes/s).

        Parameters
        ----------
        interface, index : name and the kernel's number of the interface; None = it is gone
        """
        if index is None or not (self._sys_net / interface / "phy80211").exists():
            return None
        try:
            return transmit_rate(self._ask(index))
        except Exception as error:  # noqa: BLE001 - permission, driver, pyroute2: a bound is not worth a daemon
            if (said := f"{type(error).__name__}: {error}") != self._said:
                self._said = said
                log.info("the radio of %s does not tell its bit rate (%s); the estimate goes without", interface, said)
            return None
