"""The next step when no daemon answers here."""

from __future__ import annotations

import pytest

from arpd.cli.no_daemon import next_step
from arpd.host.services import ServiceState


def unit(active, **fields):
    return ServiceState(**{"is_installed": True, "is_enabled": True, "active": active, **fields})


@pytest.mark.parametrize(
    ("robot", "other_end", "words"),
    [
        (unit("active", sub="running"), "inactive", "http.port"),
        (unit("reloading", sub="reload"), "inactive", "http.port"),
        (unit("activating", sub="start"), "inactive", "ask again"),
        (unit("activating", sub="auto-restart", exit_code=1), "inactive", "exit code 1"),
        (unit("activating", sub="auto-restart", exit_code=69), "inactive", "ROS cannot be used"),
        (unit("failed", exit_code=78, result="exit-code"), "inactive", "arpd check"),
        (unit("failed", result="watchdog"), "inactive", "watchdog"),
        (unit("inactive"), "inactive", "systemctl start arpd"),
        (unit("inactive", is_enabled=False), "inactive", "systemctl enable --now arpd"),
        (unit("inactive", is_enabled=False), "active", "on the robot"),
        (unit("inactive", is_installed=False), "inactive", "arpd run --config"),
    ],
)
def test_the_units_tell_the_next_step(robot, other_end, words):
    """Each state of the units has one sentence with what to do."""
    assert words in next_step({"arpd": robot, "arpd-peer": unit(other_end)})
