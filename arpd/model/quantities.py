"""Quantities as people write and read them (`20mbit`, `64MiB`, `12.5 ms`), from and to the base units of the code.

``parse_*`` reads, ``spell_*`` writes what ``parse_*`` reads back exactly, ``format_*`` writes for a reader; it writes
None as `-`, infinity as `unlimited`, NaN as `unknown`.
"""

from __future__ import annotations

import math
import re
from fractions import Fraction
from typing import TYPE_CHECKING, TypeGuard

if TYPE_CHECKING:
    from collections.abc import Mapping

# The bit units are those of tc(8), decimal. tc's byte units (`kbps` is kilobytes there) are missing on purpose:
# everybody reads them as bits.
_BIT_RATES = {
    unit: Fraction(scale, 8) for unit, scale in {"bit": 1, "kbit": 10**3, "mbit": 10**6, "gbit": 10**9}.items()
}
_SIZES = {
    unit: Fraction(scale)
    for unit, scale in {
        "B": 1,
        "kB": 10**3,
        "MB": 10**6,
        "GB": 10**9,
        "KiB": 2**10,
        "MiB": 2**20,
        "GiB": 2**30,
    }.items()
}
_DURATIONS = {
    "ns": Fraction(1, 10**9),
    "us": Fraction(1, 10**6),
    "ms": Fraction(1, 10**3),
    "s": Fraction(1),
    "min": Fraction(60),
    "h": Fraction(3600),
}
# Exponents of three digits and 40 characters in all: a quantity never costs more memory than its text.
_QUANTITY = re.compile(r"\s*([0-9]+(?:\.[0-9]*)?(?:[eE][-+]?[0-9]{1,3})?|\.[0-9]+)\s*([A-Za-zµμ/]*)\s*", re.ASCII)
_LONGEST = 40
_MOST_DECIMALS = 9
_HUGE = 1e15  # floats hold every whole number below it


def parse_rate(text: str) -> float:
    """Read a data rate: `bit`, `kbit`, `mbit`, `gbit` (any case, `/s` allowed), or `B/s`, `kB/s`, `MiB/s` and so on.

    Returns
    -------
    The rate (bytes/s).

    Raises
    ------
    ValueError
        If it is not a rate.
    """
    number, unit = _split(text, "rate", "20mbit or 125kB/s")
    if unit.casefold() in {"kbps", "mbps", "gbps", "bps"}:
        raise ValueError(f"'{unit}' means bits to some and bytes to tc(8); write kbit, mbit, gbit, kB/s or MB/s")
    bits = unit.casefold().removesuffix("/s")
    if bits in _BIT_RATES:
        return _scaled(number, _BIT_RATES[bits])
    size = _byte_unit(unit.removesuffix("/s"))
    if unit.endswith("/s") and size in _SIZES:
        return _scaled(number, _SIZES[size])
    raise ValueError(_no_such_unit(text, unit, "rate", "20mbit or 125kB/s"))


def parse_size(text: str) -> float:
    """Read an amount of memory or data: `B`, `kB`, `MB`, `GB` (decimal) or `KiB`, `MiB`, `GiB` (binary).

    Returns
    -------
    The size (bytes).

    Raises
    ------
    ValueError
        If it is not a size.
    """
    number, unit = _split(text, "size", "64MiB or 500kB")
    if (name := _byte_unit(unit)) in _SIZES:
        return _scaled(number, _SIZES[name])
    raise ValueError(_no_such_unit(text, unit, "size", "64MiB or 500kB"))


def parse_duration(text: str) -> float:
    """Read a duration: `ns`, `us`, `ms`, `s`, `min` or `h`.

    Returns
    -------
    The duration (s).

    Raises
    ------
    ValueError
        If it is not a duration.
    """
    number, unit = _split(text, "duration", "500ms or 2s")
    if (name := re.sub("[µμ]s", "us", unit)) in _DURATIONS:
        return _scaled(number, _DURATIONS[name])
    raise ValueError(_no_such_unit(text, unit, "duration", "500ms or 2s"))


def spell_rate(bytes_per_second: float) -> str:
    """Write a rate (bytes/s) so that `parse_rate` reads exactly the same number."""
    return _spell(bytes_per_second, _BIT_RATES)


def spell_size(size_bytes: float) -> str:
    """Write a size (bytes) so that `parse_size` reads exactly the same number."""
    return _spell(size_bytes, _SIZES)


def spell_duration(seconds: float) -> str:
    """Write a duration (s) so that `parse_duration` reads exactly the same number."""
    return _spell(seconds, _DURATIONS)


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


def shortened(value: float) -> float:
    """Return a number in five digits: more than a reader needs, and short in JSON."""
    return float(f"{value:.5g}")


def _split(text: str, what: str, example: str) -> tuple[str, str]:
    match = _QUANTITY.fullmatch(text) if len(text) <= _LONGEST else None
    if match is None:
        raise ValueError(f"{_quoted(text)} is not a {what}; write it like {example}")
    return match[1], match[2]


def _scaled(number: str, scale: Fraction) -> float:
    """Multiply exactly and round once, so that `1.1ms` is the float nearest to 0.0011."""
    try:
        return float(Fraction(number) * scale)
    except OverflowError:
        raise ValueError(f"{_quoted(number)} is too large; write a smaller number") from None


def _byte_unit(unit: str) -> str:
    """Accept `KB` for `kB`. Every other unit keeps its case: `Mb` may mean megabits."""
    return "kB" if unit == "KB" else unit


def _no_such_unit(text: str, unit: str, what: str, example: str) -> str:
    if not unit:
        return f"{_quoted(text)} has no unit; write a {what} like {example}"
    return f"'{unit[:_LONGEST]}' is not a unit of a {what}; write it like {example}"


def _quoted(text: str) -> str:
    shown = ascii(text)
    return shown if len(shown) <= _LONGEST else f"{shown[: _LONGEST - 1]}…'"


def _spell(value: float, units: Mapping[str, Fraction]) -> str:
    """Return the shortest text that gives the value back exactly."""
    spellings = [
        f"{number}{unit}"
        for unit, scale in units.items()
        for number in (f"{value / float(scale):g}", f"{value / float(scale)!r}")
        if _scaled(number, scale) == value
    ]
    return min(spellings, key=len)


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
