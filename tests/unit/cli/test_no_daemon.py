"""The next step when no daemon answers here."""

from __future__ import annotations

import pytest

from arpd.adapters.systemd.services import ServiceState
from arpd.cli.no_daemon import is_here, next_step


def unit(active, **fields):
    return ServiceState(**{"is_installed": True, "is_enabled": True, "active": active, **fields})


@pytest.mark.parametrize(
    ("robot", "other_end", "words"),
    [
        (unit("active", sub="running"), "inactive", "http.port"),
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


def test_without_systemd_there_is_nothing_to_tell():
    """No units, no sentence."""
    assert not next_step({})


@pytest.mark.parametrize(
    ("url", "here"),
    [
        ("http://127.0.0.1:9464", True),
        ("http://[::1]:9464", True),
        ("https://localhost", True),
        ("http://robot.local:9464", False),
        ("http://[::1", False),
    ],
)
def test_only_this_computers_units_count(url, here):
    """The address tells whether the daemon should run here."""
    assert is_here(url) is here
