"""scripts/deb and the package that it builds, on a booted computer."""

import os
import re
import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import pytest

from tests.all.system.computers import BREAK, CONFIG, ENV, NAME, SYSTEM_PYTHON, UNITS, VERSIONS, as_user
from tests.all.system.machine import SOURCE

pytestmark = [pytest.mark.link, pytest.mark.ros, pytest.mark.timeout(900)]  # the first one builds a package

REPO = Path(__file__).parents[3]
ON_THE_ROBOT = {"arpd": "active", "arpd-relay": "active", "arpd-relay-far": "inactive", "arpd-peer": "inactive"}
AS_IN_THE_SOURCE = {
    "arpd/fastdds.xml": "arpd/ros/fastdds.xml",
    "arpd/grafana": "etc/grafana",
    "arpd/prometheus": "etc/prometheus",
    "bash-completion/completions/arpd": "etc/bash-completion/arpd",
}


@pytest.fixture
def fresh(computers):
    """Purge the package of another test."""
    if "not-installed" not in computers.status() and computers.status():
        computers.remove("purge")
    return computers


@pytest.fixture
def running(computers):
    """Install the first version unless another test left one, and run the robot's units."""
    if not computers.status().startswith("installed "):
        computers.install("first")
    enabled = computers.robot.call("systemctl", "enable", "--now", "arpd", "arpd-relay")
    assert enabled.returncode == 0, enabled.stderr
    return computers


def test_each_commit_is_a_newer_version(tmp_path):
    """An archive has the plain version; dpkg takes a later commit for newer, and an edited checkout for newer still."""
    source = tmp_path / "arpd"
    for name in ("scripts/deb", "scripts/bootstrap", "arpd/__init__.py", "README.md"):
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(REPO / name, source / name)
    environ = os.environ | {f"GIT_{who}_{what}": "a@b" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}

    def git(*argv, folder=source, **more):
        subprocess.run(["git", "-C", folder, "-c", "commit.gpgsign=false", *argv], env=environ | more, check=True)

    def version():
        command = ("bash", "-c", '. "$1/scripts/deb"; commit_version', "bash", source)
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    git("init", "-q", folder=tmp_path)
    versions = [version()]  # in the checkout of another project
    assert versions == [VERSIONS["first"]]
    (tmp_path / ".git").rename(source / ".git")
    for date in ("2026-11-23T23:30:00 -0100", "2026-11-24T01:00:00 +0000"):
        git("add", "-A")
        git("commit", "-qm", "x", "--allow-empty", GIT_COMMITTER_DATE=date)
        versions.append(version())
    (source / "README.md").write_text("mine\n")
    versions += [version(), f"{VERSIONS['first']}.1"]
    assert re.fullmatch(rf"{re.escape(VERSIONS['first'])}\+git20261124003000\.[0-9a-f]{{7}}", versions[1])
    assert versions[3] == f"{versions[2]}.dirty"
    for older, newer in pairwise(versions):
        subprocess.run(["dpkg", "--compare-versions", older, "lt", newer], check=True)


def test_a_fresh_computer_has_arpd_and_runs_nothing(fresh):
    """The installation says how to start each end of the link, and enables no unit."""
    told = fresh.install("first")
    assert "0 to remove" in told  # iproute2 conflicts with packages called arpd
    assert "sudo systemctl enable --now arpd arpd-relay\n" in told
    assert "sudo systemctl enable --now arpd-peer arpd-relay-far\n" in told
    assert set(fresh.states().values()) == {"inactive"}
    booted = fresh.robot
    assert not any(booted.call("systemctl", "is-enabled", unit).returncode == 0 for unit in UNITS)
    verified = booted.call("systemd-analyze", "verify", *(f"{unit}.service" for unit in UNITS))
    assert (verified.returncode, verified.stdout + verified.stderr) == (0, "")
    assert booted.call("arpd", "--version").stdout == f"arpd {VERSIONS['first']}\n"
    for placed, name in AS_IN_THE_SOURCE.items():
        assert booted.call("diff", "-r", f"/usr/share/{placed}", f"{SOURCE}/{name}").returncode == 0
    # The kernel's own word would be the test machine's.
    read_at_boot = booted.call("systemd-analyze", "cat-config", "sysctl.d").stdout
    assert "net.core.rmem_default = 8388608\n" in read_at_boot
    assert booted.call("man", "--where", "1", "arpd").stdout == "/usr/share/man/man1/arpd.1.gz\n"
    systemd = int(booted.call("systemctl", "--version").stdout.split()[1])
    assert any(path.endswith("/10-notify-reload.conf") for path in fresh.named_arpd()) == (systemd >= 253)
    # ROS is built against the system's.
    assert not list(fresh.robot.path(ENV).glob("lib/python*/site-packages/numpy"))
    # All files are as packed, and no other file has arrived but the command.
    assert booted.call("dpkg", "--verify", NAME).stdout == ""
    listed = set(booted.call("dpkg", "--listfiles", NAME).stdout.split())
    made = {path for path in fresh.named_arpd() if not path.startswith("/var/")} - listed
    assert made == {"/usr/local/bin/arpd"}
    assert booted.call("id", "arpd").returncode == 0


