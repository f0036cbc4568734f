"""The difference of two JSON documents as a JSON Patch (RFC 6902)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator


def patch_between(old: Any, new: Any) -> list[dict[str, Any]]:
    """Return the operations that make the new document from the old one.

    Values change each at the deepest place. A list whose first elements went and that has further ones, as a log has,
    is shifted. An object with other keys, or a list with another length, is replaced whole.

    Parameters
    ----------
    old, new : JSON documents
    """
    return list(_changes(old, new, ""))


def _changes(old: Any, new: Any, path: str) -> Iterator[dict[str, Any]]:
    if isinstance(old, dict) and isinstance(new, dict) and old.keys() == new.keys():
        for key, value in new.items():
            yield from _changes(old[key], value, f"{path}/{key.replace('~', '~0').replace('/', '~1')}")
    elif isinstance(old, list) and isinstance(new, list):
        yield from _list_changes(old, new, path)
    elif old != new or isinstance(old, bool) is not isinstance(new, bool):
        yield {"op": "replace", "path": path, "value": new}


def _list_changes(old: list[Any], new: list[Any], path: str) -> Iterator[dict[str, Any]]:
    gone = next((n for n in range(len(old)) if new and old[n] == new[0] and old[n:] == new[: len(old) - n]), None)
    if gone is None and len(old) == len(new):
        for index, (before, after) in enumerate(zip(old, new, strict=True)):
            yield from _changes(before, after, f"{path}/{index}")
    elif gone is None:
        yield {"op": "replace", "path": path, "value": new}
    else:
        yield from ({"op": "remove", "path": f"{path}/0"} for _ in range(gone))
        yield from ({"op": "add", "path": f"{path}/-", "value": value} for value in new[len(old) - gone :])
