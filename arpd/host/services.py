"""Asks systemd for the state of services, arpd's among them."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

#: arpd's own; a base computer of several robots has a peer and a far end of each robot's name.
OF_ARPD = ("arpd", "arpd-relay", "arpd-relay-far", "arpd-relay-far@*", "arpd-peer", "arpd-peer@*")
_OF_BASE = {"arpd-relay-far", "arpd-peer"}
NO_METRICS = "no metrics: "  # before the reason, in what arpd says of itself where nobody can ask it
_TIMEOUT_S = 2.0
_PROPERTIES = "Id,LoadState,ActiveState,SubState,UnitFileState,StatusText,NRestarts,Result,ExecMainCode,ExecMainStatus"


@dataclass(frozen=True, kw_only=True, slots=True)
class ServiceState:
    """State of one service (systemctl(1), org.freedesktop.systemd1(5)).

    Parameters
    ----------
    is_installed : whether there is a unit file
    is_enabled : whether it starts at boot
    is_masked : whether systemd may not start it
    active : ``active``, ``activating``, ``inactive``, ``failed`` …
    result : reason of the last end, ``success`` where nothing went wrong
    exit_code : exit code of the last main process, None where a signal ended it or none has ended
    is_restarted : whether systemd starts it again by itself, or waits to do so
    says : what the service said of itself last; systemd keeps it when the service has ended
    """

    is_installed: bool
    is_enabled: bool
    active: str
    is_masked: bool = False
    result: str = ""
    exit_code: int | None = None
    is_restarted: bool = False
    says: str = ""

    @property
    def is_used(self) -> bool:
        """Whether it starts at boot, or somebody started it."""
        return self.is_enabled or self.active != "inactive"


def ask_systemctl(arguments: Sequence[str]) -> str:
    """Return what systemctl prints, empty where there is no systemd or it does not answer."""
    try:
        done = subprocess.run(  # noqa: S603 - fixed arguments
            ["systemctl", *arguments],  # noqa: S607 - distributions have it in different folders
            capture_output=True,
            text=True,
            check=False,
            timeout=_TIMEOUT_S,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout if done.returncode == 0 else ""


def service_states(*names: str, ask: Callable[[Sequence[str]], str] = ask_systemctl) -> dict[str, ServiceState]:
    """Return the states of services by name, without ``.service``; empty where systemd does not tell.

    A name with a star stands for all such services that run, failed or are enabled.
    """
    found = {}
    for block in ask(["show", "--all", f"--property={_PROPERTIES}", *names]).split("\n\n"):
        properties = dict(line.split("=", 1) for line in block.splitlines() if "=" in line)
        if name := properties.get("Id", "").removesuffix(".service"):
            found[name] = _state_of(properties)
    return found


def used_on_base(units: Mapping[str, ServiceState]) -> list[str]:
    """Return arpd's services in use if all are those of a base computer; empty elsewhere."""
    used = sorted(name for name, unit in units.items() if unit.is_used)
    return used if {name.partition("@")[0] for name in used} <= _OF_BASE else []


def _state_of(properties: dict[str, str]) -> ServiceState:
    code = properties.get("ExecMainStatus", "")
    has_exited = properties.get("ExecMainCode") == "1"  # CLD_EXITED
    # A manual start resets the count. systemd 254 and newer also have the state auto-restart-queued.
    is_again = properties.get("SubState", "").startswith("auto-restart") or properties.get("NRestarts", "0") != "0"
    return ServiceState(
        is_installed=properties.get("LoadState") not in {None, "not-found"},
        is_enabled=properties.get("UnitFileState") == "enabled",
        active=properties.get("ActiveState", ""),
        is_masked=properties.get("LoadState") == "masked",
        result=properties.get("Result", ""),
        exit_code=int(code) if has_exited and code.isdecimal() else None,
        is_restarted=is_again and properties.get("ActiveState") == "activating",
        says=properties.get("StatusText", ""),
    )
