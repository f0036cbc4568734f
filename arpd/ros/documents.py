"""JSON documents as messages, compressed where that is shorter. Pure."""

from __future__ import annotations

import json
import zlib
from typing import Any

MOST_INTEGER = 2**63 - 1
_RAW = -15  # deflate without zlib's header and checksum


def pack(document: Any, *, likely: bytes = b"") -> bytes:
    """Return a document as the bytes of a message, in which ``likely`` texts cost little (zlib's dictionary)."""
    text = json.dumps(document, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode(errors="replace")
    packer = zlib.compressobj(wbits=_RAW, zdict=likely)
    return min(text, packer.compress(text) + packer.flush(), key=len)


def expand(data: bytes, *, most_bytes: int, likely: bytes = b"") -> bytes:
    """Return the text of a message; raises ValueError if it is longer than ``most_bytes``, or no such message."""
    if data[:1] != b"{":
        try:
            data = zlib.decompressobj(_RAW, zdict=likely).decompress(data, most_bytes + 1)
        except zlib.error as fault:
            raise ValueError(f"no document: {fault}") from fault
    if len(data) > most_bytes:
        raise ValueError(f"a document of more than {most_bytes} bytes")
    return data


def unpack(data: bytes, *, most_bytes: int) -> dict[str, Any]:
    """Return the object that a message holds; arguments and errors are those of `expand`."""
    try:
        document = json.loads(expand(data, most_bytes=most_bytes), parse_constant=_refuse_constant)
    except RecursionError as fault:
        raise ValueError(f"no document: {fault}") from fault
    if not isinstance(document, dict):
        raise ValueError("no object of JSON")  # noqa: TRY004 - a message may hold anything, so it is no type error
    return document


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is no number of JSON")
