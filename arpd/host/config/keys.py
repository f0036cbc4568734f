"""The keys of arpd.yaml, as `Settings` declares them."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

from arpd.model.kinds import Kind
from arpd.model.settings import Section, Settings, key_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from arpd.model.kinds import Written

_RESTART_ONLY = ("link.interface", "http.", "relay.")
_ABSENT = "absent"


class Key(NamedTuple):
    """Attribute of a key, and the `Kind` of its value, or the section under it."""

    attribute: str
    kind: Any


_KEYS: dict[type[Section], dict[str, Key]] = {}


def keys_of(section: type[Section]) -> dict[str, Key]:
    """Return the keys of a section."""
    if section not in _KEYS:
        hints = get_type_hints(section, include_extras=True)
        names = [each.name for each in fields(section) if each.init]  # type: ignore[arg-type]
        _KEYS[section] = {key_of(name): Key(name, _kind(hints[name])) for name in names}
    return _KEYS[section]


def _kind(hint: Any) -> Any:
    if get_origin(hint) is Annotated:
        return hint.__metadata__[0]
    return get_args(hint)[0] if get_args(hint) else hint


def _sections(section: type[Section], path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], dict[str, Key]]]:
    yield path, keys_of(section)
    for name, key in keys_of(section).items():
        if not isinstance(key.kind, Kind):
            yield from _sections(key.kind, (*path, name))


# The keys of every section by its location, without list positions.
SECTIONS = dict(_sections(Settings))


def flatten(settings: Settings) -> dict[str, Written]:
    """Return every key with its value as the file writes it: ``{"link.capacity": "20mbit", …}``."""
    return dict(_rows(settings, ""))


def _rows(section: Section, path: str) -> Iterator[tuple[str, Written]]:
    for key, (attribute, kind) in keys_of(type(section)).items():
        value = getattr(section, attribute)
        if isinstance(value, Section):
            yield from _rows(value, f"{path}{key}.")
        elif not isinstance(kind, Kind):
            for item in value:
                yield from _rows(item, f"{path}{key}[{item.name}].")
        elif key != "name" and (value is not None or kind.word):
            yield f"{path}{key}", kind.write(value)


def spelled(value: Written) -> str:
    """Return a value on one line, as the file has it: ``[/scan, /camera/**]``."""
    return f"[{', '.join(value)}]" if isinstance(value, list) else str(value)


def changes(old: Settings, new: Settings) -> dict[str, str]:
    """Return ``old -> new`` for each key that differs."""
    before, after = flatten(old), flatten(new)
    return {
        key: f"{spelled(before.get(key, _ABSENT))} -> {spelled(after.get(key, _ABSENT))}"
        for key in before | after
        if before.get(key) != after.get(key)
    }


def needs_restart(key: str) -> bool:
    """Return whether a change of the dotted key takes effect only after a restart."""
    return key.startswith(_RESTART_ONLY)
