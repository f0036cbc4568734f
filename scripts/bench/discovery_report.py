"""The results of `discovery.py` for docs/results.md."""

from __future__ import annotations

from typing import Any

from scripts.bench.discovery_packets import KINDS
from scripts.bench.record import described
from scripts.bench.report import markdown_table

PLAIN, RELAY = SIDES = ("plain ROS 2", "two-ended relay")


def markdown(document: dict[str, Any]) -> str:
    """Return a table of what the link carries at rest, and a comparison at the largest number of nodes."""
    cells = sorted(document["cells"], key=lambda cell: (cell["nodes"], SIDES.index(cell["side"])))
    first = cells[0]
    head = ["nodes", "", "participants", "packets/s", "kB/s", *KINDS, "MB of the start", "topics known after s"]
    about = (
        f"`scripts/bench/discovery.py` ({described(document)}), a link of "
        f"{first['link_bytes_per_second'] * 8e-6:.0f} Mbit/s at rest for {first['span_s']:.0f} s; both directions "
        "together, with Ethernet headers. Participants are those of DDS that sent a packet over the link. Each kind "
        "has packets per second (kB per second). The start is that of all nodes at once, and lasts until the link is "
        "at rest; the far node knows every topic after the time in the last column."
    )
    return "\n".join([about, "", *markdown_table("rlr", head, map(_row, cells)), *_comparison(cells)])


def rates(cell: dict[str, Any], kind: str | None = None) -> tuple[float, float]:
    """Return packets and bytes per second of a kind, or of all."""
    flows = [flow for flow in cell["flows"] if kind in (None, flow["kind"])]
    packets, sizes = (sum(flow[what] for flow in flows) for what in ("packets", "bytes"))
    return packets / cell["span_s"], sizes / cell["span_s"]


def _row(cell: dict[str, Any]) -> list[str]:
    packets, size = rates(cell)
    steady = "" if cell["is_steady"] else " (not steady)"
    return [
        str(cell["nodes"]),
        f"{cell['side']}{steady}",
        str(len(cell["participants"])),
        f"{packets:.1f}",
        f"{size * 1e-3:.2f}",
        *(_pair(*rates(cell, kind)) for kind in KINDS),
        f"{cell['joined_bytes'] * 1e-6:.2f}",
        f"{cell['discovered_s']:.1f}",
    ]


def _pair(packets: float, size: float) -> str:
    return f"{packets:.1f} ({size * 1e-3:.2f})" if packets else "0"


def _comparison(cells: list[dict[str, Any]]) -> list[str]:
    """Compare the sides at the largest number of nodes, or say which one is missing."""
    most = max(cell["nodes"] for cell in cells)
    both = {cell["side"]: rates(cell) for cell in cells if cell["nodes"] == most}
    if missing := [side for side in SIDES if side not in both]:
        return ["", f"With {most} nodes, this is not measured yet: {missing[0]}."]
    before, after = both[PLAIN], both[RELAY]
    text = (
        f"With {most} nodes the two-ended relay puts {after[0]:.1f} packets and {after[1] * 1e-3:.2f} kB per second on "
        f"the link at rest, arpd's reports and probes included; plain ROS 2 puts {before[0]:.1f} and "
        f"{before[1] * 1e-3:.2f} kB."
    )
    return ["", text]
