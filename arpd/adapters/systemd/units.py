"""States of arpd's units, as systemd tells them."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

from arpd.report.health import Unknown
from arpd.report.health_host import Unit

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

NAMES = ("arpd.service", "arpd-relay.service", "arpd-peer.service", "arpd-relay-far.service")
_BOOTED = Path("/run/systemd/system")  # sd_booted(3)
_TIMEOUT_S = 10.0


def _ask() -> str:
    command = ["systemctl", "show", "--property=Id,LoadState,ActiveState,UnitFileState", *NAMES]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=_TIMEOUT_S).stdout  # noqa: S603 - constants


def read_units(*, ask: Callable[[], str] = _ask, booted: Path = _BOOTED) -> list[Unit] | Unknown:
    """Return the units that are installed here.

    Parameters
    ----------
    ask : returns the answer of ``systemctl show``: a line ``key=value`` each, an empty line between units
    booted : folder that exists where systemd runs
    """
    if not booted.exists():
        return Unknown("systemd does not run here")
    try:
        answer = ask()
    except (OSError, subprocess.SubprocessError) as error:
        return Unknown(f"systemctl does not answer ({error})")
    return list(_units(answer))


def _units(answer: str) -> Iterator[Unit]:
    for part in answer.split("\n\n"):
        values = dict(line.partition("=")[::2] for line in part.splitlines())
        if values.get("LoadState") == "loaded":
            yield Unit(
                name=values.get("Id", "").removesuffix(".service"),
                active=values.get("ActiveState", ""),
                is_enabled=values.get("UnitFileState", "").startswith("enabled"),
            )
