"""Asks the kernel over rtnetlink for the counters of an interface and its queue: 40 µs, of which a tick has some."""

from __future__ import annotations

import os
import socket
import struct
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from arpd.model.interface import InterfaceState, LinkCounters

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

T = TypeVar("T")
# linux/netlink.h, linux/rtnetlink.h
_HEADER = struct.Struct("=IHHII")  # length, type, flags, sequence, port
_ATTRIBUTE = struct.Struct("=HH")  # length, type
_DONE, _ERROR, _REQUEST, _DUMP = 3, 2, 0x1, 0x300
_TYPE_BITS = 0x3FFF  # the two bits above tell the packing of an attribute
_TIMEOUT_S = 0.1
_MOST_READS = 100
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


@dataclass(frozen=True, kw_only=True, slots=True)
class Backlog:
    """State of a queue.

    Parameters
    ----------
    waiting_bytes : bytes in the queue
    dropped_packets : packets dropped since the queue was made; wraps at 32 bits
    """

    waiting_bytes: int
    dropped_packets: int


def read_counters(name: str) -> LinkCounters | None:
    """Return the kernel's counters of an interface; None if there is none, or the kernel does not answer.

    They include the drops of the root queue, which drivers do not count.
    """
    written = os.fsencode(name) + b"\0"
    asked = _LINK.pack(0, 0, 0, 0, 0) + _ATTRIBUTE.pack(_ATTRIBUTE.size + len(written), _NAME) + written
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as kernel:
            kernel.settimeout(_TIMEOUT_S)
            if (link := _ask(kernel, _GETLINK, 0, asked, find_link)) is None:
                return None
            index, has_queue, counters = link
            if not has_queue:
                return counters
            queue = _ask(kernel, _GETQDISC, _DUMP, _QDISC.pack(0, index, 0, 0, 0), partial(find_root, index=index))
    except OSError:
        return None
    if queue is None:
        return counters
    dropped = counters.tx_dropped + queue.dropped_packets
    return replace(counters, tx_dropped=dropped, backlog_bytes=queue.waiting_bytes)


def _ask(
    kernel: socket.socket, kind: int, flags: int, body: bytes, find: Callable[[bytes], tuple[T | None, bool]]
) -> T | None:
    """Return what is found in the parts of the kernel's answer, None if it is not there, or no answer comes."""
    try:
        kernel.send(_HEADER.pack(_HEADER.size + len(body), kind, _REQUEST | flags, 1, 0) + body)
        for _ in range(_MOST_READS):
            found, is_complete = find(kernel.recv(65536))
            if found is not None or is_complete:
                return found
    except (OSError, struct.error, KeyError):  # malformed, or without what Linux tells
        pass
    return None


def find_link(answer: bytes) -> tuple[tuple[int, bool, LinkCounters] | None, bool]:
    """Return the number of the interface of an answer, whether it has a queue, and its counters; and always True."""
    for message in _messages(answer):
        if message is not None and message[0] == _NEWLINK:
            _, _, index, flags, _ = _LINK.unpack_from(message[1])
            told = _attributes(message[1][_LINK.size :])
            rx_packets, tx_packets, rx_bytes, tx_bytes, _, _, _, tx_dropped = _STATS.unpack_from(told[_STATS64])
            without_carrier = InterfaceState.NO_CARRIER if flags & _UP else InterfaceState.DOWN
            counters = LinkCounters(
                interface=told[_NAME].rstrip(b"\0").decode(),
                rx_bytes=rx_bytes,
                tx_bytes=tx_bytes,
                rx_packets=rx_packets,
                tx_packets=tx_packets,
                tx_dropped=tx_dropped,
                state=InterfaceState.UP if flags & _RUNNING else without_carrier,
            )
            return (index, told.get(_QUEUE_KIND) != _WITHOUT_QUEUE, counters), True
    return None, True


def find_root(answer: bytes, index: int) -> tuple[Backlog | None, bool]:
    """Return the root queue if a part of the kernel's answer has it, and whether no other part is needed."""
    for message in _messages(answer):
        if message is None:
            return None, True
        kind, body = message
        if kind == _NEWQDISC:
            _, interface, _, parent, _ = _QDISC.unpack_from(body)
            if (interface, parent) == (index, _ROOT):
                return _backlog_of(_attributes(body[_QDISC.size :])), True
    return None, False


def _backlog_of(told: dict[int, bytes]) -> Backlog | None:
    if (stats := _attributes(told.get(_STATS2, b"")).get(_STATS_QUEUE)) is None:
        return None
    _, waiting_bytes, dropped_packets = _QUEUE.unpack_from(stats)
    return Backlog(waiting_bytes=waiting_bytes, dropped_packets=dropped_packets)


def _messages(answer: bytes) -> Iterator[tuple[int, bytes] | None]:
    """Yield type and body of every message in a part of an answer, None for the message that ends the answer."""
    offset = 0
    while offset + _HEADER.size <= len(answer):
        length, kind, *_ = _HEADER.unpack_from(answer, offset)
        if kind in {_DONE, _ERROR} or length < _HEADER.size:
            yield None
            return
        yield kind, answer[offset + _HEADER.size : offset + length]
        offset += (length + 3) & ~3


def _attributes(data: bytes) -> dict[int, bytes]:
    """Return the values of attributes by type."""
    found, offset = {}, 0
    while offset + _ATTRIBUTE.size <= len(data):
        length, kind = _ATTRIBUTE.unpack_from(data, offset)
        if length < _ATTRIBUTE.size:
            break
        found[kind & _TYPE_BITS] = data[offset + _ATTRIBUTE.size : offset + length]
        offset += (length + 3) & ~3
    return found
