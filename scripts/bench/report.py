"""The parts of every benchmark's report: tables, targets and forms of figures, as Markdown for docs/results.md.

A benchmark declares its report as ``report(document) -> str`` over its JSON document; `results_page.py` calls it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from scripts.bench.record import described

Form = str | Callable[[Any], str]
#: Head, then the value of a row (its key, or a function), then the form of the value if it is no text.
Column = tuple[str, str | int | Callable[[Any], Any]] | tuple[str, str | int | Callable[[Any], Any], Form]
NEVER = "–"


def milli(seconds: float) -> str:
    """Return milliseconds, below ten with a decimal."""
    return f"{1e3 * seconds:.{0 if seconds >= 0.01 else 1}f}"


def scaled(factor: float, spec: str) -> Callable[[float], str]:
    """Return the form of a quantity in another unit."""
    return lambda value: format(factor * value, spec)


percent = scaled(100.0, ".1f")
kilo = scaled(1e-3, ".1f")
mbit = scaled(8e-6, ".3g")  # of bytes/s
mib = scaled(2.0**-20, ".0f")  # of bytes


def shown(value: Any, form: Form = "{}") -> str:
    """Return a value in its form; text as it is, and a dash for what never came."""
    if value is None:
        return NEVER
    if isinstance(value, str):
        return value
    return form.format(value) if isinstance(form, str) else form(value)


def spread(values: Iterable[float | None], form: Form) -> str:
    """Return the median and in brackets the worst, which is the largest or one that never came."""
    every = list(values)
    known = sorted(value for value in every if value is not None)
    if len(known) < len(every):
        return f"never in {len(every) - len(known)} of {len(every)}"
    if not known:
        return ""
    middle, worst = shown(median(known), form), shown(known[-1], form)
    return middle if middle == worst else f"{middle} ({worst})"


def table(rows: Iterable[Any], *columns: Column) -> str:
    """Return a table with a row for each of ``rows``; columns of numbers stand right."""
    cells = [[_cell(row, column) for column in columns] for row in rows]
    rules = ["---:" if _is_numeric([row[at] for row in cells]) else "---" for at in range(len(columns))]
    lines = [f"| {' | '.join(line)} |" for line in ([column[0] for column in columns], *cells)]
    return "\n".join([lines[0], f"|{'|'.join(rules)}|", *lines[1:]])


def _cell(row: Any, column: Column) -> str:
    value = column[1](row) if callable(column[1]) else row[column[1]]
    return shown(value, column[2] if len(column) == 3 else "{}")


def _is_numeric(cells: Sequence[str]) -> bool:
    known = [cell for cell in cells if cell not in {"", NEVER}]
    return 2 * sum(map(_is_number, known)) > len(known)


def _is_number(cell: str) -> bool:
    """Return whether a cell begins with a number or ``never`` and is, but for its units, numbers."""
    digits, letters = (sum(map(kind, cell)) for kind in (str.isdigit, str.isalpha))
    return re.match(r"never|\W*\d", cell) is not None and 3 * digits >= letters


@dataclass(frozen=True, slots=True)
class Target:
    """A figure and the most that it may be, or with ``at_least`` the least; a figure that never came misses.

    Parameters
    ----------
    parts : what a figure that misses consists of
    """

    what: str
    value: float | None
    limit: float
    form: Form = "{}"
    at_least: bool = False
    parts: str = ""

    @property
    def is_met(self) -> bool:
        if self.value is None:
            return False
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    @property
    def bound(self) -> str:
        return f"{'≥' if self.at_least else '≤'} {shown(self.limit, self.form)}"

    @property
    def outcome(self) -> str:
        return "✓" if self.is_met else f"✗ {self.parts}".rstrip()


def targets(judged: Sequence[Target]) -> str:
    """Return how many targets are met, and a table of them all."""
    rows = table(
        judged,
        ("target", lambda each: each.what),
        ("", lambda each: each.bound),
        ("measured", lambda each: shown(each.value, each.form)),
        ("", lambda each: each.outcome),
    )
    return f"Targets: {sum(each.is_met for each in judged)} of {len(judged)} met.\n\n{rows}"


def paragraphs(*parts: str) -> str:
    """Return the parts of a report that say something, a blank line between them."""
    return "\n\n".join(filter(None, parts))


def about(document: dict[str, Any], what: str) -> str:
    """Return what is measured and under which conditions, as the first line of a report."""
    return f"{what} ({described(document)})."


def details(summary: str, *parts: str) -> str:
    """Return parts that a reader of the page unfolds."""
    return paragraphs(f"<details><summary>{summary}</summary>", *parts, "</details>")
