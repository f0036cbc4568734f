"""A machine with a systemd of its own, booted from this one's files: systemd-nspawn on an overlay of /.

What it writes stays in a tmpfs, and its mounts and processes in namespaces that end with the test: the kernel removes
them even after kill -9. Its network is a namespace that is already there.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

BOOT_S = 30.0
_CALL_S = 45.0
_GONE_S = 5.0
_TOOLS = ("systemd-nspawn", "systemctl", "nsenter", "unshare", "setpriv")

_REPO = Path(__file__).resolve().parents[2]
PYTHON = Path("/opt/python")  # where a machine sees the Python that runs the tests, which may live in a private home
_REBOOT = 133  # how nspawn ends when its machine wants to be started again (systemd-nspawn(1), --keep-unit)
_AGAIN = 'while :; do "$@"; ended=$?; [ "$ended" = "$again" ] || exit "$ended"; done'

# $1: folder with files/ and the mount point m; then the command to run where m/root is this machine with those files.
_MOUNT_AND_EXEC = """
set -e
folder=$1; shift
mount -t tmpfs -o mode=0755 arpd-machine "$folder/m"
cp -a "$folder/files" "$folder/m/upper"
mkdir "$folder/m/work" "$folder/m/root"
mount -t overlay -o "lowerdir=/,upperdir=$folder/m/upper,workdir=$folder/m/work" arpd-machine "$folder/m/root"
# What this machine serves is none of the tests' business.
rm -rf "$folder/m/root/etc/systemd/system/multi-user.target.wants"
exec "$@"
"""
# $1: files that move the process that writes its id into them, one per line; then the command to run there.
_MOVE_AND_EXEC = """
set -ef
IFS='
'
for procs in $1; do echo $$ >"$procs"; done
shift
exec "$@"
"""
# Where systemd keeps its cgroups: unified, hybrid, legacy. The controllers' own hierarchies are not touched.
_HIERARCHIES = tuple(Path("/sys/fs/cgroup", name) for name in ("", "unified", "systemd"))


class MachineError(Exception):
    """The machine did not boot, or did not go away."""


def available() -> tuple[bool, str]:
    """Tell whether a machine can boot here, and if not, why."""
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
    init : process id of its systemd, as this machine sees it; another one after a reboot
    """

    init: int
    _outside: subprocess.Popen[bytes]

    @property
    def root(self) -> Path:
        """Its file system, as this machine sees it."""
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
        """Return what a unit has logged, and what systemd has logged about it."""
        return self.call("journalctl", "--unit", unit, "--no-pager").stdout

    def reboot(self) -> None:
        """Reboot on the same files, and wait until it is up again.

        Raises
        ------
        MachineError
            If it does not come up.
        """
        before = self.init
        self.call("systemctl", "reboot")
        self.init = _await_boot(self._outside, other_than=before)

    def _inside(self, argv: tuple[str, ...]) -> list[str]:
        return ["nsenter", "--target", str(self.init), "--all", *argv]


