"""Asks the kernel over rtnetlink for the counters of an interface and its queue: 40 µs, of which a tick has some."""

from __future__ import annotations

import os
import socket
import struct
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from arpd.model.interface import InterfaceState, LinkCounters

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

# linux/netlink.h, linux/rtnetlink.h
_HEADER = struct.Struct("=IHHII")  # length, type, flags, sequence, port
_ATTRIBUTE = struct.Struct("=HH")  # length, type
_REQUEST, _DUMP = 0x1, 0x300
_TYPE_BITS = 0x3FFF  # the two bits above tell the packing of an attribute
_TIMEOUT_S = 0.1
# linux/rtnetlink.h, linux/if_link.h, linux/if.h
_LINK = struct.Struct("=BxHiII")  # family, kind of device, interface, flags, changed flags
_STATS = struct.Struct("=8Q")  # packets, bytes, errors and drops, each received and sent
_GETLINK, _NEWLINK = 18, 16
_NAME, _QUEUE_KIND, _STATS64 = 3, 6, 23
_UP, _RUNNING = 0x1, 0x40
# linux/rtnetlink.h, linux/pkt_sched.h, linux/gen_stats.h
_QDISC = struct.Struct("=BxxxiIII")  # family, interface, handle, parent, info
_QUEUE = struct.Struct("=III")  # packets, bytes, dropped
_GETQDISC, _NEWQDISC = 38, 36
_ROOT = 0xFFFFFFFF
_STATS2, _STATS_QUEUE = 7, 3
_WITHOUT_QUEUE = b"noqueue\0"  # also of a Wi-Fi driver, which queues inside mac80211


def read_counters(name: str) -> LinkCounters | None:
    """Return the kernel's counters of an interface; None if there is none, or the kernel does not answer.

    They include the drops of the root queue, which drivers do not count.
    """
    written = os.fsencode(name) + b"\0"
    asked = _LINK.pack(0, 0, 0, 0, 0) + _ATTRIBUTE.pack(_ATTRIBUTE.size + len(written), _NAME) + written
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as kernel:
            kernel.settimeout(_TIMEOUT_S)
            links = bodies(_ask(kernel, _GETLINK, 0, asked), _NEWLINK)
            if (link := next(map(link_in, links), None)) is None:
                return None
            index, has_queue, counters = link
            if not has_queue:
                return counters
            told = bodies(_ask(kernel, _GETQDISC, _DUMP, _QDISC.pack(0, index, 0, 0, 0)), _NEWQDISC)
            waiting_bytes, dropped = next(filter(None, (root_queue_in(body, index) for body in told)), (None, 0))
    except (OSError, struct.error, KeyError):  # malformed, or without what Linux tells
        return None
    return replace(counters, tx_dropped=counters.tx_dropped + dropped, backlog_bytes=waiting_bytes)


def _ask(kernel: socket.socket, kind: int, flags: int, body: bytes) -> Iterator[bytes]:
    """Yield the parts of the kernel's answer until none comes."""
    with suppress(OSError):
        kernel.send(_HEADER.pack(_HEADER.size + len(body), kind, _REQUEST | flags, 1, 0) + body)
        while True:
            yield kernel.recv(65536)


def bodies(answer: Iterable[bytes], kind: int) -> Iterator[bytes]:
    """Yield the bodies of an answer's messages; one of another kind, as an error, ends it."""
    for part in answer:
        offset = 0
        while offset + _HEADER.size <= len(part):
            length, found, *_ = _HEADER.unpack_from(part, offset)
            if found != kind or length < _HEADER.size:
                return
            yield part[offset + _HEADER.size : offset + length]
            offset += (length + 3) & ~3


def link_in(body: bytes) -> tuple[int, bool, LinkCounters]:
    """Return the number of the interface of a message, whether it has a queue, and its counters."""
    _, _, index, flags, _ = _LINK.unpack_from(body)
    told = _attributes(body[_LINK.size :])
    rx_packets, tx_packets, rx_bytes, tx_bytes, _, _, _, tx_dropped = _STATS.unpack_from(told[_STATS64])
    without_carrier = InterfaceState.NO_CARRIER if flags & _UP else InterfaceState.DOWN
    counters = LinkCounters(
        interface=told[_NAME].rstrip(b"\0").decode(errors="replace"),
        rx_bytes=rx_bytes,
        tx_bytes=tx_bytes,
        rx_packets=rx_packets,
        tx_packets=tx_packets,
        tx_dropped=tx_dropped,
        state=InterfaceState.UP if flags & _RUNNING else without_carrier,
    )
    return index, told.get(_QUEUE_KIND) != _WITHOUT_QUEUE, counters


def root_queue_in(body: bytes, index: int) -> tuple[int, int] | None:
    """Return bytes in the interface's root queue and packets that it has dropped, if a message is of that queue."""
    _, interface, _, parent, _ = _QDISC.unpack_from(body)
    stats = _attributes(_attributes(body[_QDISC.size :]).get(_STATS2, b"")).get(_STATS_QUEUE)
    if (interface, parent) != (index, _ROOT) or stats is None:
        return None
    _, waiting_bytes, dropped_packets = _QUEUE.unpack_from(stats)
    return waiting_bytes, dropped_packets


def _attributes(data: bytes) -> dict[int, bytes]:
    found, offset = {}, 0
    while offset + _ATTRIBUTE.size <= len(data):
        length, kind = _ATTRIBUTE.unpack_from(data, offset)
        if length < _ATTRIBUTE.size:
            break
        found[kind & _TYPE_BITS] = data[offset + _ATTRIBUTE.size : offset + length]
        offset += (length + 3) & ~3
    return found
