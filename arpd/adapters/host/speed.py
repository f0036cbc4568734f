"""What a wired interface is good for."""

from __future__ import annotations

from pathlib import Path

import psutil

_SYS_NET = Path("/sys/class/net")


def read_speed(name: str, *, sys_net: Path = _SYS_NET) -> float | None:
    """Return the nominal rate of an interface, None where there is none or it means nothing (bytes/s).

    Only hardware knows its own: a tunnel reports 10 Mbit/s whatever it runs over, a radio nothing.
    """
    if not (sys_net / name / "device").exists():
        return None
    try:
        stats = psutil.net_if_stats().get(name)
    except OSError:  # it vanished between two of psutil's questions
        return None
    return stats.speed * 1e6 / 8 if stats is not None and stats.speed > 0 else None
