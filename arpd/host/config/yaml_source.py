"""Reads YAML as plain data, each scalar as text, with the line and column of each key and value."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import yaml

from arpd.model.errors import ConfigError
from arpd.model.quantities import printable

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

Location: TypeAlias = tuple[str | int, ...]  # ("topics", 2, "min_rate_hz")
Place: TypeAlias = tuple[int, int]  # line and column, both counted from 1
START: Place = (1, 1)
_MAX_BYTES = 2**19  # a thousand topics with every key have 250 kB
_MINIMAL = "a minimal one is `link: {interface: auto}`"


class Fault(NamedTuple):
    """One thing wrong with the file: its place, the dotted key, and ``what is wrong; what would be right``."""

    place: Place
    key: str
    text: str


class YamlSource:
    """A configuration file, read but not yet checked.

    Parameters
    ----------
    minimal : suggestion for an empty file

    Attributes
    ----------
    data : plain mappings, lists and texts; None where there is no value
    keys, values : place of each key and of each value

    Raises
    ------
    ConfigError
        If the file cannot be read, is not one YAML mapping, repeats a key, or has anchors, aliases or tags.
    """

    def __init__(self, path: Path, *, minimal: str = _MINIMAL) -> None:
        self._path, self._minimal = path, minimal
        self.keys: dict[Location, Place] = {}
        self.values: dict[Location, Place] = {}
        self.data: dict[str, Any] = self._plain(self._root(self._text()), ())

    def fault(self, location: Location, text: str) -> Fault:
        """Return a fault of the value there, at the place of the nearest value around it where there is none."""
        found = (self.values.get(location[:length]) for length in range(len(location), 0, -1))
        return Fault(next((place for place in found if place), START), dotted(location), text)

    def error(self, faults: Iterable[Fault]) -> ConfigError:
        """Return the error of these faults."""
        return config_error(self._path, faults)

    def _refusal(self, key: str, text: str, place: Place = START) -> ConfigError:
        return self.error([Fault(place, key, text)])

    def _text(self) -> str:
        try:
            return read_bounded(self._path).decode("utf-8-sig", "surrogateescape")
        except ValueError as error:
            raise self._refusal("file", str(error)) from None

    def _root(self, text: str) -> yaml.MappingNode:
        loader = None
        try:
            loader = _Loader(text)
            node = loader.get_single_node()
        except yaml.reader.ReaderError as error:
            place = text.count("\n", 0, error.position) + 1, error.position - text.rfind("\n", 0, error.position)
            wrong = "a character here is not allowed, or is not UTF-8; remove it, or save the file as UTF-8"
            raise self._refusal("yaml", wrong, place) from None
        except yaml.MarkedYAMLError as error:
            wrong = printable(", ".join(filter(None, (error.context, error.problem))), longest=200)
            place = _place(error.problem_mark or error.context_mark)
            usual = "indent with spaces, not with tabs" if r"'\t'" in wrong else "correct the YAML here"
            raise self._refusal("yaml", f"{wrong}; {error.note or usual}", place) from None
        except (ValueError, OverflowError, RecursionError):
            # PyYAML converts some numbers unchecked: "\UFFFFFFFF", %YAML 1.<5,000 digits>.
            wrong = "is nested too deeply, or holds a number out of range; correct the YAML here"
            raise self._refusal("yaml", wrong, _place(loader and loader.get_mark())) from None
        if node is None or node.value == "":
            raise self._refusal("file", f"is empty; {self._minimal}")
        if not isinstance(node, yaml.MappingNode):
            raise self._refusal("file", f"is not a mapping of keys; {self._minimal}", _place(node.start_mark))
        return node

    def _plain(self, node: Any, location: Location) -> Any:
        """Return what a node holds, and note the places in it."""
        self.values[location] = _place(node.start_mark)
        if isinstance(node, yaml.ScalarNode):
            return None if node.style is None and node.value in {"", "~", "null"} else node.value
        if isinstance(node, yaml.SequenceNode):
            return [self._plain(item, (*location, index)) for index, item in enumerate(node.value)]
        data: dict[str, Any] = {}
        for key, value in node.value:
            place, inner = _place(key.start_mark), (*location, key.value)
            if not isinstance(key, yaml.ScalarNode):
                raise self._refusal("yaml", "a key cannot be a list or a mapping; write a name", place)
            if key.value in data:
                wrong = f"is already given on line {self.keys[inner][0]}; keep one of the two"
                raise self._refusal(dotted(inner), wrong, place)
            self.keys[inner] = place
            data[key.value] = self._plain(value, inner)
        return data


def read_bounded(path: Path) -> bytes:
    """Return what a file holds, or raise ValueError with ``what is wrong; what would be right``."""
    try:
        # O_NONBLOCK, because to open a FIFO without a writer would never return.
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
            os.set_blocking(file.fileno(), True)
            raw = file.read(_MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        why = getattr(error, "strerror", None) or error
        raise ValueError(f"cannot be read ({why}); create it, change its mode, or name another") from None
    if len(raw) > _MAX_BYTES:
        raise ValueError(f"is larger than {_MAX_BYTES // 1024} KiB; shorten it or name another file")
    return raw


class _Loader(yaml.SafeLoader):
    """Composes nodes; refuses aliases, which expand, and tags, which run code."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent) or event.anchor or event.tag:
            wrong, way_out = "anchors, aliases and tags are not allowed", "write the value out"
            raise yaml.MarkedYAMLError(problem=wrong, problem_mark=event.start_mark, note=way_out)
        return super().compose_node(parent, index)


def _place(mark: Any) -> Place:
    return (mark.line + 1, mark.column + 1) if mark else START


def config_error(path: Path, faults: Iterable[Fault]) -> ConfigError:
    """Return an error with one line for each fault, in the order of the file."""
    file = printable(str(path), longest=4096)
    return ConfigError([f"{file}:{line}:{column}: {key}: {text}" for (line, column), key, text in sorted(faults)])


def dotted(location: Location) -> str:
    """Return a location as people write it: ``topics[2].min_rate_hz``."""
    path = "".join(f"[{step}]" if isinstance(step, int) else f".{_key(step)}" for step in location)
    return path.removeprefix(".")


def _key(name: str) -> str:
    """Return a key, quoted if it is empty or has spaces or dots in it."""
    return printable(name) if re.fullmatch(r"[\w-]+", name) else f"'{printable(name)}'"
