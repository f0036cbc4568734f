"""A machine with its own systemd, booted from this machine's files: systemd-nspawn on an overlay of /.

It writes into a tmpfs. Its mounts and processes are in namespaces that end with the test; the kernel removes them even
after kill -9. Its network is an existing namespace.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tests.waiting import eventually

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_CALL_S = 120.0
_GONE_S = 60.0
_TOOLS = ("systemd-nspawn", "systemctl", "nsenter", "unshare", "setpriv")

_REPO = Path(__file__).resolve().parents[3]
PYTHON = Path("/opt/python")  # the test's Python in a machine; outside, it may be in a private home
_REBOOT = 133  # exit code of nspawn when its machine reboots (systemd-nspawn(1), --keep-unit)
_AGAIN = 'while :; do "$@"; ended=$?; [ "$ended" = "$again" ] || exit "$ended"; done'

# $1: folder with files/ and the mount point m; then the command, for which m/root is this machine with those files.
_MOUNT_AND_EXEC = """
set -e
folder=$1; shift
mount -t tmpfs -o mode=0755 arpd-machine "$folder/m"
cp -a "$folder/files" "$folder/m/upper"
mkdir "$folder/m/work" "$folder/m/root"
mount -t overlay -o "lowerdir=/,upperdir=$folder/m/upper,workdir=$folder/m/work" arpd-machine "$folder/m/root"
# The tests do not need this machine's services.
rm -rf "$folder/m/root/etc/systemd/system/multi-user.target.wants"
exec "$@"
"""
# $1: cgroup.procs files to join, one per line; then the command.
_MOVE_AND_EXEC = """
set -ef
IFS='
'
for procs in $1; do echo $$ >"$procs"; done
shift
exec "$@"
"""
# The cgroups of systemd: unified, hybrid, legacy. The controllers' own hierarchies stay untouched.
_HIERARCHIES = tuple(Path("/sys/fs/cgroup", name) for name in ("", "unified", "systemd"))


class MachineError(Exception):
    """The machine did not boot."""


def available() -> tuple[bool, str]:
    """Return whether a machine can boot here, and if not, the reason."""
    if os.geteuid() != 0:
        return False, "not root, which mounting an overlay and systemd-nspawn need"
    if missing := [tool for tool in _TOOLS if shutil.which(tool) is None]:
        return False, f"{', '.join(missing)} not found; on Debian and Ubuntu: apt install systemd-container util-linux"
    with _folder({}) as folder:
        tried = subprocess.run(_on_overlay(folder, "true"), check=False, capture_output=True, text=True)
    return tried.returncode == 0, f"no overlay of / here: {tried.stderr.strip()}"


@dataclass(slots=True)
class Machine:
    """A booted machine.

    Parameters
    ----------
    init : process id of its systemd on this machine; changes with a reboot
    """

    init: int
    _outside: subprocess.Popen[bytes]

    @property
    def root(self) -> Path:
        """Its file system on this machine."""
        return Path(f"/proc/{self.init}/root")

    def call(self, *argv: str) -> subprocess.CompletedProcess[str]:
        """Run a command inside to its end."""
        return subprocess.run(self._inside(argv), capture_output=True, text=True, check=False, timeout=_CALL_S)

    def popen(self, *argv: str) -> subprocess.Popen[str]:
        """Start a command inside."""
        return subprocess.Popen(self._inside(argv), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def show(self, unit: str, *properties: str) -> dict[str, str]:
        """Return properties of a unit."""
        shown = self.call("systemctl", "show", unit, f"--property={','.join(properties)}").stdout
        return dict(line.split("=", 1) for line in shown.splitlines())

    def journal(self, unit: str) -> str:
        """Return the log of a unit, and systemd's log about it."""
        return self.call("journalctl", "--unit", unit, "--no-pager").stdout

    def reboot(self) -> None:
        """Reboot on the same files and wait for the boot."""
        before = self.init
        self.call("systemctl", "reboot")
        self.init = _await_boot(self._outside, other_than=before)

    def _inside(self, argv: tuple[str, ...]) -> list[str]:
        return ["nsenter", "--target", str(self.init), "--all", *argv]


