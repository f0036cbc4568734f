"""The next step when no daemon answers here."""

from __future__ import annotations

import pytest

from arpd.adapters.systemd.services import ServiceState
from arpd.cli.no_daemon import is_here, next_step
from arpd.model.errors import UsageError


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


def test_a_daemon_that_is_late_runs_at_the_right_address():
    """A busy Pi needs no other configuration."""
    step = next_step({"arpd": unit("active", sub="running")}, is_late=True)
    assert "ask again" in step
    assert "http.port" not in step


def test_without_systemd_there_is_nothing_to_tell():
    """No units, no sentence."""
    assert not next_step({})


@pytest.mark.parametrize(
    ("url", "here"),
    [
        ("http://127.0.0.1:9464", True),
        ("http://[::1]:9464", True),
        ("https://localhost", True),
        ("http://192.0.2.7:9464", True),
        ("http://robot.local:9464", False),
        ("robot", False),
    ],
)
def test_only_this_computers_units_count(url, here):
    """The address tells whether the daemon should run here."""
    assert is_here(url, is_own_address=lambda host: host in {"127.0.0.1", "192.0.2.7"}) is here


def test_the_kernel_knows_the_own_addresses():
    """All of 127.0.0.0/8 are this computer's; 192.0.2.0/24 is nobody's."""
    assert is_here("http://127.0.1.1:9464")
    assert not is_here("http://192.0.2.77:9464")


def test_what_is_no_url_is_wrong_usage():
    """And no traceback."""
    with pytest.raises(UsageError, match="not an HTTP address"):
        is_here("http://[::1")
