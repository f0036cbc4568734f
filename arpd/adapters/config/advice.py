"""Warns of a valid configuration that costs this host more than it needs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.model.settings import Backend

if TYPE_CHECKING:
    from arpd.model.settings import Settings

#: Memory that a back end adds to `arpd run`, which has numpy anyway (x86-64, Python 3.11, 12 topics).
EXTRA_BYTES = {Backend.CLOSED_FORM: 0, Backend.OSQP: 14 * 2**20, Backend.CVXPY: 82 * 2**20}
_WORTH_A_WARNING = 0.01  # of the host's memory: OSQP below 1.4 GiB, cvxpy below 8 GiB


def warnings(settings: Settings, *, host_bytes: int) -> list[str]:
    """Return one line per warning, ``KEY: warning: what is costly; what is cheaper``.

    Parameters
    ----------
    settings : of the robot computer
    host_bytes : memory of the robot computer, 0 = unknown
    """
    backend = settings.program.backend
    extra_bytes = EXTRA_BYTES[backend]
    if not host_bytes or extra_bytes <= _WORTH_A_WARNING * host_bytes:
        return []
    return [
        (
            f"program.backend: warning: {backend} takes {extra_bytes / 2**20:.0f} MiB, "
            f"{100 * extra_bytes / host_bytes:.1f} % of this host's memory; {Backend.CLOSED_FORM} takes none, "
            "and gives the same rates to a millionth"
        )
    ]
