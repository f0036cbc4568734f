"""What to tell people whose daemon does not answer: the next step, from the state of arpd's units."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.cli.options import read_address
from arpd.host import services
from arpd.report.wording import listed

if TYPE_CHECKING:
    from arpd.host.services import ServiceState
    from arpd.model.errors import NoAnswerError

_ROBOT = "arpd"
_RUNS = {"active", "reloading"}
_JOURNAL = "see journalctl -u {0}"
_CAUSES = {
    2: "its command line is wrong: see systemctl cat {0}",
    69: f"ROS cannot be used: {_JOURNAL}",
    # As its user: root may read what the unit may not.
    78: f"its configuration is wrong: {_JOURNAL}; sudo -u arpd arpd check names every fault of its file",
}


def step_after(error: NoAnswerError) -> str:
    """Say what to do where nobody answers at an address of this computer, from its units; empty elsewhere."""
    units = services.service_states(*services.OF_ARPD) if read_address(error.url).is_here else {}
    if (robot := units.get(_ROBOT)) is None:
        return ""
    if why := failure(_ROBOT, robot):
        return why
    if robot.active in {"inactive", "deactivating", ""}:
        return _of_stopped(robot, services.used_on_base(units))
    journal = _JOURNAL.format(_ROBOT)
    if error.is_late:
        return f"arpd.service listens, and is too busy to answer or hangs; ask again, or {journal}"
    if robot.active in _RUNS:
        return f"arpd.service runs, but not at this address: compare http.host and http.port of its file; {journal}"
    return "arpd.service is starting; ask again in some seconds, or follow it: journalctl -fu arpd"


def _of_stopped(robot: ServiceState, used_on_base: list[str]) -> str:
    if robot.active == "deactivating":
        return "arpd.service is stopping, and first restores the publishers (on_stop); ask again in some seconds"
    if used_on_base:
        return f"this is the other end of the link, with {listed(used_on_base, most=4)}: run arpd status on the robot"
    if not robot.is_installed:
        return "there is no arpd.service here: install arpd, or start it by hand: arpd run --config FILE"
    if robot.is_masked:
        return "arpd.service is masked: sudo systemctl unmask arpd && sudo systemctl enable --now arpd"
    return f"arpd.service is not started: sudo systemctl {'start' if robot.is_enabled else 'enable --now'} arpd"


def failure(name: str, unit: ServiceState) -> str:
    """Say why a unit failed, fails again and again, or cannot listen, and what to do; empty where all is well."""
    if unit.active in _RUNS and (at := unit.says.find(services.NO_METRICS)) >= 0:
        return f"{name} has {unit.says[at:]}"
    if unit.active != "failed" and not unit.is_restarted:
        return ""
    # Its next attempt, which is under way, has no reason yet.
    reason = f"exit code {unit.exit_code}" if unit.exit_code else unit.result.removeprefix("success")
    cause = _CAUSES.get(unit.exit_code or 0, f"{reason}: {_JOURNAL}" if reason else _JOURNAL).format(name)
    return f"{name} failed, {cause}{'; systemd starts it again' if unit.is_restarted else ''}"
