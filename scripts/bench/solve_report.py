"""The results of `solve.py` for docs/results.md."""

from __future__ import annotations

from typing import Any

from scripts.bench.record import described
from scripts.bench.report import markdown_table

PAPER = "cvxpy, built anew"
_NAMES = {
    PAPER: "the paper's way: cvxpy, built for each solve, its default solver",
    "cvxpy, parameters": "cvxpy, parametrised (DPP)",
    "OSQP, direct": "OSQP, direct",
    "exact": "exact, whole numbers",
    "whole program, osqp": "*the whole program: (G1), (G2), rounding; osqp*",
    "whole program, exact": "*the whole program: (G1), (G2), rounding; exact*",
}
_SIDES = tuple(_NAMES)[:4]  # these solve the same problem, so that their times are comparable


def markdown(document: dict[str, Any]) -> str:
    """Return a row per way, a column per number of topics, and the memory of a process without ROS."""
    races, footprints = document["races"], document["footprints"]
    first, *others = (f"{race['topics']:,}" for race in races)
    rows = [[words, *(_cell(race, name) for race in races)] for name, words in _NAMES.items()]
    takes = ", ".join(
        f"{footprints[name]['peak_rss_bytes'] / 2**20:.0f} MiB with {name}" for name in sorted(footprints)
    )
    lean = [name for name, found in footprints.items() if not found["loads_cvxpy"]]
    memory = (
        f"Without ROS, a process that solves takes {takes}; {' and '.join(sorted(lean))} never import cvxpy "
        f"({described(document)})."
    )
    return "\n".join([*markdown_table("lr", ["median ms per re-solve", f"N = {first}", *others], rows), "", memory])


def _cell(race: dict[str, Any], name: str) -> str:
    spent_ms = race["median_s"][name] * 1e3
    text = f"{spent_ms:.0f}" if spent_ms >= 100.0 else f"{spent_ms:.3g}"
    if name in _SIDES and name != PAPER:
        times = race["median_s"][PAPER] / race["median_s"][name]
        text += f" ({times:.0f}×)" if times >= 1.0 else " (slower)"
    if wrong := race["failed_or_wrong"][name]:
        text += f", {wrong} of {race['instances']} off"
    return text
