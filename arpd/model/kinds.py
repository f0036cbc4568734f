"""Kinds of values in the configuration file that pydantic does not know: quantities with units, ROS names, addresses.

Each refuses a value with ``what is wrong; what would be right``.
"""

from __future__ import annotations

import ipaddress
import re
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, BeforeValidator, PlainSerializer, WrapSerializer, WrapValidator

from arpd.model.names import LONGEST_NAME, is_hidden, is_internal, is_pattern
from arpd.model.quantities import DURATION, RATE, SIZE, Units, printable

if TYPE_CHECKING:
    from collections.abc import Callable

NONE = "none"  # written where there is no value
_LABEL = "[A-Za-z0-9_](?:[A-Za-z0-9_-]{0,61}[A-Za-z0-9_])?"
_HOST = re.compile(rf"(?=.{{1,253}}\Z){_LABEL}(?:\.{_LABEL})*")
_ADDRESS = f"an IPv4 address of one computer, a host name or {NONE}"


def between(units: Units, low: str, high: str) -> Callable[[Any], float]:
    """Return a reader of a quantity between two bounds, in base units; it raises ValueError."""

    def read(raw: Any) -> float:
        value = units.parse(str(raw))
        if not units.parse(low) <= value <= units.parse(high):
            raise ValueError(f"{printable(raw)} is out of range; write {low}..{high}")
        return value

    return read


def _quantity(units: Units, low: str, high: str) -> tuple[Any, ...]:
    """Kind of a number that is written with its unit, because its key does not name one."""
    return BeforeValidator(between(units, low, high)), PlainSerializer(units.spell)


# Between two bounds: rate("8kbit", "100gbit").
rate = partial(_quantity, RATE)  # (bytes/s)
size = partial(_quantity, SIZE)  # (bytes)
duration = partial(_quantity, DURATION)  # (s)


def or_word(word: str, meaning: str | None = None) -> tuple[Any, ...]:
    """Let a kind take a word, too, which stands for ``meaning``."""
    return (
        WrapValidator(lambda raw, kind: meaning if raw == word else kind(raw)),
        WrapSerializer(lambda value, kind: word if value == meaning else kind(value)),
    )


def _name_pattern(raw: str) -> str:
    if not is_pattern(raw):
        hint = f"/{raw}" if is_pattern(f"/{raw}") else "one such as /camera/image or /camera/**"
        raise ValueError(f"'{printable(raw)}' is not an absolute ROS name or a pattern of such; write {hint}")
    if len(raw) > LONGEST_NAME:
        raise ValueError(f"is {len(raw)} characters long; ROS allows {LONGEST_NAME}")
    return raw


def _topic_name(raw: str) -> str:
    if "*" in _name_pattern(raw):
        raise ValueError(f"'{printable(raw)}' is a pattern; name each topic here")
    return raw


def _prefix(raw: str) -> str:
    if is_internal(f"{_topic_name(raw)}/"):
        raise ValueError(f"'{printable(raw)}' holds arpd's own topics; write one such as /robot1")
    return raw


def _namespace(raw: str) -> str:
    if is_hidden(_prefix(raw)):
        raise ValueError(f"'{printable(raw)}' is a name that never crosses the link; write one such as /robot1")
    return raw


def address(raw: str) -> str:
    """Return an IPv4 address or a host name, or raise ValueError."""
    if ":" in raw:
        raise ValueError(f"'{printable(raw)}' is no IPv4 address, and arpd's link is IPv4; write {_ADDRESS}")
    if re.fullmatch(r"[0-9.]+", raw):
        with suppress(ValueError):
            number = ipaddress.IPv4Address(raw)
            if not (number.is_unspecified or number.is_multicast or number.is_reserved):
                return raw
    elif _HOST.fullmatch(raw):
        return raw
    raise ValueError(f"'{printable(raw)}' is not an address; write {_ADDRESS}")


NamePattern = Annotated[str, AfterValidator(_name_pattern)]
TopicName = Annotated[str, AfterValidator(_topic_name)]
Prefix = Annotated[str, AfterValidator(_prefix)]
Namespace = Annotated[str, AfterValidator(_namespace), *or_word(NONE, "")]
Address = Annotated[str, AfterValidator(address)]
