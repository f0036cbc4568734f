"""Summaries of scenarios, and docs/results.md and README.md made from them.

A scenario returns a `Summary`: figures, each beside its bound and its target, and tables. Nothing else is stored.
`python -m scripts.bench --docs` writes each into the page between `<!-- NAME:begin -->` and `<!-- NAME:end -->`, and
all figures that have a target into the block `targets`.
"""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Any

from arpd.model.errors import UsageError

REPO = Path(__file__).resolve().parents[2]
RESULTS = Path(__file__).parent / "results"
_WIDTH = 130
_MOST_ROWS = 12  # of a table that is not folded
_LEAST = 1e-6  # below it a number is what rounding left
_BLOCK = re.compile(r"(?P<begin><!-- (?P<name>[\w-]+):begin -->\n).*?(?P<end><!-- (?P=name):end -->\n)", re.DOTALL)
CELL = ("robot", "link", "bottleneck", "side")  # name a round
#: Head of a column, and the value of a row: its key, or a function; a key alone is its own head.
Column = str | tuple[str, str | Callable[[Any], Any]]


@dataclass(frozen=True, kw_only=True, slots=True)
class Figure:
    """One measured number.

    Parameters
    ----------
    value : None = never
    bound : the same figure of the best that this link or machine allows; None = not measured
    target : most that it should be, with ``at_least`` the least; None = there is none
    """

    what: str
    value: float | None
    unit: str = ""
    bound: float | None = None
    target: float | None = None
    at_least: bool = False

    @property
    def is_met(self) -> bool:
        """Whether the target is met; without a target always."""
        if self.target is None:
            return True
        if self.value is None:
            return False
        return self.value >= self.target if self.at_least else self.value <= self.target


def figure(
    what: str,
    value: float | None,
    unit: str = "",
    *,
    bound: float | None = None,
    most: float | None = None,
    least: float | None = None,
) -> Figure:
    """Return a figure whose target is the most or the least that it should be."""
    known = [None if each is None or not math.isfinite(each) else _short(each) for each in (value, bound, most, least)]
    target = known[2] if least is None else known[3]
    return Figure(what=what, value=known[0], unit=unit, bound=known[1], target=target, at_least=least is not None)


@dataclass(frozen=True, kw_only=True, slots=True)
class Table:
    """Rows of numbers and texts; None = never or not measured."""

    title: str = ""
    columns: list[str]
    rows: list[list[Any]]


@dataclass(kw_only=True, slots=True)
class Summary:
    """What a scenario found.

    Parameters
    ----------
    about : how it was measured, in sentences
    conditions : when, at which commit, on what and under which load; one for each part that was measured apart
    failed : rounds without figures: what each played, and why
    rounds : what each round found, of which another module makes the rest; no page shows it
    drawn : what the picture beside the summary shows, and no page; see `draw`
    """

    about: str
    figures: list[Figure] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    conditions: list[dict[str, Any]] = field(default_factory=list)
    failed: list[list[Any]] = field(default_factory=list)
    rounds: Table | None = None
    drawn: Table | None = None

    def write(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(asdict(self), indent=0, ensure_ascii=False, allow_nan=False) + "\n", "utf-8")
        draw(path.with_suffix(".png"), self.drawn)

    @classmethod
    def read(cls, path: Path) -> Summary:
        found = json.loads(path.read_text("utf-8"))
        return cls(
            about=found["about"],
            conditions=found["conditions"],
            failed=found.get("failed", []),
            figures=[Figure(**each) for each in found["figures"]],
            tables=[Table(**each) for each in found["tables"]],
            **{name: Table(**found[name]) for name in ("rounds", "drawn") if found.get(name)},
        )

    def with_part(self, part: Summary, made: Callable[..., Summary]) -> Summary:
        """Return it with a part that was measured again, made anew of the rounds of both.

        Conditions of which no round is left go.
        """
        if not self.rounds or not part.rounds:
            return part
        rounds = part.rounds if part.rounds.rows else self.rounds  # without a round there are no columns
        if self.rounds.rows and self.rounds.columns != rounds.columns:
            return part
        again = {name_of(row) for row in part.rounds.rows + part.failed}
        rows, failed = (
            [row for row in old if name_of(row) not in again] + new
            for old, new in ((self.rounds.rows, part.rounds.rows), (self.failed, part.failed))
        )
        whole = made(replace(rounds, rows=rows), drawn=_joined(self.drawn, part.drawn))
        whole.failed, whole.conditions = failed, self.conditions + part.conditions
        left = {id(whole.conditions_of(name_of(row))) for row in rows + failed}
        whole.conditions = [each for each in whole.conditions if id(each) in left]
        return whole

    def conditions_of(self, name: str) -> dict[str, Any]:
        """Return the conditions of the last part whose regular expression is found in the name of a round."""
        return next((each for each in reversed(self.conditions) if re.search(each.get("of", ""), name)), {})

    def markdown(self) -> str:
        """Return it for a page, without the figures that have a target; long tables are folded."""
        parts = [self.about, _said(self.conditions), _failures(self.failed)]
        parts.append(_figures([("", each) for each in self.figures if each.target is None]))
        for table in (each for each in self.tables if each.rows):
            rows = _markdown(table.columns, [list(map(shown, row)) for row in table.rows])
            if len(table.rows) > _MOST_ROWS:
                parts.append(_folded(table.title or f"{len(table.rows)} rows", rows))
            else:
                parts += [f"{table.title}:" if table.title else "", rows]
        return "\n\n".join(filter(None, parts))


