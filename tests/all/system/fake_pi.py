"""A booted computer that looks like a robot's, with ROS under /opt/ros/jazzy and libraries in its site-packages.

Both come from this venv, in its versions, so that pip finds everything and fetches nothing.
"""

from __future__ import annotations

import os
import shutil
import stat
import sys
import zipfile
from importlib import metadata
from pathlib import Path

from tests.all.system import machine

REPO = Path(__file__).parents[3]
PYTHON = "python{}.{}".format(*sys.version_info)
SITE = f".venv/lib/{PYTHON}/site-packages"
SYSTEM_PYTHON = Path("/usr/bin/python3")
IS_SYSTEMS = SYSTEM_PYTHON.resolve().name == PYTHON
SOURCE = "/srv/source"
IN_SOURCE = ("pyproject.toml", "setup.cfg", "README.md", "LICENSE", "arpd", "etc", "systemd")
SCRIPTS = ("bootstrap", "deb")
UNITS = ("arpd", "arpd-relay", "arpd-relay-far", "arpd-peer")


def wheel_of_setuptools(folder):
    """Pack the installed setuptools as a wheel, which pip needs to build arpd without a network."""
    files = metadata.files("setuptools")
    wheel = folder / f"setuptools-{metadata.version('setuptools')}-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as packed:
        for path in files:
            if ".." not in path.parts and path.suffix != ".pyc":
                packed.write(path.locate(), path)
    return wheel


def unpack_source(folder):
    """Copy the files of an archive into a folder."""
    folder.chmod(0o755)  # pytest's folders are private
    ignore = shutil.ignore_patterns("__pycache__")
    for name in IN_SOURCE:
        if (REPO / name).is_dir():
            shutil.copytree(REPO / name, folder / name, ignore=ignore)
        elif (REPO / name).exists():
            shutil.copy(REPO / name, folder / name)
    (folder / "scripts").mkdir()
    for name in SCRIPTS:
        shutil.copy(REPO / "scripts" / name, folder / "scripts" / name)
    shutil.copytree(REPO / "scripts/debian", folder / "scripts/debian")


def installed_by_apt(folder):
    """Return files that stand for apt's packages, and a wheel of setuptools that stands for PyPI."""
    site = f"/srv/arpd/{SITE}"
    wheel = wheel_of_setuptools(folder)
    return {
        "/opt/ros/jazzy/setup.bash": (
            f"for libs in /srv/arpd/.venv/lib {machine.PYTHON}/lib {site}/ros_*.libs; do\n"
            '    LD_LIBRARY_PATH="$libs:$LD_LIBRARY_PATH"\n'
            "done\n"
            "export LD_LIBRARY_PATH\nfalse\n"
        ),
        f"/srv/wheels/{wheel.name}": wheel,
        f"/usr/local/lib/{PYTHON}/dist-packages/apt.pth": f"{site}\n",
    }


class FakePi:
    """A booted robot computer with the source of arpd."""

    def __init__(self, booted, link):
        self.booted = booted
        self.link = link
        self.path(SOURCE).mkdir()
        unpack_source(self.path(SOURCE))

    def path(self, path):
        return self.booted.root / path.lstrip("/")

    def run(self, *argv, environment=()):
        """Return exit code and output of a command that, like one of sudo, has not this process's environment."""
        offline = ("PATH=/usr/sbin:/usr/bin:/sbin:/bin", "PIP_NO_INDEX=1", "PIP_FIND_LINKS=/srv/wheels")
        # Without a timeout, because a venv takes seconds, and a minute on two busy cores.
        running = self.booted.popen("env", "-i", *offline, *environment, *argv)
        told, _ = running.communicate()
        return running.returncode, told

    def states(self):
        return {unit: self.booted.call("systemctl", "is-active", unit).stdout.strip() for unit in UNITS}

    def processes(self):
        return {unit: self.booted.show(unit, "MainPID")["MainPID"] for unit in ("arpd", "arpd-relay")}

    def files(self, *folders):
        """Return inode, time and mode of every path in the folders."""
        root = str(self.booted.root)
        listed = {}
        for folder in folders:
            for parent, _, names in os.walk(self.path(folder)):
                for path in (Path(parent), *(Path(parent, name) for name in names)):
                    status = path.lstat()
                    listed[str(path).removeprefix(root)] = (
                        status.st_ino,
                        status.st_mtime_ns,
                        stat.filemode(status.st_mode),
                    )
        return listed
