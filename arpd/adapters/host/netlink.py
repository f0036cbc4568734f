"""Questions to the kernel over rtnetlink, without pyroute2, which takes milliseconds for what every tick asks."""

from __future__ import annotations

import socket
import struct
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

T = TypeVar("T")

# linux/netlink.h, linux/rtnetlink.h
DUMP = 0x300
_HEADER = struct.Struct("=IHHII")  # length, type, flags, sequence, port
_ATTRIBUTE = struct.Struct("=HH")  # length, type
_DONE, _ERROR, _REQUEST = 3, 2, 0x1
_TYPE_BITS = 0x3FFF  # the two above say how an attribute is packed
_TIMEOUT_S = 0.1
_MOST_READS = 100


def ask(kind: int, body: bytes, find: Callable[[bytes], tuple[T | None, bool]], *, flags: int = 0) -> T | None:
    """Return what is found in the kernel's answer, None where there is none or the kernel does not tell.

    Parameters
    ----------
    kind, body : of the request
    find : looks for it in a part of the answer; returns it, and whether no other part is needed
    flags : beside those of any request
    """
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as kernel:
            kernel.settimeout(_TIMEOUT_S)
            kernel.send(_HEADER.pack(_HEADER.size + len(body), kind, _REQUEST | flags, 1, 0) + body)
            for _ in range(_MOST_READS):
                found, is_complete = find(kernel.recv(65536))
                if found is not None or is_complete:
                    return found
    except (OSError, struct.error):
        pass
    return None


def messages(answer: bytes) -> Iterator[tuple[int, bytes] | None]:
    """Yield type and body of every message in a part of an answer; None in place of one that ends the answer."""
    offset = 0
    while offset + _HEADER.size <= len(answer):
        length, kind, *_ = _HEADER.unpack_from(answer, offset)
        if kind in {_DONE, _ERROR} or length < _HEADER.size:
            yield None
            return
        yield kind, answer[offset + _HEADER.size : offset + length]
        offset += (length + 3) & ~3


def attributes(data: bytes) -> dict[int, bytes]:
    """Return attributes by type."""
    found, offset = {}, 0
    while offset + _ATTRIBUTE.size <= len(data):
        length, kind = _ATTRIBUTE.unpack_from(data, offset)
        if length < _ATTRIBUTE.size:
            break
        found[kind & _TYPE_BITS] = data[offset + _ATTRIBUTE.size : offset + length]
        offset += (length + 3) & ~3
    return found
