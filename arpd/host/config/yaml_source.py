"""Reads YAML as plain data, with the line and column of each key and value."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

import yaml

from arpd.model.errors import ConfigError
from arpd.model.quantities import printable

if TYPE_CHECKING:
    from collections.abc import Sequence
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


class Fault(NamedTuple):
    """One thing wrong with the file: its place, the dotted key, and ``what is wrong; what would be right``."""

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
    spoilt : what checks have found at fault; rules between keys go without it
    """

    data: dict[str, Any] = field(default_factory=dict)
    keys: dict[Location, Place] = field(default_factory=dict)
    values: dict[Location, Place] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)
    spoilt: set[Location] = field(default_factory=set)

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

    def items(self, location: Location, made: Sequence[T]) -> list[tuple[Location, T]]:
        """Return the place of each item of a list with what was made of it; nothing was made of what is at fault."""
        value = self.value(location)
        places = [(*location, index) for index in range(len(value))] if isinstance(value, list) else []
        return list(zip([place for place in places if place not in self.spoilt], made, strict=True))

    def fault(self, location: Location, text: str) -> Fault:
        """Return a fault of the value there, at the place of the nearest value around it where there is none."""
        found = (self.values.get(location[:length]) for length in range(len(location), 0, -1))
        return Fault(next((place for place in found if place), Place()), dotted(location), text)


class _RefusedError(Exception):
    """A fault that ends the reading."""

    def __init__(self, key: str, text: str, place: Place | None = None) -> None:
        super().__init__(text)
        self.fault = Fault(place or Place(), key, text)


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
        return _source(_text(path), minimal)
    except _RefusedError as error:
        raise config_error(path, [error.fault]) from None


def config_error(path: Path, faults: list[Fault]) -> ConfigError:
    """Return an error with one line for each of the first hundred faults, in the order of the file."""
    file = printable(str(path), longest=4096)
    faults = sorted(faults)
    if omitted := faults[MAX_FAULTS:]:
        text = f"has {len(omitted)} more faults; correct those above first"
        faults = [*faults[:MAX_FAULTS], Fault(omitted[0].place, "file", text)]
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


class _Loader(yaml.SafeLoader):
    """Composes nodes; refuses aliases (they expand), tags (they run code) and too much."""

    _depth = _nodes = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        self._nodes += 1
        if isinstance(event, yaml.AliasEvent) or event.anchor or event.tag:
            wrong = "anchors, aliases and tags are not allowed; write the value out"
        elif self._depth >= MAX_DEPTH:
            wrong = f"is nested more than {MAX_DEPTH} deep; remove levels"
        elif self._nodes > MAX_NODES:
            wrong = f"holds more than {MAX_NODES:,} keys and values; remove some"
        else:
            self._depth += 1
            node = super().compose_node(parent, index)
            self._depth -= 1
            return node
        raise _RefusedError("yaml", wrong, _place(event.start_mark))


def _source(text: str, minimal: str) -> YamlSource:
    loader = None
    try:
        loader = _Loader(text)
        node = loader.get_node() if loader.check_node() else None
        if loader.check_node():
            place = _place(loader.peek_event().start_mark)  # type: ignore[no-untyped-call]
            raise _RefusedError("yaml", "holds a second YAML document; keep one", place)
    except yaml.reader.ReaderError as error:
        wrong = "a control character is not allowed here; remove it"
        raise _RefusedError("yaml", wrong, _after(text[: error.position])) from None
    except yaml.MarkedYAMLError as error:
        wrong = f"{printable(error.problem or 'cannot be read', longest=200)}; correct the YAML here"
        raise _RefusedError("yaml", wrong, _place(error.problem_mark or error.context_mark)) from None
    except (ValueError, OverflowError):
        # PyYAML converts some numbers unchecked: "\UFFFFFFFF", %YAML 1.<5,000 digits>.
        wrong = "a number is out of range; correct the YAML here"
        raise _RefusedError("yaml", wrong, _place(loader and loader.get_mark())) from None
    if node is None or node.value == "":
        raise _RefusedError("file", f"is empty; {minimal}")
    if not isinstance(node, yaml.MappingNode):
        raise _RefusedError("file", f"is {_kind(node)}, not a mapping of keys; {minimal}", _place(node.start_mark))
    source = YamlSource()
    source.data.update(_plain(node, (), source))
    return source


def _plain(node: Any, location: Location, source: YamlSource) -> Any:
    """Return what a node holds, and note the places in it."""
    source.values[location] = _place(node.start_mark)
    if isinstance(node, yaml.ScalarNode):
        return _scalar(node.value) if node.style is None else node.value
    if isinstance(node, yaml.SequenceNode):
        return [_plain(item, (*location, index), source) for index, item in enumerate(node.value)]
    data: dict[str, Any] = {}
    for key, value in node.value:
        place, inner = _place(key.start_mark), (*location, key.value)
        if not isinstance(key, yaml.ScalarNode):
            raise _RefusedError("yaml", f"{_kind(key)} cannot be a key; write a name", place)
        if key.value in data:
            wrong = f"is already given on line {source.keys[inner].line}; keep one of the two"
            source.faults.append(Fault(place, dotted(inner), wrong))
        else:
            source.keys[inner] = place
            data[key.value] = _plain(value, inner, source)
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


def _kind(node: Any) -> str:
    if isinstance(node, yaml.ScalarNode):
        return "text"
    return "a mapping" if isinstance(node, yaml.MappingNode) else "a list"


def _place(mark: Any) -> Place:
    return Place(line=mark.line + 1, column=mark.column + 1) if mark else Place()


def _after(text: str) -> Place:
    return Place(line=text.count("\n") + 1, column=len(text) - text.rfind("\n"))