def name_of(row: Sequence[Any]) -> str:
    """Return robot, link, bottleneck and side of a round."""
    return " ".join(row[: len(CELL)])


def _joined(old: Table | None, new: Table | None) -> Table | None:
    """Return what two pictures show, as one, with the newer of two curves of one name."""
    drawn = [each for each in (old, new) if each and each.rows]
    curves = {name: values for each in drawn for name, *values in zip(each.columns, *each.rows, strict=True)}
    rows = list(map(list, zip(*curves.values(), strict=False)))
    return replace(drawn[-1], columns=list(curves), rows=rows) if drawn else None


def targets(known: Mapping[str, Summary]) -> str:
    """Return all figures that have a target: those that miss it, then, folded, those that meet it."""
    aimed = [(name, each) for name, one in known.items() for each in one.figures if each.target is not None]
    missed, met = ([pair for pair in aimed if pair[1].is_met is is_met] for is_met in (False, True))
    parts = [f"{len(missed)} of {len(aimed)} targets are missed." if aimed else "", _figures(missed)]
    return "\n\n".join(filter(None, [*parts, _folded(f"Met: {len(met)}", _figures(met)) if met else ""]))


def _folded(title: str, text: str) -> str:
    return f"<details><summary>{title}</summary>\n\n{text}\n\n</details>"


def _said(conditions: Iterable[dict[str, Any]]) -> str:
    """Return conditions in sentences; parts that were measured at one commit on one day share theirs."""
    shared: dict[str, list[dict[str, Any]]] = {}
    for noted in conditions:
        modified = ", modified" if noted["is_modified"] else ""
        when = f"{noted['date']}, commit {noted['commit'][:7]}{modified}, {noted['machine']}"
        shared.setdefault(when, []).append(noted)
    sentences = []
    for when, parts in shared.items():
        of = ", ".join(f"`{each['of']}`" for each in parts if "of" in each) if len(shared) > 1 else ""
        loads = ranged([each["load"] for each in parts])
        load = f"load average {loads} before" if loads else "load not noted"
        void = "".join(f"; **void**: {each['void']}" for each in parts if each.get("void"))
        sentences.append(f"{of}{': ' if of else ''}{when}, {load}{void}.")
    return " ".join(sentences)


def _failures(failed: Iterable[Sequence[Any]]) -> str:
    """Return which rounds have no figures, and why."""
    rounds = [f"{', '.join(map(str, names))} ({why})" for *names, why in failed]
    return f"**Rounds without figures**, because a process failed: {'; '.join(rounds)}." if rounds else ""


def _figures(named: Sequence[tuple[str, Figure]]) -> str:
    """Return a table of figures and their scenarios, without the columns that none of them has."""
    figures = [each for _, each in named]

    def told(each: Figure) -> tuple[str, str]:
        """Return value and target, which look different where the target is missed."""
        found = "never" if each.value is None else shown(each.value), shown(each.target)
        return found if each.is_met or len({*found}) > 1 else (f"{each.value:g}", f"{each.target:g}")

    columns = {
        "scenario": [name for name, _ in named],
        "figure": [each.what for each in figures],
        "value": [told(each)[0] if each.is_met else f"**{told(each)[0]}**" for each in figures],
        "bound": ["" if each.bound is None else shown(each.bound) for each in figures],
        "target": [
            "" if each.target is None else f"{'≥' if each.at_least else '≤'} {told(each)[1]}" for each in figures
        ],
        "unit": [each.unit for each in figures],
    }
    kept = {head: cells for head, cells in columns.items() if any(cells)}
    return _markdown(list(kept), list(zip(*kept.values(), strict=True))) if kept else ""


def shown(value: Any) -> str:
    """Return a number with three digits or all before its point, 0 for what rounding left, a dash for None."""
    if value is None:
        return "–"
    if not isinstance(value, float):
        return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value)
    return f"{value:,.0f}" if abs(value) >= 100 or abs(value) < _LEAST else f"{value:.3g}"


def table(title: str, rows: Iterable[Any], *columns: Column) -> Table:
    """Return a table with a row for each of ``rows``; without columns, of all keys of the first one."""
    rows = list(rows)
    columns = columns or tuple(rows[0] if rows else ())
    named = [(column, column) if isinstance(column, str) else column for column in columns]
    found = [[_short(row[what] if isinstance(what, str) else what(row)) for _, what in named] for row in rows]
    return Table(title=title, columns=[head for head, _ in named], rows=found)


def _short(value: Any) -> Any:
    """Return a number with four digits: more are noise, and cost bytes; None for what is none."""
    if isinstance(value, float):
        return float(f"{value:.4g}") if math.isfinite(value) else None
    return value


