"""A slow computer on a fast one: control groups give every thread the core of a Raspberry Pi, and all of them four.

A quota for a whole group would let one thread run as fast as this machine, as long as the others rest. So each thread
has a group of its own with the quota of one core, below a group with the quota of all cores and a limit of memory.

How slow a core is follows from published figures. A Raspberry Pi 4 takes 79.2 s for a benchmark in pure Python
(github.com/alexdedyura/cpu-benchmark, README.md at 65b79fb); this machine runs the same arithmetic. A Raspberry Pi 5's
core is as much faster as 7-Zip on one thread says: 2967 and 1769 MIPS (github.com/ThomasKaiser/sbc-bench).
"""

from __future__ import annotations

import math
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from arpd.model.errors import ArpdError

if TYPE_CHECKING:
    from types import TracebackType

CORES, MEMORY_BYTES = 4, 2**30
_PI_4_S, _PI_5_TIMES = 79.216, 2967 / 1769
_ROOT = Path("/sys/fs/cgroup")
_PERIOD_US, _LEAST_QUOTA_US = 5000, 1000  # the kernel takes no quota below a millisecond
_SWEEP_S = 0.05  # how long a new thread may share the core of the thread that started it
_REMOVE_S = 5.0
#: A thirtieth of the benchmark's work; its loops are a module's own, whose names are slower than a function's.
_REFERENCE = """
import time
began_s = time.process_time()
for _ in range(333):
    for x in range(1, 1000):
        3.141592 * 2**x
    for x in range(1, 10_000):
        float(x) / 3.141592
    for x in range(1, 10_000):
        float(3.141592) / x
print((time.process_time() - began_s) * 10_000 / 333)
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class Board:
    """A computer.

    Parameters
    ----------
    share : speed of its core beside one of this machine (0..1)
    """

    name: str
    share: float

    def quota(self, cores: int = 1) -> tuple[int, int]:
        """Return quota and period that give cores of this board (us).

        The period is about the least that the kernel's tick of 4 ms and the least quota allow: a loop on a Pi 4's core
        runs for 1 ms and waits for 4, and arpd's ticks of 100 ms see a slow core.
        """
        period_us = max(_PERIOD_US, math.ceil(_LEAST_QUOTA_US / self.share))
        return round(cores * self.share * period_us), period_us


def boards() -> list[Board]:
    """Return the boards, from the shortest of five runs of the reference."""
    command = [sys.executable, "-I", "-c", _REFERENCE]
    times = [float(subprocess.run(command, capture_output=True, check=True).stdout) for _ in range(5)]
    pi_4 = min(1.0, min(times) / _PI_4_S)
    pi_5 = min(1.0, pi_4 * _PI_5_TIMES)
    return [Board(name="Pi 4", share=pi_4), Board(name="Pi 5", share=pi_5)]


class SlowComputer:
    """Processes on a board, while the ``with`` block lasts; they must have ended before its end.

    Parameters
    ----------
    name : of the group, below control groups of version 1 or 2
    """

    def __init__(self, board: Board, name: str) -> None:
        self.board = board
        self.version = 1 if (_ROOT / "cpu/cgroup.procs").exists() else 2
        self._cpu = (_ROOT / "cpu" if self.version == 1 else _ROOT) / name
        self._memory = _ROOT / "memory" / name if self.version == 1 else self._cpu
        self._pids: dict[str, int] = {}
        self._threads: dict[int, Path] = {}
        self._stopping = threading.Event()
        self._sweeper = threading.Thread(target=self._keep_sweeping, name="sweeper", daemon=True)

    def __enter__(self) -> Self:
        try:
            self._build()
        except OSError as error:
            raise ArpdError(f"cannot make control groups with quotas of CPU and memory: {error}") from error
        self._sweeper.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        self._sweeper.join()
        until_s = time.monotonic() + _REMOVE_S
        for folder in dict.fromkeys((*self._threads.values(), self._cpu, self._memory)):
            while folder.exists() and time.monotonic() < until_s:  # the last thread may not be quite gone
                with suppress(OSError):
                    folder.rmdir()
                    break
                time.sleep(0.05)

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
        for folder in dict.fromkeys((self._cpu, self._memory)):
            _write(folder / "cgroup.procs", str(pid))
        self._pids[name] = pid

    def _keep_sweeping(self) -> None:
        """Give every thread a core of its own, and remove the cores of those that have ended."""
        while not self._stopping.wait(_SWEEP_S):
            alive = {thread for pid in self._pids.copy().values() for thread in _threads_of(pid)}
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
                with suppress(OSError):
                    self._threads[thread].rmdir()
                    del self._threads[thread]

    def _limit(self, folder: Path, quota_us: int, period_us: int) -> None:
        if self.version == 1:
            _write(folder / "cpu.cfs_period_us", str(period_us))
            _write(folder / "cpu.cfs_quota_us", str(quota_us))
        else:
            _write(folder / "cpu.max", f"{quota_us} {period_us}")


def _threads_of(pid: int) -> list[int]:
    try:
        return [int(entry.name) for entry in Path(f"/proc/{pid}/task").iterdir()]
    except OSError:
        return []


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="ascii")
