"""Sentence fragments that several readers of the daemon's state share, and how sentences name and count things."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from arpd.model.quantities import format_number

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

MOST_TEXT = 600  # characters
_MOST_NAME = 64
_MOST_NAMED = 3

PACED_ONLY = "rate only"  # of a publisher that refuses new QoS for good


def confirmed(*, confirmed: int, publishers: int, paced_only: int = 0) -> str:
    """Say how many publishers announce the plan, and how many of them refuse new QoS for good."""
    paced = f" ({paced_only} by {PACED_ONLY})" if paced_only else ""
    return f"{confirmed} of {publishers} publishers{paced} confirmed"


def short(name: str) -> str:
    """Return a name; of one that is too long for a sentence, the end, which tells topics apart."""
    return name if len(name) <= _MOST_NAME else f"…{name[1 - _MOST_NAME :]}"


def count(number: int, one: str) -> str:
    """Write a number of things: `1 topic`, `3 topics`."""
    return f"{number} {one}{'' if number == 1 else 's'}"


def listed(names: Sequence[str], most: int = _MOST_NAMED) -> str:
    """Name at most so many, and count the rest: `/a, /b, /c and 9 more`."""
    named = [short(name) for name in names[:most]]
    if (more := len(names) - len(named)) > 0:
        return f"{', '.join(named)} and {more} more"
    return joined(named)


def joined(names: Sequence[str]) -> str:
    """Write `/a, /b and /c`."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


class Change(NamedTuple):
    """A change of a topic's rate, depth or deadline; ``weight`` orders changes, the weightiest first."""

    name: str
    before: float
    after: float
    weight: float = 0.0


def changes(all_of_them: Iterable[Change], unit: str = "", *, show: Callable[[float], str] = format_number) -> str:
    """Write changes, equal ones together: `/image 30 → 2.1 Hz, /front and /rear 20 → 12 Hz`; empty without any.

    It names at most three topics and counts the others.
    """
    alike: dict[str, list[str]] = {}
    for change in sorted(all_of_them, key=lambda change: (-change.weight, change.name)):
        before, after = show(change.before), show(change.after)
        if before != after:
            alike.setdefault(f"{before} → {after}{unit}", []).append(change.name)
    parts: list[str] = []
    room, left = _MOST_NAMED, 0
    for words, names in alike.items():
        if room:
            parts.append(f"{listed(names, room)} {words}")
            room -= min(room, len(names))
        else:
            left += len(names)
    return ", ".join([*parts, f"{count(left, 'more topic')} changed"] if left else parts)
