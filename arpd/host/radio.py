"""Reads a Wi-Fi interface's bit rate, which bounds the capacity, power save, signal and region, through nl80211."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from arpd.host.interface import index_of
from arpd.host.kernel import read_number
from arpd.host.services import service_states
from arpd.model.errors import NotKnownError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

log = logging.getLogger(__name__)

T = TypeVar("T")
_SYS_NET = Path("/sys/class/net")
_NETWORK_MANAGER = "NetworkManager"
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
    rates = [info.get_attr("NL80211_STA_INFO_TX_BITRATE") for info in _infos(stations)]
    # The older attribute has 16 bits, and the kernel leaves it out above 6.5 Gbit/s.
    names = "NL80211_RATE_INFO_BITRATE32", "NL80211_RATE_INFO_BITRATE"
    found = [rate.get_attr(names[0]) or rate.get_attr(names[1]) for rate in rates if rate]
    return max((rate * _BYTES_PER_S for rate in found if rate), default=None)


def _infos(stations: Iterable[Any]) -> list[Any]:
    return [info for station in stations if (info := station.get_attr("NL80211_ATTR_STA_INFO"))]


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


def runs_network_manager() -> bool:
    """Return whether NetworkManager runs. Its folders also exist where netplan wrote for it and networkd runs."""
    unit = service_states(_NETWORK_MANAGER).get(_NETWORK_MANAGER)
    return unit is not None and unit.active == "active"


def ask_power_save(index: int) -> list[Any]:
    """Return nl80211's answer about power save of an interface."""
    return _ask("NL80211_CMD_GET_POWER_SAVE", [["NL80211_ATTR_IFINDEX", index]], is_dump=False)


def ask_regions(_index: int) -> list[Any]:
    """Return nl80211's answers about regulatory domains: the global one, and those of radios with their own."""
    return _ask("NL80211_CMD_GET_REG", [], is_dump=True)


def _ask(command: str, attributes: list[Any], *, is_dump: bool) -> list[Any]:
    from pyroute2.iwutil import IW  # noqa: PLC0415 - takes a quarter of a second, and only a radio needs it
    from pyroute2.netlink import NLM_F_DUMP, NLM_F_REQUEST  # noqa: PLC0415
    from pyroute2.netlink.nl80211 import NL80211_NAMES, nl80211cmd  # noqa: PLC0415

    message = nl80211cmd()
    message["cmd"] = NL80211_NAMES[command]
    message["attrs"] = attributes
    with IW() as nl80211:
        flags = NLM_F_REQUEST | (NLM_F_DUMP if is_dump else 0)
        return list(nl80211.nlm_request(message, msg_type=nl80211.prid, msg_flags=flags))


def power_save(interface: str, *, ask: Callable[[int], Iterable[Any]] = ask_power_save) -> bool:
    """Return whether a radio sleeps between beacons.

    Raises
    ------
    NotKnownError
        If nl80211 does not tell it; so do `signal` and `region`.
    """
    return _told("power save", interface, lambda index: _saves_power(ask(index)))


def signal(interface: str, *, ask: Callable[[int], Iterable[Any]] = ask_stations) -> int:
    """Return the strength of a radio's access point, or of the strongest station (dBm)."""
    return _told("a signal", interface, lambda index: _strongest(ask(index)))


def region(interface: str, *, ask: Callable[[int], Iterable[Any]] = ask_regions, sys_net: Path = _SYS_NET) -> str:
    """Return two letters of the regulatory domain in force, ``00`` = none is set."""
    radio = read_number(sys_net / interface / "phy80211/index")
    return _told("a regulatory domain", interface, lambda index: _region_of(ask(index), radio=radio))


def radios_of(interface: str, *, sys_net: Path = _SYS_NET) -> list[str]:
    """Return the interfaces with a radio that carry the link: itself, or those that are up beneath a tunnel."""
    if (sys_net / interface / "phy80211").exists():
        return [interface]
    if (sys_net / interface / "device").exists():
        return []
    return sorted(radio.parent.name for radio in sys_net.glob("*/phy80211") if _is_up(radio.parent / "operstate"))


def _is_up(path: Path) -> bool:
    try:
        return path.read_text().strip() == "up"
    except OSError:
        return False


def _saves_power(answers: Iterable[Any]) -> bool | None:
    """Return whether power save is on, None if no answer tells."""
    for answer in answers:
        told = answer.get_attr("NL80211_ATTR_PS_STATE")  # pyroute2 shows its bytes: 01:00:00:00
        if told:
            return int.from_bytes(bytes.fromhex(str(told).replace(":", "")), sys.byteorder) != 0
    return None


def _strongest(stations: Iterable[Any]) -> int | None:
    """Return the strongest signal of an access point or of several clients, None if none has one (dBm)."""
    names = "NL80211_STA_INFO_SIGNAL_AVG", "NL80211_STA_INFO_SIGNAL"
    found = [info.get_attr(names[0]) or info.get_attr(names[1]) for info in _infos(stations)]
    return max((signal for signal in found if signal), default=None)


def _region_of(answers: Iterable[Any], *, radio: int | None) -> str | None:
    """Return the regulatory domain of a radio, else the global one, None if neither is told.

    Parameters
    ----------
    radio : the kernel's number of the radio, None = not known
    """
    by_radio = {answer.get_attr("NL80211_ATTR_WIPHY"): answer.get_attr("NL80211_ATTR_REG_ALPHA2") for answer in answers}
    found = by_radio.get(radio) or by_radio.get(None)
    return str(found) if found else None


def _told(what: str, interface: str, read: Callable[[int], T | None]) -> T:
    if (index := index_of(interface)) is None:
        raise NotKnownError(f"there is no interface {interface}")
    try:
        found = read(index)
    except Exception as error:  # noqa: BLE001 - permission, driver or pyroute2; the other facts may still be known
        raise NotKnownError(f"nl80211 does not tell {what} ({type(error).__name__}: {error})") from None
    if found is None:
        raise NotKnownError(f"the radio tells no {what.removeprefix('a ')} now")
    return found
