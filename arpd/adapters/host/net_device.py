"""What the kernel keeps of one network interface: its name, flags and counters, asked over rtnetlink."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from arpd.adapters.host.netlink import ask, attributes, messages

# linux/rtnetlink.h, linux/if_link.h
_LINK = struct.Struct("=BxHiII")  # family, hardware, index, flags, change
_COUNTERS = struct.Struct("=8Q")  # received and sent packets, the same in bytes, errors, drops
_GETLINK, _NEWLINK = 18, 16
_NAME, _STATS64 = 3, 23
_UP, _RUNNING = 0x1, 0x40


@dataclass(frozen=True, kw_only=True, slots=True)
class NetDevice:
    """One interface.

    Parameters
    ----------
    name : the name it has
    is_up, is_running : what the administrator wants; what the driver has (netdevice(7))
    rx_bytes, tx_bytes, rx_packets, tx_packets, tx_dropped : counters, as the driver has them
    """

    name: str
    is_up: bool
    is_running: bool
    rx_bytes: int
    tx_bytes: int
    rx_packets: int
    tx_packets: int
    tx_dropped: int


def read_device(index: int) -> NetDevice | None:
    """Return an interface, None where there is none or the kernel does not tell.

    psutil asks for all interfaces, one file and eight calls for each: 160 µs with four of them, and this 30.

    Parameters
    ----------
    index : the kernel's number of the interface
    """
    return ask(_GETLINK, _LINK.pack(0, 0, index, 0, 0), lambda answer: find_device(answer, index))


def find_device(answer: bytes, index: int) -> tuple[NetDevice | None, bool]:
    """Find an interface in a part of the kernel's answer.

    Returns
    -------
    The interface if it is in this part, and whether this part ends the answer.
    """
    for message in messages(answer):
        if message is None:
            return None, True
        kind, body = message
        if kind != _NEWLINK:
            continue
        _, _, found, flags, _ = _LINK.unpack_from(body)
        told = attributes(body[_LINK.size :])
        if found == index and _NAME in told and _STATS64 in told:
            return _device_of(told, flags), True
    return None, False


def _device_of(told: dict[int, bytes], flags: int) -> NetDevice:
    rx_packets, tx_packets, rx_bytes, tx_bytes, _, _, _, tx_dropped = _COUNTERS.unpack_from(told[_STATS64])
    return NetDevice(
        name=told[_NAME].rstrip(b"\0").decode(errors="replace"),
        is_up=bool(flags & _UP),
        is_running=bool(flags & _RUNNING),
        rx_bytes=rx_bytes,
        tx_bytes=tx_bytes,
        rx_packets=rx_packets,
        tx_packets=tx_packets,
        tx_dropped=tx_dropped,
    )
