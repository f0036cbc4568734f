"""Show the plans of `arpd solve` for the demo robot at two capacities, for docs/results.md; nothing is measured."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

from scripts.bench.record import REPO

CONFIG = REPO / "scripts/robot/arpd.yaml"
CAPACITIES = ("5", "0.5")


def markdown() -> str:
    """Return a row per topic: its wishes, and its rate and what bounds it at each capacity."""
    plans = [planned(f"{capacity}mbit") for capacity in CAPACITIES]
    heads = " | ".join(f"at {capacity} Mbit/s | bound by" for capacity in CAPACITIES)
    lines = [
        f"| topic | weight | floor Hz | desired Hz | {heads} |",
        "|---|---:|---:|---:|" + "---:|---|" * len(CAPACITIES),
    ]
    for name, first in plans[0].items():
        wishes = f"{first['weight']:g} | {first['min_rate_hz']:g} | {first['desired_rate_hz']:g}"
        rates = [f"{plan[name]['rate_hz']:.3g} | {plan[name]['rate_binding'].replace('_', ' ')}" for plan in plans]
        lines.append(f"| `{name}` | {wishes} | {' | '.join(rates)} |")
    return "\n".join(lines)


def planned(capacity: str) -> dict[str, dict[str, Any]]:
    """Return the rows of ``arpd solve`` for the demo robot, by topic."""
    solved = subprocess.run(
        [sys.executable, "-m", "arpd.cli", "solve", "--config", CONFIG, "--capacity", capacity, "--json"],
        cwd=REPO,
        stdout=subprocess.PIPE,
        check=True,
    )
    return {row["topic"]: row for row in json.loads(solved.stdout)["topics"]}
