"""Names of topics, services and actions: those that are not the robot's own, and patterns of names."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

LONGEST_NAME = 247  # RMW_TOPIC_MAX_NAME_LENGTH: DDS's 255 less room for the prefixes of rmw

#: Every node writes them.
ROS_TOPICS = frozenset({"/rosout", "/parameter_events"})
_PATTERN = re.compile(r"(?:/(?:\*\*|(?:[A-Za-z_]|\*(?!\*))(?:[A-Za-z0-9_]|\*(?!\*))*))+")
_LEVEL_ENDS = r"(?=/|\Z)"


def is_internal(topic: str) -> bool:
    """Return whether a topic belongs to ROS or arpd itself, and not to the robot."""
    return topic in ROS_TOPICS or topic.startswith("/arpd/")


def is_hidden(name: str) -> bool:
    """Return whether a level of the name begins with an underscore, which hides it from ROS's tools."""
    return "/_" in name


def is_pattern(text: str) -> bool:
    """Return whether the text is an absolute name, perhaps with `*` in its levels and `**` as whole levels."""
    return _PATTERN.fullmatch(text) is not None


def compile_patterns(patterns: Iterable[str]) -> re.Pattern[str]:
    """Return an expression whose `fullmatch` succeeds for names that one of the patterns matches.

    A `*` stands for any characters of one level. A `**` stands for any number of whole levels: at least one at the end,
    and perhaps none elsewhere. So `/camera/**` matches /camera/left/image, but not /camera; `/**/image` matches both
    /image and /camera/left/image.
    """
    expressions = [_expression(pattern) for pattern in patterns]
    return re.compile("|".join(expressions) if expressions else r"(?!)")


def _expression(pattern: str) -> str:
    """Return the expression of one pattern.

    Each part between two stars takes its first place in the name for good (an atomic group): what follows the second
    star fits there if it fits anywhere, so the search needs no way back and takes no exponential time.
    """
    first, *rest = pattern.split("/**")
    if not rest:
        return _levels(first)
    *middle, last = rest
    before = "".join(f"(?>(?:/[^/]+)*?{_levels(part)}{_LEVEL_ENDS})" for part in middle)
    skipped = "(?:/[^/]+)*" if last else "(?:/[^/]+)+"
    return f"{_levels(first)}{_LEVEL_ENDS}{before}{skipped}{_levels(last)}"


def _levels(part: str) -> str:
    return "".join(f"/{_level(level)}" for level in part.split("/")[1:])


def _level(level: str) -> str:
    first, *rest = level.split("*")
    if not rest:
        return level
    *middle, last = rest
    before = "".join(f"(?>[^/]*?{part})" for part in middle)
    return f"{first}{before}[^/]*{last}{_LEVEL_ENDS}"
