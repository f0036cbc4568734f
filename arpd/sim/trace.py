"""Recorded links: rate over time, and loss if recorded, from CSV files, tables in Mbit/s, and mahimahi traces."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from arpd.model.errors import TraceError
from arpd.sim.schedule import LossStep, RateSchedule, RateStep

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path
    from typing import Self

_COLUMNS = ("time_s", "rate_bit_per_s", "loss")
_HEADER = ",".join(_COLUMNS)
_BARE = ("time_s", "rate_mbit_per_s")  # of a table without a header
_START = f"start with {_HEADER}, with a row of seconds and Mbit/s, or with a delivery in milliseconds"
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]{1,3})?", re.ASCII)
# Larger values belong to no link, and sums of bytes over time would lose their precision.
_MOST_S = 1e7
_MOST = {"time_s": _MOST_S, "rate_bit_per_s": 1e12, "rate_mbit_per_s": 1e5, "loss": 1.0}
_DELIVERY_BYTES = 1500
# A trace with a line per packet gives a rate per span. In 20 ms, 1 Mbit/s has 1.7 packets; arpd ignores shorter queues.
_BIN_MS = 20


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkTrace:
    """A recorded link.

    Parameters
    ----------
    name : name of its file
    rates : rate over time; the last one holds unless the trace repeats
    losses : probability of loss over time, by ascending start; empty = not recorded
    duration_s : length of the recording, up to the last row or the last delivery (s)
    repeats : True if the recording starts again at its end, as mahimahi plays it
    """

    name: str
    rates: RateSchedule
    losses: tuple[LossStep, ...] = ()
    duration_s: float
    repeats: bool = False

    def __post_init__(self) -> None:
        last_s = max(self.rates.duration_s, *(step.start_s for step in self.losses), 0.0)
        if not self.duration_s >= last_s or (self.repeats and self.duration_s == last_s):
            raise ValueError(f"trace {self.name}: it ends at {self.duration_s:g} s, no later than its last step starts")

    def lasting(self, run_s: float) -> Self:
        """Return the trace for a run of ``run_s`` seconds, drain included; it is as long as the run if it repeats."""
        turns = math.ceil(run_s / self.duration_s) if self.repeats else 1
        if turns <= 1:
            return self
        begins_s = [turn * self.duration_s for turn in range(turns)]
        rates = tuple(replace(step, start_s=at_s + step.start_s) for at_s in begins_s for step in self.rates.steps)
        losses = tuple(LossStep(at_s + step.start_s, step.loss) for at_s in begins_s for step in self.losses)
        return replace(
            self, rates=RateSchedule(steps=rates), losses=losses, duration_s=turns * self.duration_s, repeats=False
        )


def read_trace(path: Path) -> LinkTrace:
    """Read a trace of any kind; lines that start with ``#`` and blank lines are ignored.

    CSV: a header ``time_s,rate_bit_per_s`` or ``time_s,rate_bit_per_s,loss``, then one row per change, by ascending
    time, the first at 0. A rate of 0 carries nothing; the last row holds without end.

    Table: rows of seconds and Mbit/s with blanks or a tab between, as recordings are published; the first row is the
    start of the run.

    mahimahi: one line per delivery of 1500 bytes, each a whole number of milliseconds, never falling; after the last
    one the trace starts again. It becomes the mean rates of spans of 20 ms (the last may be shorter). Each span, and so
    the whole, has the exact bytes. A delivery at the end of a span belongs to it.

    Raises
    ------
    TraceError
        If the file cannot be read or is of no kind; the message names the place and the way out.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise TraceError(f"{path}: cannot be read ({error.strerror}); give a CSV or a mahimahi trace") from error
    reader = _Reader(path, _decoded(path, text))
    number, first = reader.first()
    if re.fullmatch(r"[-+]?[0-9]+", first.strip(), re.ASCII):
        return _mahimahi(path.name, reader)
    if "," in first or first.strip() in _COLUMNS:
        lines = reader.lines()
        return _table(path.name, reader, lines, _header(reader, *next(lines)), cell=r"[^,]+")
    cells = [text for _, text in _cells(first, r"[^ \t]+")]
    if len(cells) == len(_BARE) and all(map(_NUMBER.fullmatch, cells)):
        return _table(path.name, reader, reader.lines(), _BARE, cell=r"[^ \t]+")
    column = len(first) - len(first.lstrip()) + 1
    raise reader.fault(number, column, f"{first.strip()!r} starts no trace", _START)


class _Reader:
    """Reads the lines of a file and makes errors about them."""

    def __init__(self, path: Path, text: str) -> None:
        self._path = path
        self._text = text

    def lines(self) -> Iterator[tuple[int, str]]:
        """Yield every line with its number, counted from 1, without comments and blank lines."""
        for number, line in enumerate(self._text.split("\n"), start=1):
            content = line.rstrip()
            if content and not content.lstrip().startswith("#"):
                yield number, content

    def first(self) -> tuple[int, str]:
        for number, line in self.lines():
            return number, line
        raise self.fault(1, 1, "the trace is empty", _START)

    def fault(self, line: int, column: int, what: str, remedy: str) -> TraceError:
        return TraceError(f"{self._path}:{line}:{column}: {what}; {remedy}")


