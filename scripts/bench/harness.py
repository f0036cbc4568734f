"""What every run notes: its conditions, and whether the machine was its own."""

from __future__ import annotations

import os
import platform
import subprocess
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import psutil

from scripts.bench.report import REPO

if TYPE_CHECKING:
    from collections.abc import Iterator

_MOST_FOREIGN = 0.05  # of the machine's processors


def conditions() -> dict[str, Any]:
    """Return the date, the commit, the machine and its load, as they are now."""

    def git(*argv: str) -> str:  # nothing outside a clone, and without git
        with suppress(OSError):
            return subprocess.run(["git", *argv], cwd=REPO, capture_output=True, text=True, check=False).stdout.strip()
        return ""

    tree = ("arpd", "scripts", ":!scripts/bench/results")
    files = [each for each in git("ls-tree", "-r", "HEAD", *tree[:2]).splitlines() if "/bench/results/" not in each]
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "commit": git("rev-parse", "HEAD")[:12],
        "tree": sha256("\n".join(files).encode()).hexdigest()[:12] if files else "",  # of all that is measured
        "is_modified": bool(git("status", "--porcelain", "--untracked-files=no", "--", *tree)),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "load": round(os.getloadavg()[0], 1),
    }


@contextmanager
def watched() -> Iterator[dict[str, Any]]:
    """Yield conditions; they say ``void`` after the block if something else used the machine meanwhile."""
    noted = conditions()
    before, before_s = psutil.cpu_times(), _own_s()
    yield noted
    after, own_s = psutil.cpu_times(), _own_s() - before_s
    busy_s = sum(getattr(after, kind) - getattr(before, kind) for kind in ("user", "nice", "system"))
    foreign = (busy_s - own_s) / max(1e-9, sum(after) - sum(before))
    if foreign > _MOST_FOREIGN:
        noted["void"] = f"other processes used {100 * foreign:.0f} % of the machine"


def _own_s() -> float:
    """Return the CPU time of this process and of all its descendants, also of those that have ended (s)."""
    total = 0.0
    for process in (psutil.Process(), *psutil.Process().children(recursive=True)):
        with suppress(psutil.Error):
            total += sum(process.cpu_times()[:4])  # its own, and that of the children it has waited for
    return total