def test_the_same_source_gives_the_same_package(computers):
    """A second build with the same date gives the same bytes."""
    again = computers.build("/srv/debs/again")
    assert computers.robot.path(again).read_bytes() == computers.robot.path(computers.files["first"]).read_bytes()


def test_the_systems_python_imports_the_library_and_nothing_else(running):
    """A user's program and a virtual environment have the publisher with ROS sourced, and the system's own numpy."""
    publisher = "from arpd import AdaptivePublisher; print(AdaptivePublisher.__module__)"

    def says(script, python=SYSTEM_PYTHON):
        return running.robot.call(*as_user(python, "-c", script))

    venv = as_user(SYSTEM_PYTHON, "-m", "venv", "--without-pip", "--system-site-packages", "/tmp/ws", ros=False)
    assert running.robot.call(*venv).returncode == 0
    for python in (SYSTEM_PYTHON, "/tmp/ws/bin/python"):
        told = says(publisher, python)
        assert (told.returncode, told.stdout) == (0, "arpd.endpoint.publisher\n"), told.stderr
    numpy = says("import numpy, sys; print(numpy.__file__, *sys.path)")
    assert ENV not in numpy.stdout + numpy.stderr
    without_ros = says(f"import sys; sys.modules['rclpy'] = None; {publisher}")
    assert without_ros.returncode != 0
    assert "rclpy" in without_ros.stderr


def test_an_upgrade_restarts_what_runs_and_keeps_the_configuration(running):
    """Running units run the new version, stopped ones stay stopped, and a new default lies beside an edited file."""
    config = running.robot.path(CONFIG)
    config.write_text(config.read_text() + "# mine\n")
    edited, before = config.read_text(), running.processes()
    told = running.install("second")
    assert running.status() == "installed 99.0"
    assert "systemctl enable" not in told
    assert config.read_text() == edited
    assert running.robot.path(f"{CONFIG}.dpkg-dist").read_text().endswith("# A default of the second version.\n")
    assert not running.robot.path("/etc/default/arpd.dpkg-dist").exists()
    after = running.processes()
    assert all(after[unit] not in ("0", before[unit]) for unit in before)
    assert running.states() == ON_THE_ROBOT


def test_an_installation_names_what_is_enabled_and_stopped(running):
    """A unit that the operator stopped stays stopped, and the installation shows the line that starts it."""
    running.robot.call("systemctl", "stop", "arpd")
    told = running.install("first")
    assert "sudo systemctl start arpd\n" in told
    assert "systemctl enable" not in told
    assert running.states() == {**ON_THE_ROBOT, "arpd": "inactive"}


def test_an_upgrade_whose_configuration_is_refused_keeps_the_old_processes(running):
    """The upgrade names the fault with file and line, and the line that starts the new version; no unit restarts."""
    config = running.robot.path(CONFIG)
    good, before = config.read_text(), running.processes()
    config.write_text("link:\n  headrom: 0.5\n")
    other = "first" if running.status().endswith(VERSIONS["second"]) else "second"
    try:
        told = running.install(other)
        assert f"{CONFIG}:2:3: link.headrom" in told
        assert "sudo systemctl restart arpd arpd-relay\n" in told
        assert (running.processes(), running.states()) == (before, ON_THE_ROBOT)
    finally:
        config.write_text(good)


def test_a_version_that_does_not_run_leaves_the_relay_on_the_old_one(running):
    """The upgrade names the unit and the way back, and the older package runs again."""
    if not running.status().endswith(VERSIONS["first"]):
        running.install("first")
    relay = running.processes()["arpd-relay"]
    running.robot.path(BREAK).touch()
    told = running.install("second")
    assert "arpd does not run with the new version" in told
    assert "sudo apt install --allow-downgrades ./arpd-ros_OLD.deb" in told
    assert running.processes()["arpd-relay"] == relay
    running.install("first")
    running.robot.path(BREAK).unlink()
    assert running.states() == ON_THE_ROBOT


def test_removing_keeps_the_configuration_and_a_purge_leaves_nothing(running):
    """`apt remove` keeps configuration and user; after `apt purge` no file, unit, link or user of arpd is left."""
    running.robot.write("/etc/systemd/system/arpd.service.d/override.conf", "[Service]\nNice=1\n")
    running.robot.call("systemctl", "daemon-reload")
    running.remove("remove")
    assert set(running.states().values()) == {"inactive"}
    assert not [path for path in running.named_arpd() if path.startswith("/usr")]
    assert {CONFIG, "/etc/default/arpd"} <= running.named_arpd()
    assert running.robot.call("id", "arpd").returncode == 0

    assert "left: arpd's entries in the journal" in running.remove("purge")
    assert running.named_arpd() == set()
    assert running.robot.call("id", "arpd").returncode != 0
