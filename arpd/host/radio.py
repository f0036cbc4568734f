"""Reads a Wi-Fi interface's bit rate, which bounds the capacity, power save, signal and region, through nl80211.

Each function raises NotKnownError, with the reason, where nobody tells.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TypeVar

from arpd.host.interface import SYS_NET, index_of, is_radio, read_number, running_radios
from arpd.host.services import service_states
from arpd.model.errors import NotKnownError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

T = TypeVar("T")
_NETWORK_MANAGER = "NetworkManager"
_BYTES_PER_S = 100_000 / 8  # nl80211 counts in 100 kbit/s (linux/nl80211.h, NL80211_RATE_INFO_BITRATE32)
_OF_ALL = {"GET_REG"}  # questions that name no interface
_OF_ONE = {"GET_POWER_SAVE"}  # questions with one answer


def radios_of(interface: str) -> list[str]:
    """Return the radios that carry the link: the interface itself, or those that may be beneath a tunnel."""
    if is_radio(interface):
        return [interface]
    return [] if (SYS_NET / interface / "device").exists() else running_radios()


def transmit_rate(interface: str) -> float:
    """Return the bit rate of the physical layer (bytes/s).

    It is the rate of the fastest station, because any of them may be the peer and the bound must hold.
    """
    return _fact("GET_STATION", "bit rate", interface, _fastest)


def power_save(interface: str) -> bool:
    """Return whether a radio sleeps between beacons."""
    return _fact("GET_POWER_SAVE", "power save", interface, _saves_power)


def signal(interface: str) -> int:
    """Return the strength of a radio's access point, or of the strongest station (dBm)."""
    return _fact("GET_STATION", "signal", interface, _strongest)


def region(interface: str) -> str:
    """Return two letters of the regulatory domain in force, ``00`` = none is set."""
    radio = read_number(SYS_NET / interface / "phy80211/index")
    return _fact("GET_REG", "regulatory domain", interface, lambda answers: _region_of(answers, radio=radio))


def runs_network_manager() -> bool:
    """Return whether NetworkManager runs. Its folders also exist where netplan wrote for it and networkd runs."""
    unit = service_states(_NETWORK_MANAGER).get(_NETWORK_MANAGER)
    return unit is not None and unit.active == "active"


def _fact(command: str, what: str, interface: str, read: Callable[[Sequence[Any]], T | None]) -> T:
    if (index := index_of(interface)) is None:
        raise NotKnownError(f"there is no interface {interface}")
    try:
        found = read(_ask(command, index))
    except Exception as error:  # noqa: BLE001 - permission, driver or pyroute2; the other facts may still be known
        raise NotKnownError(f"nl80211 does not tell the {what} ({type(error).__name__}: {error})") from None
    if found is None:
        raise NotKnownError(f"the radio tells no {what} now")
    return found


def _ask(command: str, index: int) -> list[Any]:
    from pyroute2.iwutil import IW  # noqa: PLC0415 - takes a quarter of a second, and only a radio needs it
    from pyroute2.netlink import NLM_F_DUMP, NLM_F_REQUEST  # noqa: PLC0415
    from pyroute2.netlink.nl80211 import NL80211_NAMES, nl80211cmd  # noqa: PLC0415

    message = nl80211cmd()
    message["cmd"] = NL80211_NAMES[f"NL80211_CMD_{command}"]
    message["attrs"] = [] if command in _OF_ALL else [["NL80211_ATTR_IFINDEX", index]]
    flags = NLM_F_REQUEST | (0 if command in _OF_ONE else NLM_F_DUMP)
    with IW() as nl80211:
        return list(nl80211.nlm_request(message, msg_type=nl80211.prid, msg_flags=flags))


def _infos(stations: Sequence[Any]) -> list[Any]:
    return [info for station in stations if (info := station.get_attr("NL80211_ATTR_STA_INFO"))]


def _fastest(stations: Sequence[Any]) -> float | None:
    rates = [info.get_attr("NL80211_STA_INFO_TX_BITRATE") for info in _infos(stations)]
    # The older attribute has 16 bits, and the kernel leaves it out above 6.5 Gbit/s. Some drivers first tell 0.
    names = "NL80211_RATE_INFO_BITRATE32", "NL80211_RATE_INFO_BITRATE"
    found = [rate.get_attr(names[0]) or rate.get_attr(names[1]) for rate in rates if rate]
    return max((rate * _BYTES_PER_S for rate in found if rate), default=None)


def _strongest(stations: Sequence[Any]) -> int | None:
    names = "NL80211_STA_INFO_SIGNAL_AVG", "NL80211_STA_INFO_SIGNAL"
    found = [info.get_attr(names[0]) or info.get_attr(names[1]) for info in _infos(stations)]
    return max((signal for signal in found if signal), default=None)


def _saves_power(answers: Sequence[Any]) -> bool | None:
    state = next((found for answer in answers if (found := answer.get_attr("NL80211_ATTR_PS_STATE"))), None)
    # pyroute2 shows its bytes: 01:00:00:00.
    return None if state is None else int.from_bytes(bytes.fromhex(str(state).replace(":", "")), sys.byteorder) != 0


def _region_of(answers: Sequence[Any], *, radio: int | None) -> str | None:
    """Return the regulatory domain of the radio with a number of the kernel, else the global one."""
    by_radio = {answer.get_attr("NL80211_ATTR_WIPHY"): answer.get_attr("NL80211_ATTR_REG_ALPHA2") for answer in answers}
    found = by_radio.get(radio) or by_radio.get(None)
    return str(found) if found else None
