"""The units of a base computer that serves three robots, one of which is never there."""

import pytest

from tests.all.system.computers import VERSIONS
from tests.waiting import eventually

pytestmark = [pytest.mark.link, pytest.mark.ros, pytest.mark.timeout(900)]  # the first one builds a package

ROBOTS = ("robot1", "robot2", "robot3")
UNITS = [f"{part}@{robot}" for robot in ROBOTS for part in ("arpd-peer", "arpd-relay-far")]


def config_of(robot):
    return f"/etc/arpd/{robot}/arpd.yaml"


@pytest.fixture
def base(computers):
    """Let the robot's computer be the base computer of three robots."""
    if computers.status():
        computers.remove("purge")
    computers.install("first")
    for number, robot in enumerate(ROBOTS, start=1):
        addresses = f"link_domain: 7{number}, robot: 10.77.0.10{number}, base: 10.77.0.1"
        # Only the robot has the file that its `http` names.
        settings = f"relay: {{{addresses}, namespace: /{robot}}}\nhttp: {{web_config: web-config.yaml}}\n"
        computers.robot.write(config_of(robot), settings)
    enabled = computers.robot.call("systemctl", "enable", "--now", *UNITS)
    assert enabled.returncode == 0, enabled.stderr
    return computers


def processes(base):
    return {unit: base.robot.show(unit, "MainPID")["MainPID"] for unit in UNITS}


def test_each_robot_stands_for_itself(base):
    """Doctor, upgrade and reboot treat each robot's units by its own file, and a purge leaves none of them."""
    computer = base.robot
    silent = "arpd-relay-far@robot2: waiting for the robot's end"
    judged = eventually("the doctor judges each robot", lambda: _judged(computer, silent))
    assert f"{config_of('robot1')}, {config_of('robot2')} and {config_of('robot3')} are valid" in judged
    assert '"end": "base"' in judged
    asked = computer.call("arpd", "status")
    assert (asked.returncode, "the other end of the link, with arpd-peer@robot1" in asked.stderr) == (3, True)

    good = computer.path(config_of("robot2")).read_text()
    computer.write(config_of("robot2"), "relay: {link_domain: 300}\n")
    computer.write("/etc/arpd/left/arpd.yaml", "of: no unit\n")
    computer.call("systemctl", "stop", "arpd-relay-far@robot3")
    before = processes(base)
    told = base.install("second")
    assert f"{config_of('robot2')}:1:22: relay.link_domain" in told
    assert "sudo systemctl restart arpd-peer@robot2 arpd-relay-far@robot2\n" in told
    assert "sudo systemctl start arpd-relay-far@robot3\n" in told
    kept = {unit for unit, process in processes(base).items() if process == before[unit]}
    assert kept == {"arpd-peer@robot2", "arpd-relay-far@robot2", "arpd-relay-far@robot3"}
    assert base.status().endswith(VERSIONS["second"])

    computer.write(config_of("robot2"), good)
    computer.reboot()
    eventually("all run", lambda: "0" not in processes(base).values())

    computer.write("/etc/systemd/system/arpd-peer@robot1.service.d/override.conf", "[Service]\nNice=1\n")
    base.remove("purge")
    assert base.named_arpd() == set()
    assert computer.call("systemctl", "list-units", "--all", "--plain", "--no-legend", "arpd*").stdout == ""


def _judged(computer, words):
    told = computer.call("arpd", "doctor", "--json", "--listen=0").stdout
    return told if words in told else ""
