"""What a benchmark leaves behind: its document with the conditions it ran under, and where that goes."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

REPO = Path(__file__).resolve().parents[2]
RESULTS = Path(__file__).parent / "results"


def conditions() -> dict[str, Any]:
    """Return what was measured, when and on what, as it is now."""

    def git(*argv: str) -> str:
        return subprocess.run(["git", *argv], cwd=REPO, capture_output=True, text=True, check=False).stdout.strip()

    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": git("rev-parse", "HEAD"),
        "is_modified": bool(git("status", "--porcelain", "--untracked-files=no")),
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, {platform.system()} {platform.release()}",
        "cpu_count": os.cpu_count(),
        "load_average": os.getloadavg(),
    }


def described(document: dict[str, Any]) -> str:
    """Say in a few words when and on what a document was measured; of one without conditions, that it is not noted.

    The load is that of the minute before the start, hence other work than the benchmark's own.
    """
    if not (noted := document.get("conditions")):
        return "machine and load not noted"
    machine, load = noted["machine"].partition(",")[0], noted["load_average"][0]
    return f"{noted['date'][:10]}, {machine}, {noted['cpu_count']} cores, load average {load:.1f} before"


def target(chosen: Path | None, name: str, *, is_partial: bool) -> Path | None:
    """Return where a file of results goes: where it was asked for, else into results/ when the run was a whole one."""
    return chosen or (None if is_partial else RESULTS / name)


def keep(document: dict[str, Any], path: Path | None) -> None:
    """Keep a document where it goes, if anywhere; what is not a number is refused.

    Raises
    ------
    ValueError
        If a figure is infinite or not a number: JSON has neither.
    """
    if path is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    print(path)
