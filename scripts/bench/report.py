"""Tables and numbers of the reports, as docs/results.md has them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_RULES = {"l": "---", "r": "---:", "c": ":-:"}


def markdown_table(columns: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table.

    Parameters
    ----------
    columns : l, r or c (left, right, centred) for each column; the last letter counts for all that follow
    """
    rule = "|".join(_RULES[each] for each in columns.ljust(len(head), columns[-1]))
    return [f"| {' | '.join(head)} |", f"|{rule}|", *(f"| {' | '.join(row)} |" for row in rows)]


def percent(share: float) -> str:
    """Return a share in per cent, without the sign."""
    return f"{100 * share:.1f}"
