"""Reads YAML as plain data, with the line and column of each key and value."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

import yaml

from arpd.model.errors import ConfigError
from arpd.model.quantities import printable

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

T = TypeVar("T")
Location: TypeAlias = tuple[str | int, ...]  # ("topics", 2, "min_rate_hz")
MAX_BYTES = 2**20
MAX_DEPTH = 20
MAX_NODES = 20_000  # keys and values; a thousand topics with every key have 18,000
MAX_FAULTS = 100
MINIMAL_FILE = "a minimal one is `link: {interface: auto}`"
_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+\.?[0-9]*)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)")
_CONSTANTS = {
    word: value
    for value, words in ((None, ("", "~", "null")), (True, ("true",)), (False, ("false",)))
    for word in (*words, *map(str.title, words), *map(str.upper, words))
}


class Place(NamedTuple):
    """A line and a column of the file, both counted from 1."""

    line: int = 1
    column: int = 1


@dataclass(frozen=True, kw_only=True, slots=True, order=True)
class Fault:
    """One thing wrong with the file.

    Parameters
    ----------
    place : line and column
    key : dotted key, ``file`` or ``yaml``
    text : ``what is wrong; what would be right``
    """

    place: Place
    key: str
    text: str


@dataclass(frozen=True, kw_only=True, slots=True)
class YamlSource:
    """A configuration file, read but not yet checked.

    Parameters
    ----------
    data : plain mappings, lists and scalars
    keys, values : place of each key and of each value
    faults : repeated keys
    """

    data: dict[str, Any] = field(default_factory=dict)
    keys: dict[Location, Place] = field(default_factory=dict)
    values: dict[Location, Place] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)

    def value(self, location: Location) -> Any:
        """Return the value there, None if there is none."""
        value: Any = self.data
        for step in location:
            if isinstance(value, dict):
                value = value.get(str(step))
            elif isinstance(value, list) and isinstance(step, int):
                value = value[step]
            else:
                return None
        return value

    def items(self, location: Location, made: Sequence[T], spoilt: Collection[Location]) -> list[tuple[Location, T]]:
        """Return the place of each item of a list with what was made of it; nothing was made of what is at fault."""
        value = self.value(location)
        places = [(*location, index) for index in range(len(value))] if isinstance(value, list) else []
        return list(zip([place for place in places if place not in spoilt], made, strict=True))

    def fault(self, location: Location, text: str) -> Fault:
        """Return a fault of the value there, at the place of the nearest value around it where there is none."""
        found = (self.values.get(location[:length]) for length in range(len(location), 0, -1))
        place = next((place for place in found if place), Place())
        return Fault(place=place, key=dotted(location), text=text)


class _RefusedError(Exception):
    """A fault that ends the reading."""

    def __init__(self, key: str, text: str, place: Place | None = None) -> None:
        super().__init__(text)
        self.fault = Fault(place=place or Place(), key=key, text=text)


def read_source(path: Path, *, minimal: str = MINIMAL_FILE) -> YamlSource:
    """Read a file.

    Parameters
    ----------
    minimal : suggestion for an empty file

    Raises
    ------
    ConfigError
        If the file cannot be read, is not one YAML mapping, or has anchors, aliases, tags or deep nesting.
    """
    try:
        return _Reader(_text(path)).read(minimal)
    except _RefusedError as error:
        raise config_error(path, [error.fault]) from None


def config_error(path: Path, faults: list[Fault]) -> ConfigError:
    """Return an error with one line for each of the first hundred faults, in the order of the file."""
    file = printable(str(path), longest=4096)
    faults = sorted(faults)
    if omitted := faults[MAX_FAULTS:]:
        text = f"has {len(omitted)} more faults; correct those above first"
        faults = [*faults[:MAX_FAULTS], Fault(place=omitted[0].place, key="file", text=text)]
    return ConfigError([f"{file}:{f.place.line}:{f.place.column}: {f.key}: {f.text}" for f in faults])


def dotted(location: Location) -> str:
    """Return a location as people write it: ``topics[2].min_rate_hz``."""
    path = "".join(f"[{step}]" if isinstance(step, int) else f".{_key(step)}" for step in location)
    return path.removeprefix(".")


def _key(name: str) -> str:
    """Return a key, quoted if it is empty or has spaces or dots in it."""
    return printable(name) if re.fullmatch(r"[\w-]+", name) else f"'{printable(name)}'"


def _text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        why = getattr(error, "strerror", None) or error
        raise _RefusedError("file", f"cannot be read ({why}); create it, change its mode, or name another") from None
    if len(raw) > MAX_BYTES:
        raise _RefusedError("file", "is larger than 1 MiB; shorten it or name another file")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        place = _after(raw[: error.start].decode(errors="replace"))
        raise _RefusedError("file", f"byte 0x{raw[error.start]:02x} is not UTF-8; save it as UTF-8", place) from None


class _Reader:
    """Makes plain data of PyYAML's events; refuses aliases (they expand), tags (they run code) and too much."""

    def __init__(self, text: str) -> None:
        try:
            self._loader = yaml.SafeLoader(text)
        except yaml.reader.ReaderError as error:
            wrong = "a control character is not allowed here; remove it"
            raise _RefusedError("yaml", wrong, _after(text[: error.position])) from None
        self._source = YamlSource()
        self._nodes = 0

    def read(self, minimal: str) -> YamlSource:
        self._next()
        event = self._next()
        if not isinstance(event, yaml.StreamEndEvent):
            event = self._next()
        if isinstance(event, yaml.StreamEndEvent) or (isinstance(event, yaml.ScalarEvent) and not event.value):
            raise _RefusedError("file", f"is empty; {minimal}")
        self._refuse(event, ())
        if not isinstance(event, yaml.MappingStartEvent):
            wrong = f"is {_kind(event)}, not a mapping of keys; {minimal}"
            raise _RefusedError("file", wrong, _place(event.start_mark))
        self._source.data.update(self._mapping(()))
        self._next()
        if not isinstance(event := self._next(), yaml.StreamEndEvent):
            raise _RefusedError("yaml", "holds a second YAML document; keep one", _place(event.start_mark))
        return self._source

    def _next(self) -> Any:
        try:
            return self._loader.get_event()  # type: ignore[no-untyped-call]
        except yaml.MarkedYAMLError as error:
            wrong = f"{printable(error.problem or 'cannot be read', longest=200)}; correct the YAML here"
            raise _RefusedError("yaml", wrong, _place(error.problem_mark or error.context_mark)) from None
        except (ValueError, OverflowError):
            # PyYAML converts some numbers unchecked: "\UFFFFFFFF", %YAML 1.<5,000 digits>.
            wrong = "a number is out of range; correct the YAML here"
            raise _RefusedError("yaml", wrong, _place(self._loader.get_mark())) from None

    def _refuse(self, event: Any, location: Location) -> None:
        self._nodes += 1
        if isinstance(event, yaml.AliasEvent) or event.anchor or event.tag:
            wrong = "anchors, aliases and tags are not allowed; write the value out"
        elif len(location) >= MAX_DEPTH:
            wrong = f"is nested more than {MAX_DEPTH} deep; remove levels"
        elif self._nodes > MAX_NODES:
            wrong = f"holds more than {MAX_NODES:,} keys and values; remove some"
        else:
            return
        raise _RefusedError("yaml", wrong, _place(event.start_mark))

    def _value(self, event: Any, location: Location) -> Any:
        self._refuse(event, location)
        self._source.values[location] = _place(event.start_mark)
        if isinstance(event, yaml.MappingStartEvent):
            return self._mapping(location)
        if isinstance(event, yaml.ScalarEvent):
            return _scalar(event.value) if event.implicit[0] else event.value
        items: list[Any] = []
        while not isinstance(event := self._next(), yaml.SequenceEndEvent):
            items.append(self._value(event, (*location, len(items))))
        return items

    def _mapping(self, location: Location) -> dict[str, Any]:
        data: dict[str, Any] = {}
        while not isinstance(event := self._next(), yaml.MappingEndEvent):
            self._refuse(event, location)
            place = _place(event.start_mark)
            if not isinstance(event, yaml.ScalarEvent):
                raise _RefusedError("yaml", f"{_kind(event)} cannot be a key; write a name", place)
            inner = (*location, event.value)
            if event.value in data:
                wrong = f"is already given on line {self._source.keys[inner].line}; keep one of the two"
                self._source.faults.append(Fault(place=place, key=dotted(inner), text=wrong))
                self._value(self._next(), (*location, ""))
                continue
            self._source.keys[inner] = place
            data[event.value] = self._value(self._next(), inner)
        return data


def _scalar(text: str) -> Any:
    """Resolve as YAML 1.2 does; YAML 1.1, which PyYAML reads, surprises: `1:30` is 90, `010` is 8, `on` is true."""
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if _INTEGER.fullmatch(text) and len(text) <= 18:  # more digits need not be exact; Python refuses more than 4,300
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text.replace(".", "", 1) if text[-1] in "fFnN" else text)
    return text


def _kind(event: Any) -> str:
    if isinstance(event, yaml.ScalarEvent):
        return "text"
    return "a mapping" if isinstance(event, yaml.MappingStartEvent) else "a list"


def _place(mark: Any) -> Place:
    return Place(line=mark.line + 1, column=mark.column + 1) if mark else Place()


def _after(text: str) -> Place:
    return Place(line=text.count("\n") + 1, column=len(text) - text.rfind("\n"))
