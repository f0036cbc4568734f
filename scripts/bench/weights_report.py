"""The plans of `arpd solve` for the demo robot at two capacities, for docs/results.md; nothing is measured."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

from scripts.bench.record import REPO
from scripts.bench.report import markdown_table

CONFIG = REPO / "scripts/robot/arpd.yaml"
CAPACITIES = ("5", "0.5")


def markdown() -> str:
    """Return a row per topic: its preferences, and its rate and the bound of its rate at each capacity."""
    plans = [planned(f"{capacity}mbit") for capacity in CAPACITIES]
    head, rows = ["topic", "weight", "floor Hz", "desired Hz"], []
    for capacity in CAPACITIES:
        head += [f"at {capacity} Mbit/s", "bound by"]
    for name, first in plans[0].items():
        row = [f"`{name}`", *(f"{first[key]:g}" for key in ("weight", "min_rate_hz", "desired_rate_hz"))]
        for plan in plans:
            row += [f"{plan[name]['rate_hz']:.3g}", plan[name]["rate_binding"].replace("_", " ")]
        rows.append(row)
    return "\n".join(markdown_table("lrrr" + "rl" * len(CAPACITIES), head, rows))


def planned(capacity: str) -> dict[str, dict[str, Any]]:
    """Return the rows of ``arpd solve`` for the demo robot, by topic."""
    command = [sys.executable, "-m", "arpd.cli", "solve", "--config", str(CONFIG), "--capacity", capacity, "--json"]
    solved = subprocess.run(command, cwd=REPO, stdout=subprocess.PIPE, check=True)
    return {row["topic"]: row for row in json.loads(solved.stdout)["topics"]}
