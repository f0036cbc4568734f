"""A computer with its own systemd, booted from this one's files: systemd-nspawn on an overlay of /.

It writes into a tmpfs. Its mounts and processes are in namespaces that end with the test; the kernel removes them even
after kill -9. Its network is an existing namespace.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import psutil

from tests.waiting import eventually

_CALL_S = 120.0
_TOOLS = ("systemd-nspawn", "systemctl", "nsenter", "unshare", "setpriv")
_REPO = Path(__file__).resolve().parents[3]
# In a computer: this checkout, the test's Python and its virtual environment. Outside they may be in a private home, or
# in /tmp, which nspawn and the units' sandbox hide.
SOURCE, PYTHON, VENV = Path("/srv/arpd"), Path("/opt/python"), Path("/opt/venv")

# $1: a mount point; then the command, which finds this computer's files in $1/root. It runs again when the computer
# reboots, which nspawn reports by 133 (systemd-nspawn(1), --keep-unit). The tests do not need this computer's services.
_ON_AN_OVERLAY = """
set -e
mount -t tmpfs -o mode=0755 arpd-machine "$1"
mkdir "$1/upper" "$1/work" "$1/root"
mount -t overlay -o "lowerdir=/,upperdir=$1/upper,workdir=$1/work" arpd-machine "$1/root"
rm -rf "$1/root/etc/systemd/system/multi-user.target.wants"
shift
ended=133
while [ $ended = 133 ]; do ended=0; "$@" || ended=$?; done
exit $ended
"""
# $1: folders of a cgroup; then the command. All computers would use the cgroup that nspawn is started in.
_IN_CGROUPS = 'for each in $1; do echo $$ >"$each/cgroup.procs"; done; shift; exec "$@"'
# The cgroups of systemd: unified, hybrid, legacy. The controllers' own hierarchies stay untouched.
_HIERARCHIES = tuple(Path("/sys/fs/cgroup", name) for name in ("", "unified", "systemd"))


def available():
    """Return whether a computer can boot here, and if not, the reason."""
    if os.geteuid() != 0:
        return False, "not root, which mounting an overlay and systemd-nspawn need"
    if missing := [tool for tool in _TOOLS if shutil.which(tool) is None]:
        return False, f"{', '.join(missing)} not found; on Debian and Ubuntu: apt install systemd-container util-linux"
    with tempfile.TemporaryDirectory() as folder:
        tried = subprocess.run(_on_overlay(folder, "true"), check=False, capture_output=True, text=True)
    return tried.returncode == 0, f"no overlay of / here: {tried.stderr.strip()}"


class Computer:
    """A booted computer; ``init`` is the process id of its systemd here, which changes with a reboot."""

    def __init__(self, init, outside):
        self.init, self._outside = init, outside

    def path(self, inside):
        """Return where one of its files is here."""
        return Path(f"/proc/{self.init}/root", inside.lstrip("/"))

    def write(self, inside, text):
        """Write one of its files."""
        path = self.path(inside)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    def call(self, *argv):
        """Run a command inside to its end."""
        return subprocess.run(self._inside(argv), capture_output=True, text=True, check=False, timeout=_CALL_S)

    def popen(self, *argv):
        """Start a command inside."""
        return subprocess.Popen(self._inside(argv), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def show(self, unit, *properties):
        """Return properties of a unit."""
        shown = self.call("systemctl", "show", unit, f"--property={','.join(properties)}").stdout
        return dict(line.split("=", 1) for line in shown.splitlines())

    def journal(self, unit):
        """Return the log of a unit, and systemd's log about it."""
        return self.call("journalctl", "--unit", unit, "--no-pager").stdout

    def reboot(self):
        """Reboot on the same files and wait for the boot."""
        before = self.init
        self.call("systemctl", "reboot")
        self.init = _await_boot(self._outside, other_than=before)

    def _inside(self, argv):
        return ["nsenter", "--target", str(self.init), "--all", *argv]


@contextmanager
def booted(name, *, network):
    """Boot a computer of this name into multi-user.target in a network namespace; the end of the block ends it."""
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="arpd-machine-"))
        log = stack.enter_context(tempfile.TemporaryFile("w+"))
        nspawn = (
            *("systemd-nspawn", "--quiet", f"--directory={folder}/root", f"--machine={name}", "--boot"),
            *(f"--network-namespace-path={network}", "--register=no", "--keep-unit", "--link-journal=no"),
            f"--bind-ro={_REPO}:{SOURCE}",
            f"--bind-ro={sys.base_prefix}:{PYTHON}",
            f"--bind-ro={Path(sys.prefix).resolve()}:{VENV}",
            # Timers fetch packages and collect metrics.
            *("--console=pipe", "--", "systemd.unit=multi-user.target", "systemd.mask=timers.target"),
            f"systemd.hostname={name}",
        )
        cgroups = [hierarchy / name for hierarchy in _HIERARCHIES if (hierarchy / "cgroup.procs").exists()]
        for cgroup in cgroups:
            cgroup.mkdir()
            stack.callback(eventually, f"{cgroup} is removed", lambda cgroup=cgroup: _is_removed(cgroup))
        argv = ("sh", "-c", _IN_CGROUPS, "sh", " ".join(map(str, cgroups)), *_on_overlay(folder, *nspawn))
        process = subprocess.Popen(
            argv, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
        )
        stack.callback(process.wait)
        stack.callback(process.kill)  # with which the kernel ends everything inside
        try:
            yield Computer(_await_boot(process), process)
        except AssertionError:
            log.seek(0)
            print(f"the console of {name}:\n{log.read()}")
            raise


def _on_overlay(folder, *argv):
    """Return the command line that runs ``argv`` with this computer's files, to be written to, in ``folder/root``."""
    # Otherwise nspawn would outlive its parent, and systemd would outlive nspawn.
    namespaces = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc"]
    return ["setpriv", "--pdeathsig", "KILL", *namespaces, "sh", "-c", _ON_AN_OVERLAY, "sh", folder, *argv]


def _await_boot(outside, *, other_than=None):
    def find_init():
        assert outside.poll() is None, f"systemd-nspawn ended with code {outside.returncode}"
        if (init := _init_of(outside)) in (None, other_than):
            return None
        is_active = Computer(init, outside).call("systemctl", "is-active", "multi-user.target")
        return init if is_active.stdout.strip() == "active" else None

    return eventually("multi-user.target is reached", find_init)


def _init_of(outside):
    """Return the process id of the computer's systemd, None while there is none."""
    for process in psutil.Process(outside.pid).children(recursive=True):
        with suppress(OSError):
            # The ids here, in nspawn's namespace, and inside, where only the computer's first process is 1.
            if re.search(r"^NSpid:\t\d+\t\d+\t1$", Path(f"/proc/{process.pid}/status").read_text(), re.MULTILINE):
                return process.pid
    return None


def _is_removed(cgroup):
    for path, _, _ in os.walk(cgroup, topdown=False):
        with suppress(OSError):  # a killed process stays in it for a moment
            Path(path).rmdir()
    return not cgroup.exists()
