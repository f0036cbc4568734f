"""A robot and a base computer that look like a user's, and arpd's package on them.

ROS under /opt/ros/jazzy and what apt has come from the test's environment, in its versions, so that pip finds
everything and fetches nothing.
"""

import re
import shutil
import sys
import zipfile
from importlib import metadata
from pathlib import Path

from tests.all.system.machine import PYTHON, SOURCE, VENV

NAME = "arpd-ros"
ENV = "/usr/lib/arpd/env"
CONFIG = "/etc/arpd/arpd.yaml"
BREAK = "/etc/arpd/break"
UNITS = ("arpd", "arpd-relay", "arpd-relay-far", "arpd-peer")
VERSIONS = {"first": metadata.version("arpd"), "second": "99.0"}
# Replaces the first line of _run: the version passes every check but does not run.
BROKEN_RUN = f"""def _run(options: argparse.Namespace) -> int:
    from pathlib import Path

    if Path("{BREAK}").exists():
        raise SystemExit("broken on purpose")
"""
OURS = (
    "/etc",
    "/usr/lib/arpd",
    "/usr/lib/python3",
    "/usr/lib/systemd",
    "/usr/lib/sysctl.d",
    "/usr/lib/sysusers.d",
    "/usr/local",
    "/usr/share",
    "/var/lib",
    "/var/cache",
)
SYSTEM_PYTHON = "/usr/bin/python3"
_OF_THIS_TEST = "python{}.{}".format(*sys.version_info)
IS_SYSTEMS = Path(SYSTEM_PYTHON).resolve().name == _OF_THIS_TEST
_SITE = VENV / "lib" / _OF_THIS_TEST / "site-packages"
_ROS_SETUP = f"""
for libs in {VENV}/lib {PYTHON}/lib {_SITE}/ros_*.libs; do LD_LIBRARY_PATH="$libs:$LD_LIBRARY_PATH"; done
export LD_LIBRARY_PATH
false
"""
_USER = ("setpriv", "--reuid=4242", "--regid=4242", "--clear-groups")  # neither root nor arpd


def prepare(computer):
    """Put in what stands for apt's packages, and for PyPI a wheel of setuptools, which pip needs to build arpd."""
    computer.write("/opt/ros/jazzy/setup.bash", _ROS_SETUP)
    computer.write(f"/usr/local/lib/{_OF_THIS_TEST}/dist-packages/apt.pth", f"{_SITE}\n")
    # An image for containers forbids packages to restart services; a file that nobody can execute forbids nothing.
    computer.write("/usr/sbin/policy-rc.d", "").chmod(0o644)
    computer.path("/srv/wheels").mkdir()
    wheel = computer.path(f"/srv/wheels/setuptools-{metadata.version('setuptools')}-py3-none-any.whl")
    with zipfile.ZipFile(wheel, "w") as packed:
        for path in metadata.files("setuptools"):
            if ".." not in path.parts and path.suffix != ".pyc":
                packed.write(path.locate(), path)


def run(computer, *argv, environment=()):
    """Return exit code and output of a command that, like one of sudo, has not this process's environment."""
    offline = ("PATH=/usr/sbin:/usr/bin:/sbin:/bin", "PIP_NO_INDEX=1", "PIP_FIND_LINKS=/srv/wheels")
    # Without a timeout, because a venv takes seconds, and a minute on two busy cores.
    running = computer.popen("env", "-i", *offline, *environment, *argv)
    told, _ = running.communicate()
    return running.returncode, told


def as_user(*argv, ros=True):
    """Return the command line of a program that a user other than arpd runs, with ROS sourced or not."""
    environment = ("env", "-i", "PATH=/usr/bin:/bin", "HOME=/tmp", "PYTHONDONTWRITEBYTECODE=1")
    setup = ". /opt/ros/jazzy/setup.bash; " if ros else ""
    return (*_USER, *environment, "bash", "-c", f'{setup}exec "$@"', "bash", *argv)


def substitute(path, old, new):
    text = path.read_text()
    assert text.count(old) == 1, f"{old!r} in {path}"
    path.write_text(text.replace(old, new))


class Computers:
    """Both computers, the packages of two versions of arpd, and what becomes of them on the robot."""

    def __init__(self, link, robot, base):
        self.link, self.robot, self.base = link, robot, base
        prepare(robot)
        prepare(base)
        self.others = set()
        self.others = self.named_arpd()  # iproute2 has an arpd, too
        self.files = {"first": self.build("/srv/debs/first")}
        self.files["second"] = self.made_of_first()

    def build(self, folder):
        # As a user who may write nothing else, and from whom git keeps the checkout, so that the version is plain.
        self.robot.path(folder).mkdir(parents=True)
        self.robot.call("chown", "4242", folder)
        date = ("SOURCE_DATE_EPOCH=1700000000", "HOME=/tmp")
        code, told = run(self.robot, *_USER, f"{SOURCE}/scripts/deb", "--output", folder, environment=date)
        assert code == 0, told
        return re.search(r"^(/srv/debs/\S+\.deb):", told, re.MULTILINE)[1]

    def made_of_first(self):
        """Return a package with the changes of the second version, which takes a second instead of a build."""
        made = self.robot.call("dpkg-deb", "-R", self.files["first"], "/srv/debs/second")
        assert made.returncode == 0, made.stderr
        folder = self.robot.path("/srv/debs/second")
        (processes,) = folder.glob("usr/lib/arpd/env/lib/python*/site-packages/arpd/cli/processes.py")
        substitute(processes, BROKEN_RUN.splitlines()[0] + "\n", BROKEN_RUN)
        default = folder / CONFIG.lstrip("/")
        default.write_text(default.read_text() + "# A default of the second version.\n")
        substitute(folder / "DEBIAN/control", f"Version: {VERSIONS['first']}\n", f"Version: {VERSIONS['second']}\n")
        packed = self.robot.call("dpkg-deb", "-b", "/srv/debs/second", "/srv/debs")
        assert packed.returncode == 0, packed.stderr
        return self.files["first"].replace("/first/", "/").replace(VERSIONS["first"], VERSIONS["second"])

    def install(self, version, computer=None):
        """Install a version, again if it is there, as a script does: without questions; return what apt told."""
        if (computer := computer or self.robot) is self.base:
            shutil.copy(self.robot.path(self.files[version]), self.base.path("/srv"))
        file = self.files[version] if computer is self.robot else f"/srv/{Path(self.files[version]).name}"
        options = ("-y", "--allow-downgrades", "--reinstall", "-o", "Dpkg::Options::=--force-confold")
        code, told = run(
            computer, "apt-get", "install", *options, file, environment=("DEBIAN_FRONTEND=noninteractive",)
        )
        assert code == 0, told
        return told

    def remove(self, how):
        code, told = run(self.robot, "apt-get", how, "-y", NAME)
        assert code == 0, told
        return told

    def status(self):
        return self.robot.call("dpkg-query", "--show", "--showformat=${db:Status-Status} ${Version}", NAME).stdout

    def states(self):
        return {unit: self.robot.call("systemctl", "is-active", unit).stdout.strip() for unit in UNITS}

    def processes(self):
        return {unit: self.robot.show(unit, "MainPID")["MainPID"] for unit in ("arpd", "arpd-relay")}

    def named_arpd(self):
        """Return the paths with arpd in them where packages install, but for those of others."""
        return set(self.robot.call("find", *OURS, "-path", "*arpd*").stdout.splitlines()) - self.others
