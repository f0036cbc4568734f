"""The keys of a file: those of arpd.yaml, as `Settings` declares them, and of any other that has sections."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Any, TypeAlias

from pydantic import TypeAdapter

from arpd.model.settings import Settings

if TYPE_CHECKING:
    from collections.abc import Iterator

    from arpd.host.config.yaml_source import Location

Sections: TypeAlias = dict[tuple[str, ...], dict[str, Any]]
Written: TypeAlias = str | float | list[str]  # a value as the file has it
SETTINGS = TypeAdapter(Settings)
SCHEMA = SETTINGS.json_schema()


def sections_of(schema: dict[str, Any]) -> Sections:
    """Return the keys of every section by its location, without positions in lists, each with its JSON schema."""
    return dict(_sections(schema, schema["$defs"], ()))


def _sections(schema: dict[str, Any], definitions: dict[str, Any], path: tuple[str, ...]) -> Iterator[Any]:
    schema = schema.get("items", schema)
    schema = next((each for each in schema.get("anyOf", ()) if "$ref" in each), schema)
    schema = definitions[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema
    if keys := {name: key for name, key in schema.get("properties", {}).items() if not name.startswith("_")}:
        yield path, keys
        for name, key in keys.items():
            yield from _sections(key, definitions, (*path, name))


SECTIONS = sections_of(SCHEMA)


def keys_at(location: Location, sections: Sections) -> dict[str, Any]:
    """Return the keys of the section there; none if there is no section."""
    return sections.get(tuple(step for step in location if isinstance(step, str)), {})


def nearest(location: Location, sections: Sections) -> str:
    """Suggest a key that looks like the wrong one, or list the known keys."""
    wrong, here = str(location[-1]), keys_at(location[:-1], sections)
    if near := difflib.get_close_matches(wrong[:100].lower(), here, n=1):
        return f"did you mean {near[0]}?"
    if elsewhere := [".".join((*path, wrong)) for path, keys in sections.items() if wrong in keys]:
        return f"did you mean {elsewhere[0]}?"
    return f"known here: {', '.join(here)}"


def flatten(settings: Settings) -> dict[str, Written]:
    """Return every key with its value as the file writes it: ``{"link.capacity": "20mbit", …}``."""
    return dict(_rows(SETTINGS.dump_python(settings, mode="json", by_alias=True), "", ()))


def _rows(value: Any, shown: str, path: tuple[str, ...]) -> Iterator[tuple[str, Written]]:
    for key, inner in value.items():
        if (*path, key) not in SECTIONS:
            if inner is not None and key in SECTIONS[path]:
                yield f"{shown}{key}", inner
        elif isinstance(inner, dict):
            yield from _rows(inner, f"{shown}{key}.", (*path, key))
        else:
            for item in inner:
                yield from _rows(item, f"{shown}{key}[{item.pop('name')}].", (*path, key))


def spelled(value: Written) -> str:
    """Return a value on one line, as the file has it: ``[/scan, /camera/**]``."""
    return f"[{', '.join(value)}]" if isinstance(value, list) else str(value)


def changes(old: Settings, new: Settings) -> dict[str, str]:
    """Return ``old -> new`` for each key that differs; what nobody has set is not set."""
    before, after = flatten(old), flatten(new)
    return {
        key: f"{spelled(before.get(key, 'not set'))} -> {spelled(after.get(key, 'not set'))}"
        for key in after | before  # a key that is new stands beside its neighbours
        if before.get(key) != after.get(key)
    }
