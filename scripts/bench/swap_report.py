"""The results of `swap.py`, as text and for docs/results.md: where a way does worse than no swaps at all."""

from __future__ import annotations

from math import sqrt
from statistics import quantiles
from typing import TYPE_CHECKING, Any

from arpd.model.wire import MTU_BYTES
from scripts.bench.record import described

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

STILL, ADAPTIVE, RECREATE = WAYS = ("no swaps", "adaptive", "destroy+create")
EVENTS = ("lost", "doubled", "reordered")
PROMISED_DEPTH = 10

Ways = dict[str, dict[str, Any]]


def beyond(ways: Mapping[str, Mapping[str, Any]], way: str) -> list[str]:
    """Return the events that a way shows more often than the baseline, beyond the scatter of the baseline's own."""
    found = []
    longer = ways[way]["expected"] / max(1, ways[STILL]["expected"])  # a phase with slow swaps has more samples
    for event in EVENTS:
        ours, still = ways[way][event], ways[STILL][event] * longer
        if ours > still + (3 * sqrt(ours + still) if still else 0):
            found.append(event)
    return found


def promised(cells: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the cells that are deep enough to lose nothing."""
    return [cell for cell in cells if cell["depth"] >= PROMISED_DEPTH]


def verdict(cells: Sequence[dict[str, Any]]) -> list[str]:
    """Return for both ways in how many cells they are worse than the baseline, and their losses."""
    lines = []
    deep = promised(cells)
    for way in (ADAPTIVE, RECREATE):
        broken = sum(bool(beyond(cell["ways"], way)) for cell in deep)
        sums = ", ".join(
            f"{_sum(deep, way, event)} {event} ({_sum(deep, STILL, event)} without swaps)" for event in EVENTS
        )
        lines.append(
            f"{way}: {broken} of {len(deep)} cells with depth >= {PROMISED_DEPTH} are worse than the baseline; "
            f"{_sum(deep, way, 'swaps')} swaps: {sums}"
        )
    return lines


def markdown(document: dict[str, Any]) -> str:
    """Return two bullets: the losses beside the same run without swaps, and the cost of swaps."""
    cells = document["cells"]
    deep = promised(cells)
    worse = [cell for cell in deep if beyond(cell["ways"], ADAPTIVE)]
    recreated = [cell for cell in deep if beyond(cell["ways"], RECREATE)]
    losses = sorted({cell["setting"]["loss"] for cell in cells})
    first = (
        f"- Swaps beside the same run without swaps (`scripts/bench/swap.py`, {_sum(deep, ADAPTIVE, 'swaps')} swaps in "
        f"{len(deep)} combinations with DEPTH ≥ {PROMISED_DEPTH}; UDP on one host and a link, "
        f"{_list([f'{100 * loss:g}' for loss in losses])} % loss, {_range(cells, 'rate_hz')} Hz, "
        f"{_range(cells, 'readers')} readers; {described(document)}): "
        f"{_sum(deep, ADAPTIVE, 'doubled') or 'nothing'} doubled, "
        f"{_sum(deep, ADAPTIVE, 'reordered') or 'nothing'} reordered, and more lost than without swaps in "
        f"{len(worse) or 'none'} of them; destroy-then-create lost more in {len(recreated)}, "
        f"{sum(cell['ways'][RECREATE]['lost'] for cell in recreated):,} samples."
    )
    if worse:
        first += " Worse: " + "; ".join(map(_losses, worse)) + "."
    if any(cell["payload_bytes"] > MTU_BYTES for cell in worse):
        first += " See the point on samples above one MTU."
    return "\n".join([first, _costs(cells)])


def _losses(cell: dict[str, Any]) -> str:
    ways, loss = cell["ways"], cell["setting"]["loss"]
    return (
        f"{cell['payload_bytes']:,} bytes at {cell['rate_hz']} Hz, DEPTH {cell['depth']}, {100 * loss:g} % loss, "
        f"where {ways[ADAPTIVE]['lost']:,} of {ways[ADAPTIVE]['expected']:,} samples were lost, without "
        f"swaps {ways[STILL]['lost']:,} of {ways[STILL]['expected']:,} and by destroy-then-create "
        f"{ways[RECREATE]['lost']:,} of {ways[RECREATE]['expected']:,}"
    )


def _costs(cells: Sequence[dict[str, Any]]) -> str:
    slow = [cell["ways"][ADAPTIVE] for cell in cells if cell["rate_hz"] <= 100 and cell["payload_bytes"] <= MTU_BYTES]
    spent_ms = [1e3 * tally["cpu_s"] / tally["swaps"] for tally in slow if tally["swaps"]]
    text = "- A swap takes the time discovery takes and three seconds more"
    if len(spent_ms) > 1:
        low, _, high = quantiles(spent_ms, n=4)
        text += f", and, at up to 100 Hz, {low:.0f} to {high:.0f} ms of CPU"
        text += f" (the middle half of {len(spent_ms)} combinations)"
    gaps = [
        f"{max(c['ways'][ADAPTIVE]['gap_s'] for c in group) * 1e3:.0f} ms {where} (without swaps "
        f"{max(c['ways'][STILL]['gap_s'] for c in group) * 1e3:.0f} ms)"
        for where, group in (
            ("without loss", [cell for cell in _often(cells) if not cell["setting"]["loss"]]),
            ("with loss", [cell for cell in _often(cells) if cell["setting"]["loss"]]),
        )
        if group
    ]
    if gaps:
        text += f". Where samples come at 100 Hz and more, the longest gap between two of them was {' and '.join(gaps)}"
    return text + "."


def _often(cells: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return [cell for cell in cells if cell["rate_hz"] >= 100]


def _sum(cells: Sequence[dict[str, Any]], way: str, key: str) -> int:
    return sum(cell["ways"][way][key] for cell in cells)


def _range(cells: Sequence[dict[str, Any]], key: str) -> str:
    values = sorted({cell[key] for cell in cells})
    return f"{values[0]}" if len(values) == 1 else f"{values[0]} to {values[-1]}"


def _list(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
