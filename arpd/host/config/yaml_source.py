"""Reads YAML as plain data, with the line and column of each key and value."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import yaml

from arpd.model.errors import ConfigError
from arpd.model.quantities import printable

if TYPE_CHECKING:
    from pathlib import Path

Location: TypeAlias = tuple[str | int, ...]  # ("topics", 2, "min_rate_hz")
MAX_BYTES = 2**20
MAX_DEPTH = 20
MAX_NODES = 20_000  # keys and values; a thousand topics with every key have 18,000
MAX_FAULTS = 100
MINIMAL_FILE = "a minimal one is `link: {interface: auto}`"


@dataclass(frozen=True, kw_only=True, slots=True, order=True)
class Place:
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
    faults : repeated keys and keys that are no names
    """

    data: dict[str, Any]
    keys: dict[Location, Place] = field(default_factory=dict)
    values: dict[Location, Place] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)

    def place(self, location: Location) -> Place:
        """Return the place of a value, or of the nearest mapping or list around it."""
        while location:
            if location in self.values:
                return self.values[location]
            location = location[:-1]
        return Place()

    def value(self, location: Location) -> Any:
        """Return the value there, None if there is none."""
        value: Any = self.data
        for step in location:
            if isinstance(value, dict):
                value = value.get(step)
            elif isinstance(value, list) and isinstance(step, int):
                value = value[step]
            else:
                return None
        return value

    def fault(self, location: Location, text: str) -> Fault:
        """Return a fault of the value there."""
        return Fault(place=self.place(location), key=dotted(location), text=text)


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
        return _compose(_text(path), minimal)
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


class _RefusedError(Exception):
    """A fault that ends the reading."""

    def __init__(self, key: str, text: str, place: Place | None = None) -> None:
        super().__init__(text)
        self.fault = Fault(place=place or Place(), key=key, text=text)


def _text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise _RefusedError("file", "does not exist; create it or name another file") from None
    except IsADirectoryError:
        raise _RefusedError("file", "is a directory; name a YAML file") from None
    except PermissionError:
        raise _RefusedError("file", "is not readable for this user; change its mode or owner") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise _RefusedError("file", f"cannot be read ({error}); name another file") from None
    if len(raw) > MAX_BYTES:
        raise _RefusedError("file", "is larger than 1 MiB; shorten it or name another file")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        place = Place(line=before.count(b"\n") + 1, column=error.start - (before.rfind(b"\n") + 1) + 1)
        raise _RefusedError("file", f"byte 0x{raw[error.start]:02x} is not UTF-8; save it as UTF-8", place) from None


class _Loader(yaml.SafeLoader):
    """Composes nodes; refuses aliases (they expand), tags (they run code), deep nesting and too many nodes."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 - PyYAML's own way

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0
        self._nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        place = _place(event.start_mark)
        anchor = printable(getattr(event, "anchor", None) or "")
        if isinstance(event, yaml.AliasEvent):
            raise _RefusedError("yaml", f"alias *{anchor} is not allowed; write the value out", place)
        if anchor:
            raise _RefusedError("yaml", f"anchor &{anchor} is not allowed; remove it", place)
        if getattr(event, "tag", None):
            raise _RefusedError("yaml", f"tag {printable(event.tag)} is not allowed; remove it", place)
        if self._depth >= MAX_DEPTH:
            raise _RefusedError("yaml", f"is nested more than {MAX_DEPTH} deep; remove levels", place)
        if self._nodes >= MAX_NODES:
            text = f"holds more than {MAX_NODES:,} keys and values; remove some"
            raise _RefusedError("yaml", text, place)
        self._depth += 1
        self._nodes += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1


# The core types of YAML 1.2, because YAML 1.1, which PyYAML reads, surprises: `1:30` is 90, `010` is 8, `on` is true.
for _tag, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?[0-9]+", list("-+0123456789")),
    (
        "float",
        r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        list("-+.0123456789"),
    ),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(rf"(?:{_pattern})\Z"), _first)


def _compose(text: str, minimal: str) -> YamlSource:
    root = _root(text)
    if root is None or (isinstance(root, yaml.ScalarNode) and not root.value):
        raise _RefusedError("file", f"is empty; {minimal}")
    if not isinstance(root, yaml.MappingNode):
        place = _place(root.start_mark)
        raise _RefusedError("file", f"is {_kind(root)}, not a mapping of keys; {minimal}", place)
    source = YamlSource(data={})
    source.data.update(_plain_mapping(root, (), source))
    return source


def _root(text: str) -> yaml.Node | None:
    loader = None
    try:
        loader = _Loader(text)
        return loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        if error.problem == "but found another document":
            wrong = "holds a second YAML document; keep one"
        else:
            wrong = f"{printable(error.problem or 'cannot be read', longest=200)}; correct the YAML here"
        raise _RefusedError("yaml", wrong, _place(mark)) from None
    except yaml.reader.ReaderError as error:
        before = text[: error.position]
        place = Place(line=before.count("\n") + 1, column=len(before) - (before.rfind("\n") + 1) + 1)
        raise _RefusedError("yaml", "a control character is not allowed here; remove it", place) from None
    except (ValueError, OverflowError):
        # PyYAML converts some numbers unchecked: "\UFFFFFFFF", %YAML 1.<5,000 digits>.
        mark = loader.get_mark() if loader else None
        raise _RefusedError("yaml", "a number is out of range; correct the YAML here", _place(mark)) from None


def _plain(node: yaml.Node, location: Location, source: YamlSource) -> Any:
    source.values[location] = _place(node.start_mark)
    if isinstance(node, yaml.MappingNode):
        return _plain_mapping(node, location, source)
    if isinstance(node, yaml.SequenceNode):
        return [_plain(item, (*location, index), source) for index, item in enumerate(node.value)]
    return _scalar(node)


def _plain_mapping(node: yaml.MappingNode, location: Location, source: YamlSource) -> dict[str, Any]:
    data: dict[str, Any] = {}
    for key_node, value_node in node.value:
        place = _place(key_node.start_mark)
        if not isinstance(key_node, yaml.ScalarNode) or not key_node.tag.endswith(":str"):
            where = dotted(location) or "file"
            source.faults.append(Fault(place=place, key=where, text=f"has {_kind(key_node)} for a key; write a name"))
            continue
        inner = (*location, key_node.value)
        if key_node.value in data:
            first = source.keys[inner].line
            wrong = f"is already given on line {first}; keep one of the two"
            source.faults.append(Fault(place=place, key=dotted(inner), text=wrong))
            continue
        source.keys[inner] = place
        data[key_node.value] = _plain(value_node, inner, source)
    return data


def _scalar(node: yaml.Node) -> Any:
    text: str = node.value
    match node.tag.rpartition(":")[2]:
        case "null":
            return None
        case "bool":
            return text.lower() == "true"
        case "int":
            # More than 18 digits need not be exact; Python refuses to convert more than 4,300.
            return int(text) if len(text) <= 18 else float(text)
        case "float":
            return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        case _:
            return text


def _kind(node: yaml.Node) -> str:
    if isinstance(node, yaml.SequenceNode):
        return "a list"
    if isinstance(node, yaml.MappingNode):
        return "a mapping"
    kinds = {"null": "nothing", "bool": "true or false", "int": "a number", "float": "a number"}
    return kinds.get(node.tag.rpartition(":")[2], "text")


def _place(mark: Any) -> Place:
    return Place(line=mark.line + 1, column=mark.column + 1) if mark else Place()
