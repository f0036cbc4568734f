"""Link counters and memory of this host, through psutil."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil

from arpd.errors import LinkError
from arpd.interface import InterfaceState, LinkCounters
from arpd.model import MemoryState

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_SYS_NET = Path("/sys/class/net")
_PROC_ROUTE = Path("/proc/net/route")


def choose_interface(
    wanted: str,
    *,
    sys_net: Path = _SYS_NET,
    route: Path = _PROC_ROUTE,
    names: Callable[[], Mapping[str, Any]] | None = None,
) -> str:
    """Return the link interface: the one asked for, or for ``auto`` the likeliest one.

    ``auto`` takes a wireless interface that is up, else the interface of the default route, else the only one
    besides loopback.

    Raises
    ------
    LinkError
        If the interface asked for does not exist, or ``auto`` finds none; the message names those that exist.
    """
    stats = names() if names else psutil.net_if_stats()
    existing = sorted(stats)
    others = [name for name in existing if name != "lo"]
    if wanted != "auto":
        if wanted not in existing:
            raise LinkError(f"link.interface {wanted!r} does not exist; this host has {', '.join(existing) or 'none'}")
        return wanted
    for name in others:
        if (sys_net / name / "wireless").exists() and stats[name].isup:
            return name
    routed = _default_route(route)
    if routed in others:
        return routed
    if len(others) == 1:
        return others[0]
    raise LinkError(f"cannot tell which interface is the link; set link.interface to one of {', '.join(existing)}")


def read_counters(interface: str) -> LinkCounters | None:
    """Return the interface's counters, None while it is gone."""
    counters = psutil.net_io_counters(pernic=True, nowrap=True).get(interface)
    stats = psutil.net_if_stats().get(interface)
    if counters is None or stats is None:
        return None
    return LinkCounters(
        interface=interface,
        rx_bytes=counters.bytes_recv,
        tx_bytes=counters.bytes_sent,
        rx_packets=counters.packets_recv,
        tx_packets=counters.packets_sent,
        tx_dropped=counters.dropout,
        state=InterfaceState.UP if stats.isup else InterfaceState.DOWN,
    )


def read_memory() -> MemoryState:
    """Return the host's memory."""
    memory = psutil.virtual_memory()
    return MemoryState(total_bytes=memory.total, available_bytes=memory.available)


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
