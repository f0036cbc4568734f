"""The network namespaces of simulated links: ownership, work inside, and removal."""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

from pyroute2 import netns

from arpd.model.errors import LinkError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

T = TypeVar("T")
HostName = Literal["robot", "base"]
HOST_NAMES: tuple[HostName, HostName] = ("robot", "base")

RUN_DIR = Path("/run/arpd-simlink")
NETNS_DIR = Path("/run/netns")

_RUN_ID = re.compile(r"[A-Za-z0-9_.-]{1,40}")
_NAMESPACE = re.compile(r"arpd-(?P<run_id>[A-Za-z0-9_.-]{1,40})-(?:robot|base)")
_GRACE_S = 2.0
_POLL_S = 0.02
_TICK_NS = 10**9 // os.sysconf("SC_CLK_TCK")


def namespace_of(run_id: str, host: HostName) -> str:
    """Return the name of a host's network namespace."""
    return f"arpd-{run_id}-{host}"


def executable(name: str) -> str:
    """Return the path of a system tool, also from the sbin folders, which a plain user's PATH lacks."""
    path = shutil.which(name, path=os.pathsep.join((os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin")))
    if path is None:
        raise LinkError(f"{name}: command not found; on Debian and Ubuntu: apt install iproute2 nftables util-linux")
    return path


def inside(namespace: str, work: Callable[[], T]) -> T:
    """Run ``work`` inside a network namespace and return its result.

    A namespace belongs to a thread, so a thread of its own enters it for this call; the caller's threads stay outside.
    """

    def enter_then_work() -> T:
        netns.setns(namespace, flags=0)
        return work()

    with ThreadPoolExecutor(max_workers=1) as pool:
        return pool.submit(enter_then_work).result()


def claim(run_id: str) -> None:
    """Record this process as the owner of a run and create its two namespaces.

    Raises
    ------
    LinkError
        If the run id is malformed, or a living process owns it.
    """
    if not _RUN_ID.fullmatch(run_id):
        raise LinkError(f"run id {run_id!r}: use 1 to 40 letters, digits, '_', '.' or '-'")
    try:
        with _registry_locked():
            _demolish_stale()
            if (owner := _owner(run_id)) is not None:
                raise LinkError(f"run id {run_id!r} is in use by process {owner}; choose another or end that process")
            # Written before the first namespace exists, so that a crash leaves a record of its owner.
            record = {"pid": os.getpid(), "start_ticks": _start_ticks(os.getpid())}
            _record_path(run_id).write_text(json.dumps(record), encoding="utf-8")
        try:
            for host in HOST_NAMES:
                netns.create(namespace_of(run_id, host))
        except BaseException:
            release(run_id)
            raise
    except OSError as error:
        raise LinkError(
            f"cannot make network namespaces: {error}; this needs root (see `scripts/simlink --help`)"
        ) from error


def release(run_id: str) -> None:
    """End the processes in a run's namespaces, then remove the namespaces and the record of their owner."""
    with _registry_locked():
        _demolish(run_id)


def cleanup_stale() -> list[str]:
    """Remove the namespaces of runs whose owner is dead, with the processes inside; return their run ids."""
    with _registry_locked():
        return _demolish_stale()


@contextmanager
def _registry_locked() -> Iterator[None]:
    # Two runs that start at once both clean up first; without the lock, one could remove the other's new namespaces.
    RUN_DIR.mkdir(parents=True, exist_ok=True)
    with (RUN_DIR / "lock").open("w", encoding="utf-8") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _demolish_stale() -> list[str]:
    named = {match["run_id"] for name in netns.listnetns() if (match := _NAMESPACE.fullmatch(name))}
    recorded = {path.stem for path in RUN_DIR.glob("*.json")}
    stale = sorted(run_id for run_id in named | recorded if _owner(run_id) is None)
    for run_id in stale:
        _demolish(run_id)
    return stale


def _demolish(run_id: str) -> None:
    namespaces = [namespace_of(run_id, host) for host in HOST_NAMES]
    _end_processes(namespaces)
    for namespace in set(namespaces) & set(netns.listnetns()):
        netns.remove(namespace)
    _record_path(run_id).unlink(missing_ok=True)


def _end_processes(namespaces: list[str]) -> None:
    """Send SIGTERM to all processes in the namespaces, and SIGKILL after a grace period."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        for pid in _pids_inside(namespaces):
            try:
                os.kill(pid, number)
            except ProcessLookupError:
                continue
        deadline_s = time.monotonic() + _GRACE_S
        while _pids_inside(namespaces):
            if time.monotonic() > deadline_s:
                break
            time.sleep(_POLL_S)
        else:
            return


def _pids_inside(namespaces: list[str]) -> list[int]:
    inhabitants = netns.ns_pids()
    return [pid for namespace in namespaces for pid in inhabitants.get(namespace, []) if pid != os.getpid()]


def _record_path(run_id: str) -> Path:
    return RUN_DIR / f"{run_id}.json"


def _owner(run_id: str) -> int | None:
    """Return the process that owns a run, None if it is gone; a later process of its id has another start time."""
    try:
        record = json.loads(_record_path(run_id).read_text(encoding="utf-8"))
        pid, start_ticks = int(record["pid"]), int(record["start_ticks"])
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        return None
    started = _start_ticks(pid)
    # One tick apart where either of the two was rounded in another time namespace.
    return pid if started is not None and abs(started - start_ticks) <= 1 else None


def _start_ticks(pid: int) -> int | None:
    """Return the start of a process in clock ticks since boot, None if it does not exist or is a zombie."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    # The second field is the command in parentheses; it may hold spaces and parentheses.
    fields = stat.rpartition(")")[2].split()
    if fields[0] in "ZX":
        return None
    # The kernel shows it in 64 bits, and moved by the offset of the reader's time namespace (time_namespaces(7)).
    return (int(fields[19]) * _TICK_NS - _boot_offset_ns()) % 2**64 // _TICK_NS


def _boot_offset_ns() -> int:
    """Return the offset of this time namespace's clock since boot (ns)."""
    try:
        lines = Path("/proc/self/timens_offsets").read_text(encoding="ascii").splitlines()
    except OSError:  # a kernel without time namespaces
        return 0
    offsets = {name: 10**9 * int(seconds) + int(rest) for name, seconds, rest in map(str.split, lines)}
    return offsets.get("boottime", 0)
