"""Sign of life of one end, with its receipt for the other's chunks: pure."""

from __future__ import annotations

import struct
from typing import NamedTuple

from arpd.relay.flight import Receipt

_SIGN = struct.Struct("<BIIIIIIII")
_VERSION = 2


class Sign(NamedTuple):
    """Sign of life.

    Parameters
    ----------
    session : of the sender
    number : of a probe, which the other end answers with a receipt; counted as chunks are, 0 = this is none
    departed_us : when a probe left, by the sender's clock, modulo `WRAP` (µs)
    receipt : for the other end's chunks
    """

    session: int
    number: int = 0
    departed_us: int = 0
    receipt: Receipt = Receipt()


SIGN_BYTES = _SIGN.size


def encode_sign(sign: Sign) -> bytes:
    """Return a sign as bytes."""
    return _SIGN.pack(_VERSION, *sign[:3], *sign.receipt)


def decode_sign(data: bytes) -> Sign:
    """Return the sign from its bytes.

    Raises
    ------
    ValueError
        If they are none of this version.
    """
    if len(data) != SIGN_BYTES or data[0] != _VERSION:
        raise ValueError("no sign of life of this version; install one arpd on both ends")
    _, session, number, departed_us, *receipt = _SIGN.unpack(data)
    return Sign(session, number, departed_us, Receipt(*receipt))
