"""Quantities as people write and read them (`20mbit`, `64MiB`, `12.5 ms`), from and to the base units of the code.

RATE, SIZE and DURATION read them, and spell what reads back exactly. ``format_*`` writes for a reader: None as `-`,
infinity as `unlimited`, NaN as `unknown`.
"""

from __future__ import annotations

import math
import re
from fractions import Fraction
from typing import TYPE_CHECKING, TypeGuard

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

# Exponents of three digits and 40 characters in all: a quantity never costs more memory than its text.
_QUANTITY = re.compile(r"\s*([0-9]+(?:\.[0-9]*)?(?:[eE][-+]?[0-9]{1,3})?|\.[0-9]+)\s*([A-Za-zµμ/]*)\s*", re.ASCII)
_LONGEST = 40
_MOST_DECIMALS = 9
_HUGE = 1e15  # floats hold every whole number below it


class Units:
    """Units of one kind of quantity.

    Parameters
    ----------
    what, example : name of the quantity, and how one writes it
    spelled : units that are written, in base units
    more : units that are only read
    unit_of : returns the unit that a word stands for
    """

    def __init__(
        self,
        what: str,
        example: str,
        spelled: Mapping[str, Fraction],
        more: Mapping[str, Fraction],
        unit_of: Callable[[str], str] = str,
    ) -> None:
        self._what, self._example, self._unit_of = what, example, unit_of
        self._spelled, self._read = spelled, {**spelled, **more}

    def parse(self, text: str) -> float:
        """Read a quantity in base units, or raise ValueError with ``what is wrong; what would be right``."""
        match = _QUANTITY.fullmatch(text) if len(text) <= _LONGEST else None
        if match is None:
            raise ValueError(f"'{printable(text)}' is not a {self._what}; write it like {self._example}")
        number, unit = match[1], match[2]
        if not unit:
            raise ValueError(f"'{printable(text)}' has no unit; write a {self._what} like {self._example}")
        if (scale := self._read.get(self._unit_of(unit))) is None:
            raise ValueError(f"'{unit[:_LONGEST]}' is not a unit of a {self._what}; write it like {self._example}")
        return _scaled(number, scale)

    def spell(self, value: float) -> str:
        """Return the shortest text that `parse` reads back exactly."""
        spellings = [
            f"{number}{unit}"
            for unit, scale in self._spelled.items()
            for number in (f"{value / float(scale):g}", f"{value / float(scale)!r}")
            if _scaled(number, scale) == value
        ]
        return min(spellings, key=len)


def _rate_unit(unit: str) -> str:
    """Take bit units in any case, and refuse those of tc(8) for bytes: everybody reads `kbps` as bits."""
    bits = unit.casefold().removesuffix("/s")
    if bits in {"kbps", "mbps", "gbps", "bps"}:
        raise ValueError(f"'{unit}' means bits to some and bytes to tc(8); write kbit, mbit, gbit, kB/s or MB/s")
    return bits if bits in _BITS else unit


_BITS = {unit: Fraction(10**power, 8) for unit, power in {"bit": 0, "kbit": 3, "mbit": 6, "gbit": 9}.items()}
_SIZES = {unit: Fraction(10**power) for unit, power in {"B": 0, "kB": 3, "MB": 6, "GB": 9}.items()} | {
    unit: Fraction(2**power) for unit, power in {"KiB": 10, "MiB": 20, "GiB": 30}.items()
}
_MORE_SIZES = {"KB": Fraction(10**3)}  # any other unit keeps its case: Mb may mean megabits
_PER_S = {f"{unit}/s": scale for unit, scale in (_SIZES | _MORE_SIZES).items()}
_MICROSECOND = Fraction(1, 10**6)
_TIMES = {
    "ns": Fraction(1, 10**9),
    "us": _MICROSECOND,
    "ms": Fraction(1, 10**3),
    "s": Fraction(1),
    "min": Fraction(60),
    "h": Fraction(3600),
}
RATE = Units("rate", "20mbit or 125kB/s", _BITS, _PER_S, _rate_unit)  # (bytes/s)
SIZE = Units("size", "64MiB or 500kB", _SIZES, _MORE_SIZES)  # (bytes)
DURATION = Units("duration", "500ms or 2s", _TIMES, {"µs": _MICROSECOND, "μs": _MICROSECOND})  # (s)


def format_rate(bytes_per_second: float | None) -> str:
    """Write a rate (bytes/s) for a reader: `4.8 Mbit/s`."""
    return _format(bytes_per_second, {"Gbit/s": 1e9 / 8, "Mbit/s": 1e6 / 8, "kbit/s": 1e3 / 8, "bit/s": 1 / 8})


def format_size(size_bytes: float | None) -> str:
    """Write a size (bytes) for a reader: `64 MiB`."""
    return _format(size_bytes, {"GiB": 2.0**30, "MiB": 2.0**20, "KiB": 2.0**10, "B": 1.0})


def format_payload(size_bytes: float | None) -> str:
    """Write the size of a message (bytes) for a reader in decimal units, which fit Mbit/s: `61.2 kB`."""
    return _format(size_bytes, {"GB": 1e9, "MB": 1e6, "kB": 1e3, "B": 1.0})


def format_duration(seconds: float | None) -> str:
    """Write a duration (s) for a reader: `12.5 ms`."""
    if seconds == 0:
        return "0 s"
    return _format(seconds, {"h": 3600.0, "min": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9})


def format_period(period_ns: float | None) -> str:
    """Write a DEADLINE (ns) for a reader: `100 ms`; 0 and None, which stand for no deadline, are `none`."""
    return format_duration(period_ns * 1e-9) if period_ns else "none"


def format_share(ratio: float | None) -> str:
    """Write a part of a whole for a reader, in two digits: `75 %`."""
    return f"{format_number(100.0 * ratio, digits=2)} %" if _is_number(ratio) else _word_for(ratio)


def format_number(value: float | None, *, digits: int = 3) -> str:
    """Write a number for a reader in so many significant digits: `12.5`, `30`, `12346`.

    All digits before the point stay, zeros at the end of the others go, and only beyond 1e15 there is an exponent.
    """
    if not _is_number(value):
        return _word_for(value)
    if abs(value) >= _HUGE:
        return f"{value:.{digits}g}"
    decimals = digits - 1 - math.floor(math.log10(abs(value))) if value else 0
    text = f"{value:z.{max(0, min(decimals, _MOST_DECIMALS))}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def _scaled(number: str, scale: Fraction) -> float:
    """Multiply exactly and round once, so that `1.1ms` is the float nearest to 0.0011."""
    try:
        return float(Fraction(number) * scale)
    except OverflowError:
        raise ValueError(f"'{printable(number)}' is too large; write a smaller number") from None


def _format(value: float | None, units: Mapping[str, float]) -> str:
    if not _is_number(value):
        return _word_for(value)
    # What rounds up to a unit is written in it: 999.9 kbit/s reads better as 1 Mbit/s.
    unit = next((unit for unit, scale in units.items() if abs(value) >= scale * 0.9995), [*units][-1])
    return f"{format_number(value / units[unit])} {unit}"


def _is_number(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)


def _word_for(value: float | None) -> str:
    if value is None:
        return "-"
    return "unlimited" if value > 0 else "unknown"


def printable(text: str, *, longest: int = _LONGEST) -> str:
    """Return text from outside as one line that cannot steer a terminal, cut short when long."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[: longest + 1])
    return shown if len(shown) <= longest else f"{shown[: longest - 1]}…"
