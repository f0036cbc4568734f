"""Kinds of values that the keys of a file take: how each is read, written back and described."""

# ruff: noqa: TRY004 - pydantic collects ValueError and lets TypeError through

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

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

NONE = "none"  # written where there is no value
Written: TypeAlias = str | float | list[Any]  # a value as the file has it
_HOST = re.compile(r"(?=.{1,253}\Z)[A-Za-z0-9_](?:[A-Za-z0-9_.-]*[A-Za-z0-9_])?", re.ASCII)


@dataclass(frozen=True, kw_only=True)
class Kind:
    """Kind of the value of one key; it annotates the attribute of the settings, where pydantic finds it.

    Parameters
    ----------
    read : turns the value of the file into that of the settings, or raises ValueError with ``what is wrong; what would
        be right``
    write : turns it back
    range : right values, as the manual prints them
    word : stands for None
    """

    read: Callable[[Any], Any]
    write: Callable[[Any], Written] = str
    range: str
    word: str = ""

    def __get_pydantic_core_schema__(self, _source: Any, _handler: Any) -> Any:
        """Let ``read`` alone decide; only a process that reads a file with pydantic gets here."""
        from pydantic_core import core_schema  # noqa: PLC0415 - users' nodes have no pydantic

        return core_schema.no_info_plain_validator_function(self.read)


def number(low: float, high: float, *, word: str = "", of: type[float] = float) -> Kind:
    """Return the kind of a number, both bounds allowed, or a word for None."""
    what, right = "a whole number" if of is int else "a number", f"{low:.12g}..{high:.12g}"

    def read(raw: Any) -> float:
        if isinstance(raw, bool) or not isinstance(raw, int if of is int else int | float):
            raise ValueError(f"{shown(raw)} is not {what}; write {right}")
        if not low <= raw <= high:  # neither is what is not finite
            raise ValueError(f"{shown(raw)} is out of range; write {right}")
        return of(raw)

    return _or_word(Kind(read=read, write=of, range=right), word)


count = partial(number, of=int)


def _quantity(
    parse: Callable[[str], float], spell: Callable[[float], str], what: str, low: str, high: str, *, word: str = ""
) -> Kind:
    """Return the kind of a number with its unit, because the key does not name one."""

    def read(raw: Any) -> float:
        if isinstance(raw, int | float) and not isinstance(raw, bool):
            raise ValueError(f"{shown(raw)} has no unit; write {what}")
        if not isinstance(raw, str):
            raise ValueError(f"{shown(raw)} is not {what}; write {low}..{high}")
        value = parse(raw)
        if not parse(low) <= value <= parse(high):
            raise ValueError(f"{printable(raw)} is out of range; write {low}..{high}")
        return value

    return _or_word(Kind(read=read, write=spell, range=f"{low}..{high}"), word)


# Kinds of quantities between two bounds, or a word for None: rate("8kbit", "100gbit", word="auto").
rate = partial(_quantity, parse_rate, spell_rate, "a rate like 20mbit")  # (bytes/s)
size = partial(_quantity, parse_size, spell_size, "a size like 64MiB")  # (bytes)
duration = partial(_quantity, parse_duration, spell_duration, "a duration like 500ms")  # (s)


def choice(words: type[StrEnum]) -> Kind:
    """Return the kind of one of a few words."""

    def read(raw: Any) -> StrEnum:
        if not isinstance(raw, str) or raw not in list(words):
            raise ValueError(f"{shown(raw)} is not one of the choices; write {' or '.join(words)}")
        return words(raw)

    return Kind(read=read, range=" | ".join(words))


def text(pattern: str, what: str, right: str, *, word: str = "") -> Kind:
    """Return the kind of text that a pattern matches as a whole.

    Parameters
    ----------
    what : name of the form, with its article
    right : description of a right text
    """

    def read(raw: Any) -> str:
        if not isinstance(raw, str) or not re.fullmatch(pattern, raw, re.ASCII):
            raise ValueError(f"{shown(raw)} is not {what}; write {right}")
        return raw

    return _or_word(Kind(read=read, range=right), word)


