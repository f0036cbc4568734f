"""scripts/deb and the package that it builds, on an overlay of this machine."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from importlib import metadata
from itertools import pairwise

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("pyroute2", reason="pyroute2 is not installed: pip install pyroute2")

from scripts.netns.namespaces import NETNS_DIR
from scripts.netns.simlink import SimLink, available
from tests.all.system import machine, user_world
from tests.all.system.fake_pi import (
    CONFIG,
    IS_SYSTEMS,
    UNITS,
    FakePi,
    installed_by_apt,
    substitute,
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
VERSIONS = {"first": metadata.version("arpd"), "second": "99.0"}
OURS = (
    "/etc",
    "/opt",
    "/usr/lib/arpd",
    "/usr/lib/python3",
    "/usr/lib/systemd",
    "/usr/lib/sysusers.d",
    "/usr/local",
    "/usr/share",
)


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
        code, told = self.pi.run(*user, "/srv/first/scripts/deb", "--output", folder, environment=date)
        assert code == 0, told
        return re.search(r"^(/srv/debs/\S+\.deb):", told, re.MULTILINE)[1]

    def made_of_first(self):
        """Return a package with the changes of the second version, which takes a second instead of a build."""
        made = self.pi.booted.call("dpkg-deb", "-R", self.files["first"], "/srv/debs/second")
        assert made.returncode == 0, made.stderr
        (main,) = self.pi.path("/srv/debs/second").glob("usr/lib/arpd/env/lib/python*/site-packages/arpd/cli/main.py")
        default = self.pi.path(f"/srv/debs/second/usr/share/arpd{CONFIG}")
        for changed, second in ((main, "/arpd/cli/main.py"), (default, CONFIG)):
            shutil.copyfile(self.pi.path(f"/srv/second{second}"), changed)
        control = self.pi.path("/srv/debs/second/DEBIAN/control")
        substitute(control, f"Version: {VERSIONS['first']}\n", f"Version: {VERSIONS['second']}\n")
        packed = self.pi.booted.call("dpkg-deb", "-b", "/srv/debs/second", "/srv/debs")
        assert packed.returncode == 0, packed.stderr
        return self.files["first"].replace("/first/", "/").replace(VERSIONS["first"], VERSIONS["second"])

    def install(self, version):
        """Install a version, again if it is there, as a script does: without questions."""
        options = ("-y", "--allow-downgrades", "--reinstall")
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
    script = '. "$source/scripts/bootstrap"; . "$source/scripts/install-checks"; commit_version'
    command = ("env", f"source={source}", "bash", "-eu", "-o", "pipefail", "-c", script)
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


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
    assert booted.call("test", "-e", user_world.PROFILE).returncode == 0
    # All files are as packed, and no other file has arrived but these.
    assert booted.call("dpkg", "--verify", NAME).stdout == ""
    listed = set(booted.call("dpkg", "--listfiles", NAME).stdout.split())
    made = {path for path in fresh.named_arpd() if not path.startswith("/var/")} - listed
    links = {"/usr/local/bin/arpd", "/usr/local/share/arpd", user_world.PROFILE}
    assert made == links | {"/etc/arpd", CONFIG, "/etc/default/arpd"}
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
    imported = user_world.python_says(running.pi.booted, user_world.IMPORT)
    assert (imported.returncode, imported.stdout) == (0, "arpd.adapters.ros.publisher\n"), imported.stderr
    with (tmp_path / "log").open("w") as log:
        row, told = user_world.run_node(running.pi.booted, running.pi.link, log)
    assert (row["node"], row["refusal"], told) == ("/talker", "", "")


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
    assert running.pi.path(f"{CONFIG}.new").read_text().endswith("# A default of the second version.\n")
    assert not running.pi.path("/etc/default/arpd.new").exists()
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


def test_package_and_script_refuse_each_other(running):
    """Each names what is installed, and the line that removes it."""
    code, told = running.pi.install("first")
    assert code == 1
    assert "sudo apt remove arpd-ros" in told
    before = running.named_arpd()
    code, told = running.pi.run("/srv/first/scripts/uninstall.sh", "--purge")
    assert code == 1
    assert "sudo apt remove arpd-ros" in told
    assert (running.named_arpd(), running.pi.states()) == (before, ON_THE_ROBOT)
    assert running.remove("purge")[0] == 0
    running.pi.path("/opt/arpd/versions").mkdir(parents=True)
    code, told = running.install("first")
    running.pi.path("/opt/arpd/versions").rmdir()
    running.pi.path("/opt/arpd").rmdir()
    assert code != 0
    assert "sudo /opt/arpd/current/share/arpd/scripts/uninstall.sh" in told


def test_removing_keeps_the_configuration_and_a_purge_leaves_nothing(running):
    """`apt remove` keeps configuration and user; after `apt purge` no file, unit, link or user of arpd is left."""
    drop_in = running.pi.path("/etc/systemd/system/arpd.service.d")
    drop_in.mkdir()
    (drop_in / "override.conf").write_text("[Service]\nNice=1\n")
    running.pi.booted.call("systemctl", "daemon-reload")
    code, told = running.remove("remove")
    assert code == 0, told
    assert set(running.pi.states().values()) == {"inactive"}
    left = {path for path in running.named_arpd() if path.startswith(("/usr", "/opt"))}
    assert left == set()
    assert {CONFIG, "/etc/default/arpd"} <= running.named_arpd()
    assert running.pi.booted.call("id", "arpd").returncode == 0

    code, told = running.remove("purge")
    assert code == 0, told
    assert "left: arpd's entries in the journal" in told
    assert running.named_arpd() == set()
    assert running.pi.booted.call("id", "arpd").returncode != 0
