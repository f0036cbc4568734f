"""The price of the link, to and from the numbers of a message: pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.model.price import Price

if TYPE_CHECKING:
    from collections.abc import Sequence

_VERSION = 1.0
_NUMBERS = 9


def encode_price(price: Price) -> list[float]:
    """Return the version of the message and the fields of a price, in a fixed order."""
    return [
        _VERSION,
        price.share_per_weight,
        price.capacity_bytes_per_second,
        price.packet_overhead_s,
        price.yielding_weight,
        price.kept_minimum,
        math.nan if price.loss_ratio is None else price.loss_ratio,
        price.budget_share,
        price.spare_share,
    ]


def decode_price(numbers: Sequence[float]) -> Price:
    """Return the price of a message.

    Raises
    ------
    ValueError
        If the numbers are no price; the message names the fault.
    """
    if len(numbers) != _NUMBERS:
        raise ValueError(f"price of {len(numbers)} numbers; {_NUMBERS} are needed")
    version, share_per_weight, capacity, packet_overhead_s, yielding_weight, kept_minimum, loss, budget, spare = numbers
    if version != _VERSION:
        raise ValueError(f"price of version {version:g}; this arpd understands {_VERSION:g}")
    if not (math.isnan(loss) or 0.0 <= loss <= 1.0):
        raise ValueError(f"price with a loss of {loss:g}; a part of the packets is needed, or nan where it is unknown")
    return Price(
        share_per_weight=share_per_weight,
        capacity_bytes_per_second=capacity,
        packet_overhead_s=packet_overhead_s,
        yielding_weight=yielding_weight,
        kept_minimum=kept_minimum,
        loss_ratio=None if math.isnan(loss) else loss,
        budget_share=budget,
        spare_share=spare,
    )
