"""A row of samples as one line of characters."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

BLOCKS = "▁▂▃▄▅▆▇█"
ASCII = "_.-:=+*#"


def sparkline(
    samples: Sequence[float | None],
    columns: int,
    *,
    pick: Callable[[Iterable[float]], float],
    highest: float | None = None,
    levels: str = BLOCKS,
) -> str:
    """Draw samples in so many columns, from 0 to the highest; a blank where there was nothing.

    Parameters
    ----------
    pick : which of the samples that share a column stands for them: the worst of them, such as ``max`` for a delay
    highest : what reaches the top, None = the highest sample
    levels : characters from the lowest to the highest
    """
    known = [sample for sample in samples if sample is not None]
    top = highest if highest is not None else max(known, default=0.0)
    columns = min(columns, len(samples))
    drawn = []
    for column in range(columns):
        share = samples[column * len(samples) // columns : (column + 1) * len(samples) // columns]
        there = [sample for sample in share if sample is not None]
        drawn.append(_level(pick(there), top, levels) if there else " ")
    return "".join(drawn)


def _level(value: float, top: float, levels: str) -> str:
    if top <= 0:
        return levels[0]
    return levels[max(0, min(len(levels) - 1, int(value / top * len(levels))))]
