"""States of services, as systemctl tells them."""

from __future__ import annotations

import pytest

from arpd.host.services import ServiceState, ask_systemctl, service_states

SHOWN = """\
ExecMainCode=1
ExecMainStatus=78
Result=exit-code
Id=arpd.service
LoadState=loaded
ActiveState=failed
SubState=failed
StatusText=
UnitFileState=enabled

ExecMainCode=2
ExecMainStatus=9
Result=signal
Id=arpd-peer@robot1.service
LoadState=masked
ActiveState=inactive
SubState=dead
StatusText=no probes; a=b
UnitFileState=
"""


def test_each_unit_has_its_state():
    """An exit code counts only where the process exited; a number of a signal is none."""

    def ask(arguments):
        # Without --all a star stands for none that is inactive.
        assert (arguments[1], arguments[-2:]) == ("--all", ["arpd", "arpd-peer@*"])
        return SHOWN

    states = service_states("arpd", "arpd-peer@*", ask=ask)
    assert states == {
        "arpd": ServiceState(is_installed=True, is_enabled=True, active="failed", result="exit-code", exit_code=78),
        "arpd-peer@robot1": ServiceState(
            is_installed=True,
            is_enabled=False,
            is_masked=True,
            active="inactive",
            result="signal",
            says="no probes; a=b",
        ),
    }


@pytest.mark.parametrize(
    ("told", "is_restarted"),
    [
        ("ActiveState=activating\nSubState=auto-restart\nNRestarts=0", True),
        ("ActiveState=activating\nSubState=start\nNRestarts=3", True),
        ("ActiveState=activating\nSubState=start\nNRestarts=0", False),
        ("ActiveState=active\nSubState=running\nNRestarts=3", False),
    ],
)
def test_a_unit_that_systemd_starts_again_is_no_unit_that_starts(told, is_restarted):
    """One that fails in a loop is caught between two attempts and within one alike."""
    states = service_states("arpd", ask=lambda _arguments: f"Id=arpd.service\n{told}\n")
    assert states["arpd"].is_restarted == is_restarted


@pytest.mark.parametrize("script", [None, "exit 1", "sleep 60"])
def test_without_systemd_there_are_no_units(tmp_path, monkeypatch, script):
    """No systemctl, one that fails and one that hangs tell nothing."""
    if script is not None:
        (tmp_path / "systemctl").write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / "systemctl").chmod(0o755)
        monkeypatch.setattr("arpd.host.services._TIMEOUT_S", 0.2)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin" if script else str(tmp_path))
    assert ask_systemctl(["show"]) == ""
    assert service_states("arpd") == {}
