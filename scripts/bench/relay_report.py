"""The results of `relay.py` for docs/results.md."""

from __future__ import annotations

from typing import Any

from scripts.bench.record import described

TARGET = 1.25


def markdown(document: dict[str, Any]) -> str:
    """Return a bullet with the range of the ratios, and every cell above the target."""
    cells = sorted(document["cells"], key=lambda cell: cell["ratio"])
    above = [cell for cell in cells if cell["ratio"] > TARGET]
    within = [cell["ratio"] for cell in cells if cell["ratio"] <= TARGET]
    text = "- The relay costs "
    if within:
        text += (
            f"{within[0]:.2f} to {within[-1]:.2f} times the CPU per message of a ten-line relay on the better executor"
            f" in {len(within)} of {len(cells)} combinations of payload and topics"
        )
    if above:
        text += (" and " if within else "") + "; ".join(
            f"{cell['ratio']:.2f} times with {cell['topics']} topic{'s' * (cell['topics'] != 1)} of "
            f"{cell['payload_bytes']:,} bytes"
            for cell in above
        )
    return f"{text} (`scripts/bench/relay.py`; {described(document)})."
