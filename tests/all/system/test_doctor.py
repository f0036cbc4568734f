"""`arpd doctor` on a machine with systemd: what the units of arpd do there."""

from __future__ import annotations

import json
import os

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("pyroute2", reason="pyroute2 is not installed: pip install pyroute2")

from scripts.netns import simlink
from scripts.netns.namespaces import NETNS_DIR
from tests.all.system import machine
from tests.all.system.test_boot import installed_files

pytestmark = [pytest.mark.link, pytest.mark.ros]


@pytest.fixture(scope="module")
def computer():
    for can, why in (simlink.available(), machine.available()):
        if not can:
            pytest.skip(why)
    with (
        simlink.SimLink(f"doctor-boot-{os.getpid()}") as link,
        machine.booted(
            f"arpd-{os.getpid()}-doctor",
            network=NETNS_DIR / link.robot.namespace,
            files=installed_files(link.domain_id),
        ) as booted,
    ):
        yield booted


def doctor(computer):
    """Return which end the doctor takes the computer for, and what it says of the units."""
    told = json.loads(computer.call("/usr/lib/arpd/env/bin/arpd", "doctor", "--json", "--listen", "0").stdout)
    return told["end"], [(each["health"], each["text"]) for each in told["checks"] if each["check"] == "units"]


def test_units_are_told_as_systemd_has_them(computer):
    """Installed, running, stopped, and failed; a computer on which only the peer runs is the base computer."""
    assert doctor(computer) == ("robot", [("fine", "no unit of arpd is enabled")])
    assert computer.call("systemctl", "enable", "--now", "arpd-peer").returncode == 0
    assert doctor(computer) == ("base", [("fine", "arpd-peer is active")])
    computer.call("systemctl", "stop", "arpd-peer")
    assert doctor(computer) == ("base", [("wrong", "arpd-peer is enabled, and does not run")])
    computer.call("systemctl", "disable", "arpd-peer")
    broken = "link: {headrom: 1}\n"
    (computer.root / "etc/arpd/arpd.yaml").write_text(broken)
    computer.call("systemctl", "start", "arpd")
    end, units = doctor(computer)
    assert (end, units[0]) == ("robot", ("wrong", "arpd has failed"))
