"""Warns of a valid configuration that costs this host more than it needs, or asks more of the link than it has."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.model.quantities import format_rate
from arpd.model.settings import Backend
from arpd.solve.topics import Traffic, rows_of_traffic

if TYPE_CHECKING:
    from collections.abc import Iterator

    from arpd.model.settings import Settings

#: Memory that a back end adds to `arpd run`, which has numpy anyway (x86-64, Python 3.11, 12 topics).
EXTRA_BYTES = {Backend.CLOSED_FORM: 0, Backend.OSQP: 14 * 2**20, Backend.CVXPY: 82 * 2**20}
_WORTH_A_WARNING = 0.01  # of the host's memory: OSQP below 1.4 GiB, cvxpy below 8 GiB


def warnings(settings: Settings, *, host_bytes: int) -> Iterator[str]:
    """Yield one line per warning, ``KEY: warning: what is costly; what is cheaper``.

    Parameters
    ----------
    settings : of the robot computer
    host_bytes : memory of the robot computer, 0 = unknown
    """
    backend = settings.program.backend
    extra_bytes = EXTRA_BYTES[backend]
    if host_bytes and extra_bytes > _WORTH_A_WARNING * host_bytes:
        yield (
            f"program.backend: warning: {backend} takes {extra_bytes / 2**20:.0f} MiB, "
            f"{100 * extra_bytes / host_bytes:.1f} % of this host's memory; {Backend.CLOSED_FORM} takes none, "
            "and gives the same rates to a millionth"
        )
    known = [
        Traffic(topic=topic.name, payload_bytes=topic.payload_bytes, source_rate_hz=topic.source_rate_hz or 0.0)
        for topic in settings.topics
        if topic.payload_bytes is not None
    ]
    floors = sum(row.wire_bytes * row.min_rate_hz for row in rows_of_traffic(known, settings))
    link = settings.link
    key = "initial_capacity" if link.capacity_bytes_per_second is None else "capacity"
    usable = link.headroom * (link.capacity_bytes_per_second or link.initial_capacity_bytes_per_second)
    if floors > usable:
        yield (
            f"topics: warning: all min_rate_hz together need {format_rate(floors)} with headers, and link.{key} and "
            f"link.headroom leave {format_rate(usable)}; the lightest weights fall below theirs, so lower some"
        )
