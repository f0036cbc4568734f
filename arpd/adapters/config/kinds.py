"""Kinds of values a configuration key takes: how each is read from YAML, checked, and written back."""

# ruff: noqa: TRY004 - pydantic collects ValueError and lets TypeError through

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from pydantic_core import core_schema

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

LONGEST_TOPIC = 247  # RMW_TOPIC_MAX_NAME_LENGTH: what DDS allows (255) less room for rmw's prefixes
_TOPIC = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+", re.ASCII)


class ValueKind(Protocol):
    """How one key's value is read and written; an annotation of a pydantic field.

    ``read`` raises ValueError with ``what is wrong; what would be right``; ``suffix`` completes the key to the name of
    the settings attribute that holds the value in base units; ``range`` is what the manual says.
    """

    @property
    def suffix(self) -> str:
        """What the settings attribute's name has and the key has not."""

    @property
    def range(self) -> str:
        """What is allowed, in words."""

    def read(self, raw: Any) -> Any:
        """Turn the value of the file into the value of the settings."""

    def write(self, value: Any) -> str | float:
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

    def __get_pydantic_core_schema__(self, _source: Any, _handler: Any) -> core_schema.CoreSchema:
        """Let ``read`` alone decide."""
        return core_schema.no_info_plain_validator_function(self.read)


@dataclass(frozen=True, kw_only=True)
class Number(_Reads):
    """A number whose unit is in the key's name, if it has one.

    Parameters
    ----------
    low, high : bounds, both allowed
    word : what may be written in its place, and stands for None
    """

    low: float
    high: float
    word: str = ""

    @property
    def range(self) -> str:
        """The bounds, as the manual writes them."""
        return f"{self.low:g}..{self.high:.12g}" + (f" or {self.word}" if self.word else "")

    def read(self, raw: Any) -> float | None:
        """Read a number or the word."""
        if self.word and raw == self.word:
            return None
        if isinstance(raw, bool) or not isinstance(raw, int | float):
            raise ValueError(f"{shown(raw)} is not a number; write {self.range}")
        if not math.isfinite(raw):
            raise ValueError(f"{shown(raw)} is not a finite number; write {self.range}")
        _check_bounds(raw, self)
        return float(raw)

    def write(self, value: Any) -> str | float:
        """Write the number, or the word for None."""
        return self.word if value is None else float(value)


@dataclass(frozen=True, kw_only=True)
class Count(_Reads):
    """A whole number; the parameters are those of `Number`."""

    low: int
    high: int
    word: str = ""

    @property
    def range(self) -> str:
        """The bounds, as the manual writes them."""
        return f"{self.low}..{self.high}" + (f" or {self.word}" if self.word else "")

    def read(self, raw: Any) -> int | None:
        """Read a whole number or the word."""
        if self.word and raw == self.word:
            return None
        if isinstance(raw, bool) or not isinstance(raw, int):
            raise ValueError(f"{shown(raw)} is not a whole number; write {self.range}")
        _check_bounds(raw, self)
        return raw

    def write(self, value: Any) -> str | float:
        """Write the number, or the word for None."""
        return self.word if value is None else int(value)


@dataclass(frozen=True, kw_only=True)
class Unit:
    """A dimension: how its quantities are read and spelled, and what the attribute that holds one is called."""

    name: str
    parse: Callable[[str], float]
    spell: Callable[[float], str]
    suffix: str
    example: str


RATE = Unit(name="rate", parse=parse_rate, spell=spell_rate, suffix="_bytes_per_second", example="20mbit")
SIZE = Unit(name="size", parse=parse_size, spell=spell_size, suffix="_bytes", example="64MiB")
DURATION = Unit(name="duration", parse=parse_duration, spell=spell_duration, suffix="_s", example="500ms")


@dataclass(frozen=True, kw_only=True)
class Quantity(_Reads):
    """A number with its unit; always with it, because the key does not say it.

    Parameters
    ----------
    unit : dimension
    low, high : bounds as people write them, both allowed
    word : what may be written in its place, and stands for None
    """

    unit: Unit
    low: str
    high: str
    word: str = ""

    @property
    def suffix(self) -> str:
        """The unit in the settings attribute's name."""
        return self.unit.suffix

    @property
    def range(self) -> str:
        """The bounds, as the manual writes them."""
        return f"{self.low}..{self.high}" + (f" or {self.word}" if self.word else "")

    def read(self, raw: Any) -> float | None:
        """Read a quantity, in base units, or the word."""
        if self.word and raw == self.word:
            return None
        if isinstance(raw, int | float) and not isinstance(raw, bool):
            raise ValueError(f"{shown(raw)} has no unit; write a {self.unit.name} like {self.unit.example}")
        if not isinstance(raw, str):
            raise ValueError(f"{shown(raw)} is not a {self.unit.name}; write {self.range}")
        value = self.unit.parse(raw)
        if not self.unit.parse(self.low) <= value <= self.unit.parse(self.high):
            raise ValueError(f"{printable(raw)} is out of range; write {self.range}")
        return value

    def write(self, value: Any) -> str:
        """Spell the quantity, or the word for None."""
        return self.word if value is None else self.unit.spell(value)


@dataclass(frozen=True, kw_only=True)
class Text(_Reads):
    """Text of a certain form.

    Parameters
    ----------
    pattern : the whole text
    what : what it is, with its article
    range : what would be right
    """

    pattern: str
    what: str
    range: str

    def read(self, raw: Any) -> str:
        """Read text that has the form."""
        if not isinstance(raw, str) or not re.fullmatch(self.pattern, raw, re.ASCII):
            raise ValueError(f"{shown(raw)} is not {self.what}; write {self.range}")
        return raw

    def write(self, value: Any) -> str:
        """Write it as it is."""
        return str(value)


@dataclass(frozen=True, kw_only=True)
class TopicName(_Reads):
    """An absolute ROS 2 name: what rmw_validate_full_topic_name admits."""

    range: str = "an absolute ROS name such as /camera/image"

    def read(self, raw: Any) -> str:
        """Read an absolute name."""
        if not isinstance(raw, str):
            raise ValueError(f"{shown(raw)} is not a topic name; write {self.range}")
        if not _TOPIC.fullmatch(raw):
            hint = f"write /{raw}" if _TOPIC.fullmatch(f"/{raw}") else f"write {self.range}"
            raise ValueError(f"{shown(raw)} is not an absolute ROS name; {hint}")
        if len(raw) > LONGEST_TOPIC:
            raise ValueError(f"is {len(raw)} characters long; ROS allows {LONGEST_TOPIC}")
        return raw

    def write(self, value: Any) -> str:
        """Write it as it is."""
        return str(value)


@dataclass(frozen=True)
class Choice(_Reads):
    """One of a few words."""

    words: type[StrEnum]

    @property
    def range(self) -> str:
        """The words, as the manual writes them."""
        return " | ".join(self.words)

    def read(self, raw: Any) -> StrEnum:
        """Read one of the words."""
        if not isinstance(raw, str) or raw not in list(self.words):
            raise ValueError(f"{shown(raw)} is not one of the choices; write {' or '.join(self.words)}")
        return self.words(raw)

    def write(self, value: Any) -> str:
        """Write the word."""
        return str(value)


def shown(raw: Any) -> str:
    """Show a value from the file in a fault."""
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


def _check_bounds(raw: Any, kind: Number | Count) -> None:
    if raw < kind.low:
        raise ValueError(f"{shown(raw)} is below {kind.low:g}; write {kind.range}")
    if raw > kind.high:
        raise ValueError(f"{shown(raw)} is above {kind.high:.12g}; write {kind.range}")
