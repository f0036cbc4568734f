"""A slow computer on a fast one: control groups that give every thread a slow core, and all of them four.

A quota for a whole group would let one thread run as fast as this machine, as long as the others rest. So each thread
has a group of its own with the quota of one core, below a group with the quota of all cores and a limit of memory.
"""

from __future__ import annotations

import os
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from arpd.model.errors import ArpdError
from scripts.bench.pi_boards import CORES, MEMORY_BYTES, Board

if TYPE_CHECKING:
    from types import TracebackType
    from typing import Self

ROOT = Path("/sys/fs/cgroup")
_SWEEP_S = 0.05  # how long a new thread may share the core of the thread that started it
_REMOVE_S = 5.0


class SlowComputer:
    """Processes on a board, while the ``with`` block lasts; they must have ended before its end.

    Parameters
    ----------
    board : none of them is limited on this machine itself
    name : of the group
    root : where the host has mounted its control groups, of version 1 or 2
    tasks : folder of all processes
    """

    def __init__(self, board: Board, name: str, *, root: Path = ROOT, tasks: Path = Path("/proc")) -> None:
        self.board = board
        self._tasks = tasks
        self.version = 1 if (root / "cpu/cgroup.procs").exists() else 2
        self._cpu = (root / "cpu" if self.version == 1 else root) / name
        self._memory = root / "memory" / name if self.version == 1 else self._cpu
        self._pids: dict[str, int] = {}
        self._threads: dict[int, Path] = {}
        self._stopping = threading.Event()
        self._sweeper = threading.Thread(target=self._keep_sweeping, name="sweeper", daemon=True)

    @property
    def is_limited(self) -> bool:
        """Whether the board is slower than this machine."""
        return self.board.share is not None

    def __enter__(self) -> Self:
        if self.is_limited:
            try:
                self._build()
            except OSError as error:
                raise ArpdError(f"cannot make control groups with quotas of CPU and memory: {error}") from error
            self._sweeper.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self.is_limited:
            return
        self._stopping.set()
        self._sweeper.join()
        until_s = time.monotonic() + _REMOVE_S
        for folder in dict.fromkeys((*self._threads.values(), self._cpu, self._memory)):
            while not _removed(folder) and time.monotonic() < until_s:
                time.sleep(0.05)  # the last thread is not quite gone

    def _build(self) -> None:
        if self.version == 2:
            _write(self._cpu.parent / "cgroup.subtree_control", "+cpu +memory")
        for folder in dict.fromkeys((self._cpu, self._memory)):
            folder.mkdir()
        self._limit(self._cpu, *self.board.quota(CORES))
        limit = "memory.limit_in_bytes" if self.version == 1 else "memory.max"
        _write(self._memory / limit, str(MEMORY_BYTES))

    def place(self, name: str, pid: int) -> None:
        """Move a process onto the board, with all threads that it will start."""
        if self.is_limited:
            for folder in dict.fromkeys((self._cpu, self._memory)):
                _write(folder / "cgroup.procs", str(pid))
            self._pids[name] = pid

    def throttled(self) -> dict[str, dict[int, int]]:
        """Return by process and thread the number of periods so far in which it used up its core."""
        return {
            name: {thread: _throttled(self._cpu / f"t{thread}") for thread in self._of(pid)}
            for name, pid in self._pids.items()
        }

    def sweep(self) -> None:
        """Give every thread a core of its own, and remove the cores of those that have ended."""
        alive = {thread for pid in self._pids.copy().values() for thread in self._of(pid)}
        for thread in alive - self._threads.keys():
            folder = self._cpu / f"t{thread}"
            with suppress(OSError):  # it has ended meanwhile
                folder.mkdir(exist_ok=True)
                self._threads[thread] = folder
                if self.version == 2:
                    _write(folder / "cgroup.type", "threaded")
                    _write(self._cpu / "cgroup.subtree_control", "+cpu")
                self._limit(folder, *self.board.quota())
                _write(folder / ("tasks" if self.version == 1 else "cgroup.threads"), str(thread))
        for thread in self._threads.keys() - alive:
            if _removed(self._threads[thread]):
                del self._threads[thread]

    def _keep_sweeping(self) -> None:
        while not self._stopping.wait(_SWEEP_S):
            self.sweep()

    def _of(self, pid: int) -> list[int]:
        try:
            return [int(entry.name) for entry in (self._tasks / str(pid) / "task").iterdir()]
        except OSError:
            return []

    def _limit(self, folder: Path, quota_us: int, period_us: int) -> None:
        if self.version == 1:
            _write(folder / "cpu.cfs_period_us", str(period_us))
            _write(folder / "cpu.cfs_quota_us", str(quota_us))
        else:
            _write(folder / "cpu.max", f"{quota_us} {period_us}")


def available() -> tuple[bool, str]:
    """Return whether this host lets this process make a slow computer, by making one, and if not, the reason."""
    try:
        with SlowComputer(Board(name="probe", share=1.0), f"arpd-probe-{os.getpid()}"):
            return True, ""
    except ArpdError as error:
        return False, str(error)


def _throttled(folder: Path) -> int:
    """Return the number of periods in which a group used up its quota."""
    try:
        lines = (folder / "cpu.stat").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return int(dict(line.split() for line in lines)["nr_throttled"])


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="ascii")


def _removed(folder: Path) -> bool:
    """Return whether a group is gone."""
    try:
        folder.rmdir()
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return True
