"""Cells, columns and numbers of the tables that commands print."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.config_source import printable

if TYPE_CHECKING:
    from collections.abc import Sequence

_LONGEST_NAME = 32  # what a line of 120 columns leaves for it


def aligned(rows: Sequence[Sequence[str]], *, words: int) -> list[str]:
    """Put cells into columns: the first and the last ``words`` to the left, numbers to the right."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    numbers = len(widths) - words
    lines = []
    for row in rows:
        cells = [
            text.rjust(width) if 0 < column < numbers else text.ljust(width)
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join([" ".join(cells[:numbers]), *cells[numbers:]]).rstrip())
    return lines


def short_name(name: str) -> str:
    """Cut a long name short at its front; its end tells topics apart."""
    shown = printable(name, longest=250)
    return shown if len(shown) <= _LONGEST_NAME else f"…{shown[1 - _LONGEST_NAME :]}"


def figures(value: float, *, digits: int = 4) -> str:
    """Write a number with so many figures, and no exponent where people expect none."""
    if 10.0 ** (digits - 1) <= value < 1e6:
        return f"{value:.0f}"
    return f"{value:.{digits}g}"
