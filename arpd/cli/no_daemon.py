"""What to tell people whose daemon does not answer: the next step, from the state of arpd's units."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.cli.options import read_address
from arpd.host import services
from arpd.report.wording import listed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from arpd.host.services import ServiceState
    from arpd.model.errors import NoAnswerError

_ROBOT = "arpd"
_ENDED = {"inactive", "deactivating", ""}
_JOURNAL = "see journalctl -u {0}"
_CAUSES = {
    2: "its command line is wrong: see systemctl cat {0}",
    69: f"ROS cannot be used: {_JOURNAL}",
    78: f"its configuration is wrong: arpd check names every fault, or, what only its user meets, {_JOURNAL}",
}


def step_after(error: NoAnswerError) -> str:
    """Return the next step where nobody answers at an address of this computer; empty elsewhere."""
    if not read_address(error.url).is_here:
        return ""
    return next_step(services.service_states(*services.OF_ARPD), is_late=error.is_late)


def next_step(units: Mapping[str, ServiceState], *, is_late: bool = False) -> str:
    """Say what the units tell about a daemon that does not answer here, and what to do; empty without units.

    Parameters
    ----------
    is_late : whether somebody listens, and has not answered in time
    """
    if (robot := units.get(_ROBOT)) is None:
        return ""
    if robot.active not in _ENDED:
        return _of_running(robot, is_late=is_late)
    if used := services.used_on_base(units):
        return f"this is the other end of the link, with {listed(used, most=4)}: run arpd status on the robot"
    if not robot.is_installed:
        return "there is no arpd.service here: install arpd, or start it by hand: arpd run --config FILE"
    return f"arpd.service is not started: sudo systemctl {'start' if robot.is_enabled else 'enable --now'} arpd"


def _of_running(robot: ServiceState, *, is_late: bool) -> str:
    journal = _JOURNAL.format(_ROBOT)
    if why := failure(_ROBOT, robot):
        return why
    if is_late:
        return f"arpd.service listens, and is too busy to answer or hangs; ask again, or {journal}"
    if robot.active in {"active", "reloading"}:
        return f"arpd.service runs, but not at this address: compare http.host and http.port of its file; {journal}"
    return "arpd.service is starting; ask again in some seconds, or follow it: journalctl -fu arpd"


def failure(name: str, unit: ServiceState) -> str:
    """Say why a unit failed, or fails again and again, and what to do; empty where it does not."""
    is_repeated = unit.sub.startswith("auto-restart")  # systemd 254 and newer have auto-restart-queued, too
    if unit.active != "failed" and not is_repeated:
        return ""
    usual = f"exit code {unit.exit_code}" if unit.exit_code else unit.result or "reason unknown"
    cause = _CAUSES.get(unit.exit_code or 0, f"{usual}: {_JOURNAL}").format(name)
    return f"{name} failed, {cause}{'; systemd starts it again' if is_repeated else ''}"
