"""How the paper's figures are written: in as many digits as say something."""

from __future__ import annotations

import math


def milliseconds(value_s: float | None) -> str:
    """Write a time (s) in milliseconds."""
    return "–" if value_s is None else short(value_s * 1e3)


def percent(ratio: float | None) -> str:
    """Write a share in per cent."""
    return "–" if ratio is None else short(ratio * 100.0)


def short(value: float) -> str:
    """Write two significant digits, or all before the point; what is not zero never shows as zero."""
    if value == 0.0:
        return "0"
    digits = max(0, 1 - math.floor(math.log10(abs(value))))
    text = f"{value:.{digits}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
