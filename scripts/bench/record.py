"""The document of a benchmark: its conditions, the options that say where it goes, and its files."""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

REPO = Path(__file__).resolve().parents[2]
RESULTS = Path(__file__).parent / "results"


def conditions() -> dict[str, Any]:
    """Return the date, the commit and the machine, as they are now."""

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
    """Return a document's conditions in a few words.

    The load is the average of the minute before the start, so the benchmark itself is not in it.
    """
    if not (noted := document.get("conditions")):
        return "machine and load not noted"
    machine, load = noted["machine"].partition(",")[0], noted["load_average"][0]
    return f"{noted['date'][:10]}, {machine}, {noted['cpu_count']} cores, load average {load:.1f} before"


def options_of(about: str | None, name: str, *, quick: str, has_plot: bool = False) -> argparse.ArgumentParser:
    """Return a parser with the options of every benchmark: --quick, --json and, with a picture, --plot.

    Parameters
    ----------
    about : help text of the benchmark
    name : stem of its files in results/
    quick : help text of --quick
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--json", type=Path, metavar="FILE", help=f"default results/{name}.json")
    if has_plot:
        parser.add_argument("--plot", type=Path, metavar="FILE", help=f"default results/{name}.png")
    return parser


def target(chosen: Path | None, name: str, *, is_partial: bool) -> Path | None:
    """Return the path of a file of results: the chosen one, else in results/ if the run was complete."""
    return chosen or (None if is_partial else RESULTS / name)


def keep(
    document: dict[str, Any],
    options: argparse.Namespace,
    name: str,
    *,
    is_partial: bool,
    draw: Callable[[Path], object] | None = None,
) -> None:
    """Write a benchmark's document and its picture, each to its `target`.

    Parameters
    ----------
    options : as the parser of `options_of` returns them
    draw : draws the picture into a file
    """
    write(document, target(options.json, f"{name}.json", is_partial=is_partial))
    if draw and (path := target(options.plot, f"{name}.png", is_partial=is_partial)):
        draw(path)


def write(document: dict[str, Any], path: Path | None) -> None:
    """Write a document to a file; do nothing without one.

    Raises
    ------
    ValueError
        If a figure is infinite or not a number: JSON has neither.
    """
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        print(path)


def read(path: Path) -> dict[str, Any]:
    """Return the document in a file."""
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return document
