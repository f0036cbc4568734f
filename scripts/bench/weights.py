"""The plans of `arpd solve` for the demo robot at two capacities, for docs/results.md; nothing is measured."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING, Any

from scripts.bench.record import REPO
from scripts.bench.report import table

if TYPE_CHECKING:
    from scripts.bench.report import Column

CONFIG = REPO / "scripts/robot/arpd.yaml"
CAPACITIES = ("5", "0.5")


def report() -> str:
    rows = list(zip(*(planned(f"{capacity}mbit") for capacity in CAPACITIES), strict=True))
    return table(
        rows,
        ("topic", lambda row: f"`{row[0]['topic']}`"),
        ("weight", lambda row: row[0]["weight"], "{:g}"),
        ("floor Hz", lambda row: row[0]["min_rate_hz"], "{:g}"),
        ("desired Hz", lambda row: row[0]["desired_rate_hz"], "{:g}"),
        *(column for at, capacity in enumerate(CAPACITIES) for column in _columns(at, capacity)),
    )


def _columns(at: int, capacity: str) -> list[Column]:
    return [
        (f"at {capacity} Mbit/s", lambda row: row[at]["rate_hz"], "{:.3g}"),
        ("bound by", lambda row: row[at]["rate_binding"].replace("_", " ")),
    ]


def planned(capacity: str) -> list[dict[str, Any]]:
    """Return the rows of ``arpd solve`` for the demo robot."""
    command = [sys.executable, "-m", "arpd.cli", "solve", "--config", str(CONFIG), "--capacity", capacity, "--json"]
    solved = subprocess.run(command, cwd=REPO, stdout=subprocess.PIPE, check=True)
    topics: list[dict[str, Any]] = json.loads(solved.stdout)["topics"]
    return topics