def _decoded(path: Path, text: bytes) -> str:
    try:
        return text.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = text[: error.start]
        line, column = before.count(b"\n") + 1, error.start - before.rfind(b"\n")
        raise TraceError(f"{path}:{line}:{column}: not UTF-8 text; save the trace as plain text") from None


# -- tables


def _header(reader: _Reader, number: int, line: str) -> Sequence[str]:
    names = [cell for _, cell in _cells(line, r"[^,]+")]
    if tuple(names) not in {_COLUMNS, _COLUMNS[:2]}:
        raise reader.fault(number, 1, f"{line.strip()!r} is no header", f"write {_HEADER}")
    return names


def _table(
    name: str, reader: _Reader, lines: Iterator[tuple[int, str]], columns: Sequence[str], *, cell: str
) -> LinkTrace:
    rates: list[RateStep] = []
    losses: list[LossStep] = []
    bit = 1e6 if columns is _BARE else 1.0
    first_s = 0.0
    for number, line in lines:
        cells = list(_cells(line, cell))
        if len(cells) != len(columns):
            raise reader.fault(number, 1, f"{len(cells)} values", f"write {len(columns)}: {','.join(columns)}")
        values = [_value(reader, number, each, what) for each, what in zip(cells, columns, strict=True)]
        if columns is _BARE and not rates:
            first_s = values[0]
        start_s = values[0] - first_s
        if not rates and start_s != 0.0:
            raise reader.fault(number, cells[0][0], f"the first row is at {start_s:g} s", "start at 0")
        if rates and start_s <= rates[-1].start_s:
            raise reader.fault(
                number,
                cells[0][0],
                f"{values[0]:g} s comes after {rates[-1].start_s + first_s:g} s",
                "sort the rows by time, one per moment",
            )
        rates.append(RateStep(start_s=start_s, rate_bytes_per_second=values[1] * bit / 8.0))
        losses += [LossStep(start_s=start_s, loss=loss) for loss in values[2:]]
    if not rates:
        number, _ = reader.first()
        raise reader.fault(number, 1, "no row follows the header", "add one at 0 s")
    return LinkTrace(
        name=name, rates=RateSchedule(steps=tuple(rates)), losses=tuple(losses), duration_s=rates[-1].start_s
    )


def _cells(line: str, cell: str) -> Iterator[tuple[int, str]]:
    """Yield the cells of a row, each with its column; a pattern says what a cell is."""
    for found in re.finditer(cell, line):
        text = found.group()
        yield found.start() + 1 + len(text) - len(text.lstrip()), text.strip()


def _value(reader: _Reader, number: int, cell: tuple[int, str], what: str) -> float:
    (column, text), most = cell, _MOST[what]
    if not (_NUMBER.fullmatch(text) and 0.0 <= float(text) <= most):
        raise reader.fault(number, column, f"{what} {text!r} is no such number", f"write one from 0 to {most:g}")
    return float(text)


# -- mahimahi


def _mahimahi(name: str, reader: _Reader) -> LinkTrace:
    deliveries: Counter[int] = Counter()
    last_ms = 0
    for number, line in reader.lines():
        text = line.strip()
        column = len(line) - len(line.lstrip()) + 1
        if not re.fullmatch(r"[0-9]{1,10}", text, re.ASCII) or int(text) > _MOST_S * 1000:
            raise reader.fault(
                number, column, f"{text!r} is not a moment", f"write whole milliseconds from 0 to {_MOST_S * 1000:.0f}"
            )
        if int(text) < last_ms:
            raise reader.fault(number, column, f"{text} ms comes after {last_ms} ms", "sort the lines by time")
        last_ms = int(text)
        deliveries[max(0, last_ms - 1) // _BIN_MS] += 1
    if not last_ms:
        number, _ = reader.first()
        raise reader.fault(number, 1, "the trace takes no time", "its last delivery must come after 0 ms")
    rates = RateSchedule(steps=tuple(_bins(deliveries, last_ms)))
    return LinkTrace(name=name, rates=rates, duration_s=last_ms / 1000.0, repeats=True)


def _bins(deliveries: Counter[int], last_ms: int) -> Iterator[RateStep]:
    before = None
    for bin_ in sorted({0, *deliveries, *(bin_ + 1 for bin_ in deliveries)}):
        start_ms = bin_ * _BIN_MS
        if start_ms >= last_ms:
            return
        rate = deliveries[bin_] * _DELIVERY_BYTES * 1000.0 / min(_BIN_MS, last_ms - start_ms)
        if rate != before:
            yield RateStep(start_s=start_ms / 1000.0, rate_bytes_per_second=rate)
        before = rate