def _name_pattern(raw: Any) -> str:
    if not isinstance(raw, str) or not is_pattern(raw):
        hint = f"/{raw}" if is_pattern(f"/{raw}") else "one such as /camera/image or /camera/**"
        raise ValueError(f"{shown(raw)} is not an absolute ROS name or a pattern of such; write {hint}")
    if len(raw) > LONGEST_NAME:
        raise ValueError(f"is {len(raw)} characters long; ROS allows {LONGEST_NAME}")
    return raw


def _topic_name(raw: Any) -> str:
    name = _name_pattern(raw)
    if "*" in name:
        raise ValueError(f"{shown(raw)} is a pattern; name each topic here")
    return name


def _namespace(raw: Any) -> str:
    if raw == NONE:
        return ""
    name = _topic_name(raw)
    if is_hidden(name) or is_internal(f"{name}/"):
        raise ValueError(f"{shown(raw)} is a name that never crosses the link; write one such as /robot1")
    return name


_ADDRESS = f"an IPv4 address, a host name or {NONE}"


def _address(raw: Any) -> str | None:
    if raw == NONE:
        return None
    if isinstance(raw, str) and ":" in raw:
        raise ValueError(f"{shown(raw)} is no IPv4 address, and arpd's link is IPv4; write {_ADDRESS}")
    if not isinstance(raw, str) or not _is_address(raw):
        raise ValueError(f"{shown(raw)} is not an address; write {_ADDRESS}")
    return raw


def _is_address(raw: str) -> bool:
    if not re.fullmatch(r"[0-9.]+", raw):
        return _HOST.fullmatch(raw) is not None
    try:
        ipaddress.IPv4Address(raw)
    except ValueError:
        return False
    return True


def _or_none(value: str | None) -> str:
    return value or NONE


NAME_PATTERN = Kind(read=_name_pattern, range="a name such as /scan or a pattern such as /camera/**")
TOPIC_NAME = Kind(read=_topic_name, range="an absolute ROS name such as /camera/image")
NAMESPACE = Kind(read=_namespace, write=_or_none, range=f"an absolute ROS name such as /robot1, or {NONE}")
ADDRESS = Kind(read=_address, write=_or_none, range=_ADDRESS, word=NONE)


@dataclass(frozen=True, kw_only=True)
class ListOf(Kind):
    """Kind of a list; ``item`` is that of each item, and a fault names the item's place."""

    item: Kind

    def __get_pydantic_core_schema__(self, _source: Any, handler: Any) -> Any:
        """Let pydantic go through the items."""
        from pydantic_core import core_schema  # noqa: PLC0415 - users' nodes have no pydantic

        return core_schema.tuple_schema([self.item.__get_pydantic_core_schema__(None, handler)], variadic_item_index=0)


def listed(item: Kind, right: str) -> Kind:
    """Return the kind of a list whose items are of one kind.

    Parameters
    ----------
    right : description of a right list
    """
    return ListOf(read=tuple, write=lambda value: [item.write(each) for each in value], range=right, item=item)


def _or_word(kind: Kind, word: str) -> Kind:
    """Return a kind that takes a word for None, too."""
    if not word:
        return kind
    return Kind(
        read=lambda raw: None if raw == word else kind.read(raw),
        write=lambda value: word if value is None else kind.write(value),
        range=f"{kind.range} or {word}",
        word=word,
    )


def shown(raw: Any) -> str:
    """Return a value of the file as a fault shows it."""
    if isinstance(raw, str):
        return f"'{printable(raw)}'"
    words = {type(None): "nothing", bool: str(raw).lower(), list: "a list", dict: "a mapping"}
    return words.get(type(raw)) or repr(raw)
