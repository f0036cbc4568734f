"""Kinds of values that a configuration key takes; each is read from YAML, checked, and written back."""

# ruff: noqa: TRY004 - pydantic collects ValueError and lets TypeError through

from __future__ import annotations

import ipaddress
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from pydantic_core import core_schema

from arpd.model.names import LONGEST_NAME, is_hidden, is_internal, is_pattern
from arpd.model.quantities import (
    parse_duration,
    parse_rate,
    parse_size,
    printable,
    spell_duration,
    spell_rate,
    spell_size,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from enum import StrEnum

    from pydantic_core import ErrorDetails

NONE = "none"  # written where there is no value
Written: TypeAlias = str | float | list[str]  # a value as the file has it

_TOPIC = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+", re.ASCII)
_HOST = re.compile(r"(?=.{1,253}\Z)[A-Za-z0-9_](?:[A-Za-z0-9_.-]*[A-Za-z0-9_])?", re.ASCII)


class ValueKind(Protocol):
    """Reads, checks and writes the value of one key; an annotation of a pydantic field."""

    @property
    def suffix(self) -> str:
        """The unit that the settings attribute's name ends with and the key's does not."""

    @property
    def range(self) -> str:
        """The allowed values, as the manual prints them."""

    def read(self, raw: Any) -> Any:
        """Turn the value of the file into the value of the settings.

        Raises
        ------
        ValueError
            With ``what is wrong; what would be right``.
        """

    def write(self, value: Any) -> Written:
        """Turn the value of the settings into the value of the file."""


class _Reads:
    """Makes a kind usable as a pydantic annotation."""

    @property
    def suffix(self) -> str:
        """Nothing, unless the kind has a unit."""
        return ""

    def read(self, raw: Any) -> Any:
        """Read the value of the file."""
        raise NotImplementedError

    def write(self, value: Any) -> Written:
        """Write the value as it is."""
        return str(value)

    def __get_pydantic_core_schema__(self, _source: Any, _handler: Any) -> core_schema.CoreSchema:
        """Let ``read`` alone decide."""
        return core_schema.no_info_plain_validator_function(self.read)


@dataclass(frozen=True, kw_only=True)
class _Bounded(_Reads):
    """A value between two bounds, or a word.

    Parameters
    ----------
    low, high : bounds, both allowed
    word : may be written instead, and stands for None
    """

    low: Any
    high: Any
    word: str = ""

    @property
    def range(self) -> str:
        """The bounds and the word, as the manual prints them."""
        low, high = (bound if isinstance(bound, str) else f"{bound:.12g}" for bound in (self.low, self.high))
        return f"{low}..{high}" + (f" or {self.word}" if self.word else "")

    def read(self, raw: Any) -> Any:
        """Read a value within the bounds, or the word."""
        return None if self.word and raw == self.word else self._read(raw)

    def write(self, value: Any) -> str | float:
        """Write the value, or the word for None."""
        return self.word if value is None else self._write(value)

    def _read(self, raw: Any) -> Any:
        raise NotImplementedError

    def _write(self, value: Any) -> str | float:
        raise NotImplementedError

    def _check_bounds(self, raw: float) -> None:
        if raw < self.low:
            raise ValueError(f"{shown(raw)} is below {self.low:.12g}; write {self.range}")
        if raw > self.high:
            raise ValueError(f"{shown(raw)} is above {self.high:.12g}; write {self.range}")


@dataclass(frozen=True, kw_only=True)
class Number(_Bounded):
    """A number whose unit is in the key's name, if it has one."""

    low: float
    high: float

    def _read(self, raw: Any) -> float:
        if isinstance(raw, bool) or not isinstance(raw, int | float):
            raise ValueError(f"{shown(raw)} is not a number; write {self.range}")
        if not math.isfinite(raw):
            raise ValueError(f"{shown(raw)} is not a finite number; write {self.range}")
        self._check_bounds(raw)
        return float(raw)

    def _write(self, value: Any) -> float:
        return float(value)


@dataclass(frozen=True, kw_only=True)
class Count(_Bounded):
    """A whole number."""

    low: int
    high: int

    def _read(self, raw: Any) -> int:
        if isinstance(raw, bool) or not isinstance(raw, int):
            raise ValueError(f"{shown(raw)} is not a whole number; write {self.range}")
        self._check_bounds(raw)
        return raw

    def _write(self, value: Any) -> int:
        return int(value)


@dataclass(frozen=True, kw_only=True)
class Unit:
    """A dimension: its name, the functions that read and spell a quantity, and the suffix of settings attributes."""

    name: str
    parse: Callable[[str], float]
    spell: Callable[[float], str]
    suffix: str
    example: str


RATE = Unit(name="rate", parse=parse_rate, spell=spell_rate, suffix="_bytes_per_second", example="20mbit")
SIZE = Unit(name="size", parse=parse_size, spell=spell_size, suffix="_bytes", example="64MiB")
DURATION = Unit(name="duration", parse=parse_duration, spell=spell_duration, suffix="_s", example="500ms")


@dataclass(frozen=True, kw_only=True)
class Quantity(_Bounded):
    """A number with its unit, because the key does not name one; the bounds are quantities, too."""

    unit: Unit
    low: str
    high: str

    @property
    def suffix(self) -> str:
        """The unit in the settings attribute's name."""
        return self.unit.suffix

    def _read(self, raw: Any) -> float:
        """Return the quantity in base units."""
        if isinstance(raw, int | float) and not isinstance(raw, bool):
            raise ValueError(f"{shown(raw)} has no unit; write a {self.unit.name} like {self.unit.example}")
        if not isinstance(raw, str):
            raise ValueError(f"{shown(raw)} is not a {self.unit.name}; write {self.range}")
        value = self.unit.parse(raw)
        if not self.unit.parse(self.low) <= value <= self.unit.parse(self.high):
            raise ValueError(f"{printable(raw)} is out of range; write {self.range}")
        return value

    def _write(self, value: Any) -> str:
        return self.unit.spell(value)


@dataclass(frozen=True, kw_only=True)
class Text(_Reads):
    """Text of a certain form.

    Parameters
    ----------
    pattern : regular expression that the whole text matches
    what : name of the form, with its article
    range : description of a right text
    """

    pattern: str
    what: str
    range: str

    def read(self, raw: Any) -> str:
        """Read text that has the form."""
        if not isinstance(raw, str) or not re.fullmatch(self.pattern, raw, re.ASCII):
            raise ValueError(f"{shown(raw)} is not {self.what}; write {self.range}")
        return raw


@dataclass(frozen=True, kw_only=True)
class TopicName(_Reads):
    """An absolute ROS 2 name that rmw_validate_full_topic_name admits."""

    range: str = "an absolute ROS name such as /camera/image"

    def read(self, raw: Any) -> str:
        """Read an absolute name."""
        if not isinstance(raw, str):
            raise ValueError(f"{shown(raw)} is not a topic name; write {self.range}")
        if not _TOPIC.fullmatch(raw):
            hint = f"write /{raw}" if _TOPIC.fullmatch(f"/{raw}") else f"write {self.range}"
            raise ValueError(f"{shown(raw)} is not an absolute ROS name; {hint}")
        if len(raw) > LONGEST_NAME:
            raise ValueError(f"is {len(raw)} characters long; ROS allows {LONGEST_NAME}")
        return raw


@dataclass(frozen=True, kw_only=True)
class GroupedTopic(TopicName):
    """A topic of a group, which is named and not matched."""

    def read(self, raw: Any) -> str:
        """Read an absolute name without stars."""
        if isinstance(raw, str) and "*" in raw and is_pattern(raw):
            raise ValueError(f"{shown(raw)} is a pattern; name each topic of the group")
        return super().read(raw)


@dataclass(frozen=True, kw_only=True)
class Namespace(TopicName):
    """An absolute name to put before others, or `none` for the empty one."""

    range: str = f"an absolute ROS name such as /robot1, or {NONE}"

    def read(self, raw: Any) -> str:
        """Read an absolute name, or the word."""
        if raw == NONE:
            return ""
        name = super().read(raw)
        if is_hidden(name) or is_internal(f"{name}/"):
            raise ValueError(f"{shown(raw)} is a name that never crosses the link; write one such as /robot1")
        return name

    def write(self, value: Any) -> str:
        """Write the name, or the word."""
        return str(value) or NONE


@dataclass(frozen=True, kw_only=True)
class NamePattern(_Reads):
    """An absolute name in which stars stand for other characters."""

    range: str = "a name such as /scan or a pattern such as /camera/**"

    def read(self, raw: Any) -> str:
        """Read a pattern."""
        if not isinstance(raw, str):
            raise ValueError(f"{shown(raw)} is not a pattern; write {self.range}")
        if not is_pattern(raw):
            hint = f"write /{raw}" if is_pattern(f"/{raw}") else f"write {self.range}"
            raise ValueError(f"{shown(raw)} is not a pattern of absolute ROS names; {hint}")
        if len(raw) > LONGEST_NAME:
            raise ValueError(f"is {len(raw)} characters long; ROS allows {LONGEST_NAME}")
        return raw


@dataclass(frozen=True, kw_only=True)
class ListOf(_Reads):
    """A list, each item of which is of one kind.

    Parameters
    ----------
    item : kind of the items
    range : description of a right list
    """

    item: ValueKind
    range: str

    def read(self, raw: Any) -> tuple[Any, ...]:
        """Read all items."""
        if not isinstance(raw, list):
            raise ValueError(f"{shown(raw)} is not a list; write {self.range}")
        return tuple(map(self.item.read, raw))

    def write(self, value: Any) -> list[str]:
        """Write all items."""
        return [str(self.item.write(item)) for item in value]

    def __get_pydantic_core_schema__(self, _source: Any, _handler: Any) -> core_schema.CoreSchema:
        """Let each item be judged alone, so that a fault names its place."""
        item = core_schema.no_info_plain_validator_function(self.item.read)
        return core_schema.tuple_schema([item], variadic_item_index=0, strict=False)


@dataclass(frozen=True, kw_only=True)
class Address(_Reads):
    """An IP address or a host name, or `none` for an unknown one."""

    range: str = f"an IP address, a host name or {NONE}"

    def read(self, raw: Any) -> str | None:
        """Read an address, or the word."""
        if raw == NONE:
            return None
        if not isinstance(raw, str) or not _is_address(raw):
            raise ValueError(f"{shown(raw)} is not an address; write {self.range}")
        return raw

    def write(self, value: Any) -> str:
        """Write the address, or the word."""
        return NONE if value is None else str(value)


def _is_address(text: str) -> bool:
    if not re.fullmatch(r"[0-9.]+|.*:.*", text):
        return _HOST.fullmatch(text) is not None
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


@dataclass(frozen=True)
class Choice(_Reads):
    """One of a few words."""

    words: type[StrEnum]

    @property
    def range(self) -> str:
        """The words, as the manual prints them."""
        return " | ".join(self.words)

    def read(self, raw: Any) -> StrEnum:
        """Read one of the words."""
        if not isinstance(raw, str) or raw not in list(self.words):
            raise ValueError(f"{shown(raw)} is not one of the choices; write {' or '.join(self.words)}")
        return self.words(raw)


def reworded(details: ErrorDetails) -> str:
    """Return what a kind says of its value, or pydantic's own words for an error that no section expects."""
    if details["type"] == "value_error":
        return str(details["ctx"]["error"])
    return f"{printable(details['msg'])}; see the manual"


def shown(raw: Any) -> str:
    """Return a value of the file as a fault shows it."""
    match raw:
        case None:
            return "nothing"
        case bool():
            return str(raw).lower()
        case str():
            return f"'{printable(raw)}'"
        case list():
            return "a list"
        case dict():
            return "a mapping"
        case _:
            return repr(raw)