@contextmanager
def booted(
    name: str, *, network: Path, files: Mapping[str, str | Path], binds: Mapping[str, Path] | None = None
) -> Iterator[Machine]:
    """Boot a machine into multi-user.target, which wants what `files` enable; leaving the block ends it.

    Parameters
    ----------
    name : of the machine, unique on this one
    network : network namespace the machine lives in
    files : what to install, path → its text, or the file to copy with its mode
    binds : folders of this machine it sees, too, and cannot write: path → folder

    Raises
    ------
    MachineError
        If it does not come up.
    """
    # Timers fetch packages and collect metrics; the tests need none.
    quiet = {"/etc/systemd/system/timers.target": Path("/dev/null"), "/etc/hostname": f"{name}\n"}
    with ExitStack() as stack:
        folder = stack.enter_context(_folder({**quiet, **files}))
        cgroups = stack.enter_context(_cgroups(name))
        nspawn = (
            *("systemd-nspawn", "--quiet", f"--directory={folder}/m/root", f"--machine={name}", "--boot"),
            *(f"--network-namespace-path={network}", "--register=no", "--keep-unit", "--link-journal=no"),
            # A fixed place: the checkout may well live under /tmp, which nspawn and the units' sandbox hide.
            f"--bind-ro={_REPO}:/srv/arpd",
            f"--bind-ro={sys.base_prefix}:{PYTHON}",
            *(f"--bind-ro={folder}:{path}" for path, folder in (binds or {}).items()),
            *("--console=pipe", "--", "systemd.unit=multi-user.target"),
        )
        again = ("env", f"again={_REBOOT}", "sh", "-c", _AGAIN, "sh")
        procs = "\n".join(f"{cgroup}/cgroup.procs" for cgroup in cgroups)
        command = ("sh", "-c", _MOVE_AND_EXEC, "sh", procs, *_on_overlay(folder, *again, *nspawn))
        console = folder / "console"
        with console.open("w") as log:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        stack.callback(_end, process)
        try:
            machine = Machine(_await_boot(process), process)
        except MachineError as error:
            raise MachineError(f"{name}: {error}; its console:\n{console.read_text()}") from None
        yield machine


def _await_boot(outside: subprocess.Popen[bytes], *, other_than: int | None = None) -> int:
    until_s = time.monotonic() + BOOT_S
    while time.monotonic() < until_s:
        if outside.poll() is not None:
            raise MachineError(f"systemd-nspawn ended with code {outside.returncode}")
        if (init := _init_of(outside)) not in (None, other_than):
            is_active = Machine(init, outside).call("systemctl", "is-active", "multi-user.target")
            if is_active.stdout.strip() == "active":
                return init
        time.sleep(0.1)
    raise MachineError(f"no multi-user.target after {BOOT_S:.0f} s")


def _init_of(outside: subprocess.Popen[bytes]) -> int | None:
    """Process id of the machine's systemd, None while there is none."""
    processes = [outside.pid]
    with suppress(OSError):
        for pid in processes:
            # Its ids here, in the namespace nspawn runs in, and inside, where only the machine's first process is 1.
            if re.search(r"^NSpid:\t\d+\t\d+\t1$", Path(f"/proc/{pid}/status").read_text(), re.MULTILINE):
                return pid
            processes += _children(pid)
    return None


def _children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def _end(outside: subprocess.Popen[bytes]) -> None:
    """Kill the machine's init: the kernel ends all inside with it, and nspawn tidies up after itself."""
    with suppress(ProcessLookupError):
        os.kill(_init_of(outside) or outside.pid, signal.SIGKILL)
    try:
        outside.wait(timeout=_GONE_S)
    except subprocess.TimeoutExpired:
        outside.kill()
        outside.wait()


@contextmanager
def _folder(files: Mapping[str, str | Path]) -> Iterator[Path]:
    """Lay the files out in a temporary folder, as `_on_overlay` wants it."""
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
    """Command line that runs ``argv`` where ``folder/m/root`` is this machine's files with the folder's on top."""
    # nspawn alone would outlive its parent, and systemd would outlive nspawn.
    namespaces = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc"]
    return ["setpriv", "--pdeathsig", "KILL", *namespaces, "sh", "-c", _MOUNT_AND_EXEC, "sh", str(folder), *argv]


@contextmanager
def _cgroups(name: str) -> Iterator[list[Path]]:
    """Make cgroups for one machine: nspawn gives all that start from the same cgroup the same ones."""
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
    until_s = time.monotonic() + _GONE_S
    while cgroup.exists():
        try:
            cgroup.rmdir()
        except OSError as error:  # a process that was just killed is in it a moment longer
            if time.monotonic() > until_s:
                raise MachineError(f"{cgroup} stays: {error}") from error
            time.sleep(0.05)
