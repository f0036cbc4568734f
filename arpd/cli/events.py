"""Lines of the decision log, with the local time of whoever reads them."""

from __future__ import annotations

import time
from typing import Any

from arpd.cli.columns import cut
from arpd.cli.document import number, rows, text

_DAY_S = 86_400.0


def last_events(status: dict[str, Any], most: int, *, width: int) -> list[str]:
    """Return the last events, oldest first, none wider than ``width``; those of another day with their date."""
    events = rows(status, "events")
    now_s = number(status, "unix_time_seconds")
    return [cut(f"{clock(event, now_s)}  {text(event, 'text')}", width) for event in events[-most:]] if most > 0 else []


def clock(event: dict[str, Any], now_s: float | None = None) -> str:
    """Return when an event happened, by the clock on this wall."""
    at_s = number(event, "unix_time_seconds")
    is_recent = at_s is not None and (now_s is None or abs(now_s - at_s) < _DAY_S)
    return wall_clock(at_s, "%H:%M:%S" if is_recent else "%b %d %H:%M")


def wall_clock(unix_time_s: float | None, pattern: str = "%H:%M:%S") -> str:
    """Return a Unix time as local time; what no calendar has is question marks."""
    try:
        return "??:??:??" if unix_time_s is None else time.strftime(pattern, time.localtime(unix_time_s))
    except (OverflowError, ValueError, OSError):
        return "??:??:??"
