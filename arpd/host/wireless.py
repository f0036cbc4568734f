"""Reads power save, signal and regulatory domain of a Wi-Fi interface, through nl80211."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from arpd.host.interface import index_of
from arpd.host.kernel import read_number
from arpd.host.radio import ask_stations
from arpd.host.services import service_states
from arpd.report.health import RadioState, Unknown

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

T = TypeVar("T")
_SYS_NET = Path("/sys/class/net")
_NETWORK_MANAGER = "NetworkManager"


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


def read_radio(
    interface: str,
    *,
    power_save: Callable[[int], Iterable[Any]] = ask_power_save,
    stations: Callable[[int], Iterable[Any]] = ask_stations,
    regions: Callable[[int], Iterable[Any]] = ask_regions,
    sys_net: Path = _SYS_NET,
    has_network_manager: Callable[[], bool] = runs_network_manager,
) -> RadioState | None:
    """Return the state of an interface's radio, None if it has none.

    Parameters
    ----------
    power_save, stations, regions : ask nl80211 about the interface with a number of the kernel
    has_network_manager : returns whether NetworkManager runs
    """
    radio = sys_net / interface / "phy80211"
    index = index_of(interface)
    if index is None or not radio.exists():
        return None
    return RadioState(
        saves_power=_read(lambda: saves_power(power_save(index)), "power save"),
        signal_dbm=_read(lambda: signal_dbm(stations(index)), "a signal"),
        region=_read(lambda: region_of(regions(index), radio=read_number(radio / "index")), "a regulatory domain"),
        has_network_manager=has_network_manager(),
    )


def radios_beneath(interface: str, *, sys_net: Path = _SYS_NET) -> list[str]:
    """Return the interfaces with a radio that may carry a tunnel: those that are up; none beneath hardware."""
    if (sys_net / interface / "device").exists():
        return []
    return sorted(radio.parent.name for radio in sys_net.glob("*/phy80211") if _is_up(radio.parent / "operstate"))


def _is_up(path: Path) -> bool:
    try:
        return path.read_text().strip() == "up"
    except OSError:
        return False


def saves_power(answers: Iterable[Any]) -> bool | None:
    """Return whether power save is on, None if no answer tells."""
    for answer in answers:
        told = answer.get_attr("NL80211_ATTR_PS_STATE")  # pyroute2 shows its bytes: 01:00:00:00
        if told:
            return int.from_bytes(bytes.fromhex(str(told).replace(":", "")), sys.byteorder) != 0
    return None


def signal_dbm(stations: Iterable[Any]) -> int | None:
    """Return the strongest signal of an access point or of several clients, None if none has one (dBm)."""
    infos = [info for station in stations if (info := station.get_attr("NL80211_ATTR_STA_INFO"))]
    found = [info.get_attr("NL80211_STA_INFO_SIGNAL_AVG") or info.get_attr("NL80211_STA_INFO_SIGNAL") for info in infos]
    return max((signal for signal in found if signal), default=None)


def region_of(answers: Iterable[Any], *, radio: int | None) -> str | None:
    """Return the regulatory domain of a radio, else the global one, None if neither is told.

    Parameters
    ----------
    radio : the kernel's number of the radio, None = not known
    """
    by_radio = {answer.get_attr("NL80211_ATTR_WIPHY"): answer.get_attr("NL80211_ATTR_REG_ALPHA2") for answer in answers}
    found = by_radio.get(radio) or by_radio.get(None)
    return str(found) if found else None


def _read(read: Callable[[], T | None], what: str) -> T | Unknown:
    try:
        found = read()
    except Exception as error:  # noqa: BLE001 - permission, driver or pyroute2; the other facts may still be known
        return Unknown(f"nl80211 does not tell {what} ({type(error).__name__}: {error})")
    return Unknown(f"the radio tells no {what.removeprefix('a ')} now") if found is None else found
