"""Kinds of values in the configuration file that pydantic does not know: quantities with units, ROS names, addresses.

Each refuses a value with ``what is wrong; what would be right``.
"""

from __future__ import annotations

import ipaddress
import re
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

from pydantic import AfterValidator
from pydantic_core import core_schema

from arpd.model.names import LONGEST_NAME, is_hidden, is_internal, is_pattern
from arpd.model.quantities import DURATION, RATE, SIZE, Units, printable

NONE = "none"  # written where there is no value
_LABEL = "[A-Za-z0-9_](?:[A-Za-z0-9_-]{0,61}[A-Za-z0-9_])?"
_HOST = re.compile(rf"(?=.{{1,253}}\Z){_LABEL}(?:\.{_LABEL})*")
_ADDRESS = f"an IPv4 address of one computer, a host name or {NONE}"


@dataclass(frozen=True)
class Quantity:
    """Kind of a number between two bounds that is written with its unit, because its key does not name one."""

    units: Units
    low: str
    high: str

    def read(self, raw: Any) -> float:
        """Return the quantity in base units."""
        value = self.units.parse(str(raw))
        if not self.units.parse(self.low) <= value <= self.units.parse(self.high):
            raise ValueError(f"{printable(raw)} is out of range; write {self.low}..{self.high}")
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Read before pydantic looks at the number, and write it with its unit."""
        written = core_schema.plain_serializer_function_ser_schema(self.units.spell)
        return core_schema.no_info_before_validator_function(self.read, handler(source), serialization=written)


# Between two bounds: rate("8kbit", "100gbit").
rate = partial(Quantity, RATE)  # (bytes/s)
size = partial(Quantity, SIZE)  # (bytes)
duration = partial(Quantity, DURATION)  # (s)


@dataclass(frozen=True)
class OrWord:
    """A kind that takes a word, too, which stands for ``meaning``."""

    word: str
    meaning: str | None = None

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Keep the word from the kind."""
        return core_schema.no_info_wrap_validator_function(
            lambda raw, kind: self.meaning if raw == self.word else kind(raw),
            handler(source),
            serialization=core_schema.wrap_serializer_function_ser_schema(
                lambda value, kind: self.word if value == self.meaning else kind(value)
            ),
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
Namespace = Annotated[str, AfterValidator(_namespace), OrWord(NONE, "")]
Address = Annotated[str, AfterValidator(address)]
