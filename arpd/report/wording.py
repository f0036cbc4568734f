"""Words and numbers of the decision log: short, in one line, and bounded whatever the names are."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from arpd.model.quantities import format_duration, format_rate

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from arpd.report.events import EventKind, Severity

MOST_TEXT = 600  # characters
_MOST_NAME = 64
_MOST_NAMED = 3


class Said(NamedTuple):
    """An event before it has its number and its time."""

    kind: EventKind
    severity: Severity
    text: str
    topic: str = ""
    node: str = ""
    details: Mapping[str, str] = {}


def one_line(text: str, most: int = MOST_TEXT) -> str:
    """Return a text without anything that is not printable, and no longer than ``most`` characters."""
    line = "".join(char if char.isprintable() else "?" for char in " ".join(text.split()))
    return line if len(line) <= most else f"{line[: most - 1]}…"


def short(name: str) -> str:
    """Return a name, or the end of one that is too long for a sentence."""
    return name if len(name) <= _MOST_NAME else f"…{name[1 - _MOST_NAME :]}"


def digits(value: float) -> str:
    """Write a number in three significant digits, without exponent and without zeros that say nothing."""
    if not math.isfinite(value):
        return "unlimited" if value > 0 else "unknown"
    if value == 0:
        return "0"
    decimals = 2 - math.floor(math.log10(abs(value)))
    rounded = round(value, decimals)
    if decimals <= 0:
        return str(int(rounded))
    return f"{rounded:.{min(decimals, 9)}f}".rstrip("0").rstrip(".")


def rate(bytes_per_second: float) -> str:
    """Write a rate: `4.8 Mbit/s`."""
    return _bare(format_rate(bytes_per_second))


def duration(seconds: float) -> str:
    """Write a duration: `4.4 s`; less than a millisecond is none."""
    return _bare(format_duration(seconds)) if seconds >= 0.001 else "0 s"


def deadline(nanoseconds: int) -> str:
    """Write a deadline (ns, 0 = none)."""
    return f"deadline {duration(nanoseconds / 1e9)}" if nanoseconds else "no deadline"


def count(number: int, one: str, many: str = "") -> str:
    """Write a number of things: `1 topic`, `3 topics`."""
    return f"{number} {one if number == 1 else many or one + 's'}"


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
    """How a quantity of a topic changes; ``weight`` orders changes, the weightiest first."""

    name: str
    before: float
    after: float
    weight: float = 0.0


def changes(all_of_them: Iterable[Change], write: Callable[[float], str], unit: str) -> str:
    """Write what changes, topics that change alike together: `/image 30 → 2.1 Hz, /front and /rear 20 → 12 Hz`.

    At most three topics are named, and the others are counted. Empty when nothing changes.
    """
    alike: dict[str, list[str]] = {}
    for change in sorted(all_of_them, key=lambda change: (-change.weight, change.name)):
        before, after = write(change.before), write(change.after)
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


def _bare(text: str) -> str:
    """Drop the zeros at the end of a number that say nothing."""
    number, space, unit = text.partition(" ")
    return f"{number.rstrip('0').rstrip('.') if '.' in number else number}{space}{unit}"


_SPAN_S = 60.0


class Quota:
    """So many in any minute, and a count of what was over it; until that is told, nothing more passes.

    Parameters
    ----------
    most : that pass in a minute
    """

    def __init__(self, most: int) -> None:
        self._passed_s: deque[float] = deque(maxlen=most)
        self._untold_since_s = 0.0
        self.untold = 0

    def take(self, now_s: float) -> bool:
        """Whether one more may pass now; if not, it is counted."""
        if self.untold or self._is_full(now_s):
            if not self.untold:
                self._untold_since_s = now_s
            self.untold += 1
            return False
        self._passed_s.append(now_s)
        return True

    def settle(self, now_s: float) -> int:
        """Return how many did not pass, once there is room to say so: a minute of them is told as one."""
        if not self.untold or now_s - self._untold_since_s < _SPAN_S or self._is_full(now_s):
            return 0
        self._passed_s.append(now_s)
        untold, self.untold = self.untold, 0
        return untold

    def _is_full(self, now_s: float) -> bool:
        passed = self._passed_s
        return len(passed) == passed.maxlen and now_s - passed[0] < _SPAN_S


@dataclass(frozen=True, kw_only=True, slots=True)
class Turn:
    """A condition that began or ended and is to be told.

    Parameters
    ----------
    holds : whether it holds now
    lasted_s : how long the other state lasted (s)
    untold : how often it began since without being told, this turn left out
    """

    holds: bool
    lasted_s: float = 0.0
    untold: int = 0


class Episode:
    """A condition that begins and ends, told both times; a beginning beyond the quota, and its end, are only counted.

    What was told last is never left standing when it is no longer so: the count tells the state along with it.

    Parameters
    ----------
    hold_s : how long a change must last to be one (s)
    most : beginnings that are told in a minute

    Attributes
    ----------
    holds : whether the condition holds, by what it was told
    """

    def __init__(self, *, hold_s: float = 0.0, most: int = 3) -> None:
        self._hold_s = hold_s
        self._quota = Quota(most)
        self.holds = False
        self._told = False
        self._since_s: float | None = None  # of the present state
        self._differs_since_s: float | None = None

    def look(self, now_s: float, *, holds: bool) -> Turn | None:
        """Take in whether the condition holds now, and return what is to be told, if anything."""
        if holds == self.holds:
            self._differs_since_s = None
            return self._count(now_s)
        if self._differs_since_s is None:
            self._differs_since_s = now_s
        if now_s - self._differs_since_s < self._hold_s:
            return self._count(now_s)
        began_s, self._differs_since_s = self._differs_since_s, None
        lasted_s = began_s - self._since_s if self._since_s is not None else 0.0
        self.holds, self._since_s = holds, began_s
        if holds:
            self._told = self._quota.take(now_s)
        return Turn(holds=holds, lasted_s=lasted_s) if self._told else None

    def _count(self, now_s: float) -> Turn | None:
        if not (untold := self._quota.settle(now_s)):
            return None
        self._told = self.holds
        return Turn(holds=self.holds, untold=untold)
