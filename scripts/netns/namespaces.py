"""The network namespaces of simulated links: ownership, work inside, and removal."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TextIO, TypeVar

from pyroute2 import netns

from arpd.model.errors import LinkError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

T = TypeVar("T")
HostName = Literal["robot", "base"]
HOST_NAMES: tuple[HostName, HostName] = ("robot", "base")

RUN_DIR = Path("/run/arpd-links")
NETNS_DIR = Path("/run/netns")

_NAMESPACE = re.compile(r"simlink-(?P<run_id>[A-Za-z0-9_.-]{1,40})-(?:robot|base|middle)")
_GRACE_S = 2.0
_POLL_S = 0.02
#: Locked records of the runs that this process owns; the kernel releases them if it dies.
_RECORDS: dict[str, TextIO] = {}


def namespace_of(run_id: str, host: HostName | Literal["middle"]) -> str:
    """Return the name of the network namespace of a host, or of what is between them."""
    return f"simlink-{run_id}-{host}"


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


def claim(run_id: str, namespaces: Sequence[str]) -> None:
    """Record this process as the owner of a run and create its namespaces.

    Raises
    ------
    LinkError
        If the run id is malformed, or a living process owns it.
    """
    if not _NAMESPACE.fullmatch(namespace_of(run_id, "robot")):
        raise LinkError(f"run id {run_id!r}: use 1 to 40 letters, digits, '_', '.' or '-'")
    try:
        with _registry_locked():
            _demolish_stale()
            if (owner := _owner(run_id)) is not None:
                raise LinkError(f"run id {run_id!r} is in use by process {owner}; choose another or end that process")
            _RECORDS[run_id] = record = _record_path(run_id).open("w", encoding="utf-8")
            fcntl.flock(record, fcntl.LOCK_EX)
            print(os.getpid(), file=record, flush=True)
        try:
            for namespace in namespaces:
                netns.create(namespace)
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
    recorded = {path.stem for path in RUN_DIR.glob("*.pid")}
    stale = sorted(run_id for run_id in named | recorded if _owner(run_id) is None)
    for run_id in stale:
        _demolish(run_id)
    return stale


def _demolish(run_id: str) -> None:
    own = {namespace_of(run_id, "robot"), namespace_of(run_id, "base"), namespace_of(run_id, "middle")}
    namespaces = sorted(own & set(netns.listnetns()))
    _end_processes(namespaces)
    for namespace in namespaces:
        netns.remove(namespace)
    _record_path(run_id).unlink(missing_ok=True)
    if (record := _RECORDS.pop(run_id, None)) is not None:
        record.close()


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
    return RUN_DIR / f"{run_id}.pid"


def _owner(run_id: str) -> str | None:
    """Return the process that owns a run, None if it is gone."""
    try:
        with _record_path(run_id).open(encoding="utf-8") as record:
            fcntl.flock(record, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except FileNotFoundError:
        return None
    except BlockingIOError:
        return _record_path(run_id).read_text("utf-8").strip()
    return None
