"""The price of the link, to and from the numbers of a message: pure."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import TYPE_CHECKING

from arpd.model.price import Price

if TYPE_CHECKING:
    from collections.abc import Sequence

_VERSION = 1.0
_FIELDS = tuple(each.name for each in fields(Price) if each.name != "is_stale")  # in this order


def encode_price(price: Price) -> list[float]:
    """Return the version of the message and the fields of a price; nan stands for a loss that is not known."""
    return [_VERSION, *(math.nan if (value := getattr(price, name)) is None else value for name in _FIELDS)]


def decode_price(numbers: Sequence[float]) -> Price:
    """Return the price of a message; raises ValueError, which names the fault."""
    if len(numbers) != 1 + len(_FIELDS) or numbers[0] != _VERSION:
        raise ValueError(f"price of {len(numbers)} numbers; {1 + len(_FIELDS)} are needed, the first {_VERSION:g}")
    found = dict(zip(_FIELDS, numbers[1:], strict=True))
    loss = found.pop("loss_ratio")
    if not (math.isnan(loss) or 0.0 <= loss <= 1.0):
        raise ValueError(f"price with a loss of {loss:g}; a part of the packets is needed, or nan where it is unknown")
    return Price(**found, loss_ratio=None if math.isnan(loss) else loss)  # type: ignore[arg-type]
