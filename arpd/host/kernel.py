"""Reads what the kernel tells of datagrams, packet sizes and routes."""

from __future__ import annotations

import socket
from ipaddress import ip_address
from pathlib import Path

from arpd.host.interface import SYS_NET, interface_to, likeliest_interface, of_route, read_number
from arpd.model.errors import NotKnownError
from arpd.model.settings import AUTO

PROC = Path("/proc")
_IP_MTU = 14  # linux/in.h


def read_mtu(interface: str) -> int:
    """Return the MTU of an interface (bytes), or raise NotKnownError."""
    if (found := read_number(SYS_NET / interface / "mtu")) is None:
        raise NotKnownError(f"there is no interface {interface}")
    return found


def route_mtu(address: str) -> int | None:
    """Return the largest packet that the kernel would send to an address, None if it does not tell (bytes).

    It knows the MTU of the route, and what routers on the way have answered. Nothing is sent.
    """
    return of_route(address, lambda route: route.getsockopt(socket.IPPROTO_IP, _IP_MTU))


def interface_of_link(*ends: str | None) -> str | None:
    """Return the interface of the route to one of the link's ends, None where no end has an address and a route.

    A route to this computer's own end leads to its interface, too. A host name is no address here, because to look it
    up may take seconds.
    """
    addresses = (end for end in ends if end is not None and end.replace(".", "").isdecimal())
    return next(filter(None, map(interface_to, addresses)), None)


def link_interface(configured: str, *ends: str | None) -> str:
    """Return the configured interface of the link, or what ``auto`` means now; empty = none yet."""
    return configured if configured != AUTO else interface_of_link(*ends) or likeliest_interface() or ""


def is_own_address(address: str) -> bool:
    """Return whether an address, or a host name, is this computer's. Debian gives its own name 127.0.1.1."""
    ends = ends_of_route(address)
    return ends is not None and leads_here(ends)


def ends_of_route(address: str) -> tuple[str, str] | None:
    """Return this computer's address and the other one of the route to an address or a host name, None without one."""
    return of_route(address, lambda route: (route.getsockname()[0], route.getpeername()[0]))


def leads_here(ends: tuple[str, str]) -> bool:
    """Return whether the other end of a route is this computer, too."""
    return ends[0] == ends[1] or ip_address(ends[1]).is_loopback


def counters(protocol: str, *, proc: Path = PROC) -> dict[str, int]:
    """Return the counters of a protocol in this network namespace, empty where the kernel does not tell them.

    /proc/net/snmp has a line of names, then one of numbers.
    """
    try:
        lines = (proc / "net/snmp").read_text().splitlines()
        names, numbers = [line.split()[1:] for line in lines if line.startswith(f"{protocol}:")]
        return dict(zip(names, map(int, numbers), strict=True))
    except (OSError, ValueError):
        return {}