def ranged(values: Iterable[Any]) -> str | None:
    """Return the median of several rounds, and in brackets the least and the largest; None = never, or not measured."""
    every = list(values)
    known = sorted(value for value in every if value is not None)
    if not known:
        return None
    if len(known) < len(every):
        return f"never in {len(every) - len(known)} of {len(every)}"
    least, middle, most = (shown(_short(float(each))) for each in (known[0], median(known), known[-1]))
    return middle if least == most else f"{middle} ({least}–{most})"


def picked(names: Iterable[str], only: str, *, there_are: str = "") -> list[str]:
    """Return the names in which a regular expression is found, of which there must be one."""
    names = list(names)
    with suppress(re.error):
        if found := [name for name in names if re.search(only, name)]:
            return found
    raise UsageError(f"--only {only!r} picks nothing; there are {there_are or '; '.join(names)}")


def _markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table; columns of numbers stand right."""
    rules = ["---:" if _is_numeric([row[at] for row in rows]) else "---" for at in range(len(columns))]
    lines = [f"| {' | '.join(line)} |" for line in (columns, *rows)]
    return "\n".join([lines[0], f"|{'|'.join(rules)}|", *lines[1:]])


def _is_numeric(cells: Sequence[str]) -> bool:
    known = [cell for cell in cells if cell not in {"", "–"}]
    return 2 * sum(map(_is_number, known)) > len(known)


def _is_number(cell: str) -> bool:
    """Return whether a cell begins with a number or ``never`` and is, but for its units, numbers."""
    digits, letters = (sum(map(kind, cell)) for kind in (str.isdigit, str.isalpha))
    return re.match(r"never|\W*\d", cell) is not None and 3 * digits >= letters


def _wrapped(line: str) -> str:
    """Break prose to the width of the page; tables and headings stay whole."""
    if line.startswith(("|", "#", "<", "!")):
        return line
    return textwrap.fill(line, _WIDTH, break_long_words=False, break_on_hyphens=False)


#: Sides in the README's table and picture, and what they are called there.
RIVALS = {
    "plain": "rclpy's defaults",
    "large_data": "Fast DDS' LARGE_DATA",
    "zenoh_first": "Zenoh, tuned",
    "two_ends": "arpd",
}


def by_place(rounds: Table) -> dict[tuple[str, ...], dict[str, dict[str, list[Any]]]]:
    """Return what the rounds found, by robot, link and bottleneck, then by side, then by column."""
    found: dict[tuple[str, ...], dict[str, dict[str, list[Any]]]] = {}
    for robot, link, bottleneck, side, *values in rounds.rows:
        columns = found.setdefault((robot, link, bottleneck), {}).setdefault(side, {})
        for key, value in zip(rounds.columns[len(CELL) :], values, strict=True):
            columns.setdefault(key, []).append(value)
    return found


def rivals(rounds: Table, robot: str = "tb4", link: str = "fall-and-rise") -> str:
    """Return what a robot's sides carry and how late, with the bottleneck at the sender / between the hosts."""
    places = by_place(rounds)
    heads = {
        "pictures/s": "large/s",
        "small samples, p99 ms": "small p99 ms",
        "delivered %": "small %",
        "commands, p99 ms": "commands p99 ms",
    }

    def both(side: str, column: str) -> str:
        found = (
            places.get((robot, link, bottleneck), {}).get(side, {}).get(column) for bottleneck in ("sender", "middle")
        )
        return " / ".join("never" if None in each else shown(float(median(each))) for each in found if each)

    return _markdown(
        ["", *heads], [[said, *(both(side, column) for column in heads.values())] for side, said in RIVALS.items()]
    )


def write_pages() -> None:
    """Fill every block of docs/results.md and README.md whose summary is there."""
    known = {path.stem: Summary.read(path) for path in sorted(RESULTS.glob("*.json"))}
    blocks = {name: summary.markdown() for name, summary in known.items()} | {"targets": targets(known)}
    if (robots := known.get("robots")) and robots.rounds:
        blocks["rivals"] = rivals(robots.rounds)
    for path in (REPO / "docs/results.md", REPO / "README.md"):

        def written(match: re.Match[str]) -> str:
            if match["name"] not in blocks:
                return match[0]
            text = "\n".join(map(_wrapped, blocks[match["name"]].split("\n")))
            return f"{match['begin']}{text}\n{match['end']}"

        path.write_text(_BLOCK.sub(written, path.read_text("utf-8")), "utf-8")


def draw(path: Path, table: Table | None) -> None:
    """Draw the columns of a table over the first one, as dots where cells are empty, else as curves."""
    if not table or not table.rows:
        return
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(9, 3), layout="constrained")
    is_dots = None in table.rows[0]
    firsts, *columns = zip(*table.rows, strict=True)
    for name, values in zip(table.columns[1:], columns, strict=True):
        axes.plot(firsts, values, "o" if is_dots else "-", label=RIVALS.get(name, name))
    axes.set(**{"xscale" if is_dots else "yscale": "log"}, xlabel=table.columns[0], ylabel=table.title)
    axes.grid(visible=True, color="0.9")
    axes.legend(loc="best", frameon=False)
    figure.savefig(path, dpi=90)
    plt.close(figure)