@contextmanager
def booted(name: str, *, network: Path, files: Mapping[str, str | Path]) -> Iterator[Machine]:
    """Boot a machine into multi-user.target, with the units that `files` enable; the end of the block ends it.

    Parameters
    ----------
    name : unique name of the machine
    network : its network namespace
    files : files to install, path → text, or file to copy with its mode
    """
    # Timers fetch packages and collect metrics; the tests need none.
    quiet = {"/etc/systemd/system/timers.target": Path("/dev/null"), "/etc/hostname": f"{name}\n"}
    with ExitStack() as stack:
        folder = stack.enter_context(_folder({**quiet, **files}))
        cgroups = stack.enter_context(_cgroups(name))
        nspawn = (
            *("systemd-nspawn", "--quiet", f"--directory={folder}/m/root", f"--machine={name}", "--boot"),
            *(f"--network-namespace-path={network}", "--register=no", "--keep-unit", "--link-journal=no"),
            # A fixed path, because nspawn and the units' sandbox hide /tmp, where the checkout may be.
            f"--bind-ro={_REPO}:/srv/arpd",
            f"--bind-ro={sys.base_prefix}:{PYTHON}",
            *("--console=pipe", "--", "systemd.unit=multi-user.target"),
        )
        again = ("env", f"again={_REBOOT}", "sh", "-c", _AGAIN, "sh")
        procs = "\n".join(f"{cgroup}/cgroup.procs" for cgroup in cgroups)
        command = ("sh", "-c", _MOVE_AND_EXEC, "sh", procs, *_on_overlay(folder, *again, *nspawn))
        console = folder / "console"
        with console.open("w") as log:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
            )
        stack.callback(_end, process)
        try:
            machine = Machine(_await_boot(process), process)
        except (AssertionError, MachineError) as error:
            raise MachineError(f"{name}: {error}; its console:\n{console.read_text()}") from None
        yield machine


def _await_boot(outside: subprocess.Popen[bytes], *, other_than: int | None = None) -> int:
    def find_init() -> int | None:
        if outside.poll() is not None:
            raise MachineError(f"systemd-nspawn ended with code {outside.returncode}")
        if (init := _init_of(outside)) in (None, other_than):
            return None
        is_active = Machine(init, outside).call("systemctl", "is-active", "multi-user.target")
        return init if is_active.stdout.strip() == "active" else None

    return eventually("multi-user.target is reached", find_init)


def _init_of(outside: subprocess.Popen[bytes]) -> int | None:
    """Return the process id of the machine's systemd, None while there is none."""
    processes = [outside.pid]
    with suppress(OSError):
        for pid in processes:
            # The ids here, in nspawn's namespace, and inside, where only the machine's first process is 1.
            if re.search(r"^NSpid:\t\d+\t\d+\t1$", Path(f"/proc/{pid}/status").read_text(), re.MULTILINE):
                return pid
            processes += _children(pid)
    return None


def _children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def _end(outside: subprocess.Popen[bytes]) -> None:
    """Kill the machine's init, with which the kernel ends all processes inside; nspawn then cleans up."""
    with suppress(ProcessLookupError):
        os.kill(_init_of(outside) or outside.pid, signal.SIGKILL)
    try:
        outside.wait(timeout=_GONE_S)
    except subprocess.TimeoutExpired:
        outside.kill()
        outside.wait()


@contextmanager
def _folder(files: Mapping[str, str | Path]) -> Iterator[Path]:
    """Write the files into a temporary folder for `_on_overlay`."""
    with tempfile.TemporaryDirectory(prefix="arpd-machine-") as name:
        folder = Path(name)
        (folder / "m").mkdir()
        (folder / "files").mkdir(mode=0o755)
        for path, content in files.items():
            target = folder / "files" / path.lstrip("/")
            target.parent.mkdir(parents=True, exist_ok=True)
            if not isinstance(content, Path):
                target.write_text(content)
            elif content.is_file():
                shutil.copy(content, target)
            else:
                target.symlink_to(content)
        yield folder


def _on_overlay(folder: Path, *argv: str) -> list[str]:
    """Return the command line that runs ``argv`` with this machine's and the folder's files in ``folder/m/root``."""
    # Otherwise nspawn would outlive its parent, and systemd would outlive nspawn.
    namespaces = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc"]
    return ["setpriv", "--pdeathsig", "KILL", *namespaces, "sh", "-c", _MOUNT_AND_EXEC, "sh", str(folder), *argv]


@contextmanager
def _cgroups(name: str) -> Iterator[list[Path]]:
    """Make cgroups for one machine; nspawn uses the same ones for all machines from one cgroup."""
    made: list[Path] = []
    try:
        for hierarchy in _HIERARCHIES:
            if (hierarchy / "cgroup.procs").exists():
                made.append(hierarchy / name)
                made[-1].mkdir(exist_ok=True)
        yield made
    finally:
        for cgroup in made:
            for path, _, _ in os.walk(cgroup, topdown=False):
                _remove_cgroup(Path(path))


def _remove_cgroup(cgroup: Path) -> None:
    def is_removed() -> bool:
        with suppress(OSError):  # a killed process stays in it for a moment
            cgroup.rmdir()
        return not cgroup.exists()

    eventually(f"{cgroup} is empty", is_removed)
