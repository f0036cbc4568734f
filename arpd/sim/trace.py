"""Recorded links: rate over time, and loss if recorded, from CSV files and mahimahi traces."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from arpd.model.errors import TraceError
from arpd.sim.loss import LossStep, check_ascending
from arpd.sim.schedule import RateSchedule, RateStep

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path
    from typing import Self

_COLUMNS = ("time_s", "rate_bit_per_s", "loss")
_HEADER = ",".join(_COLUMNS)
_START = f"start with {_HEADER} or with a delivery in milliseconds"
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]{1,3})?", re.ASCII)
# Larger values belong to no link, and sums of bytes over time would lose their precision.
_MOST_S, _MOST_BIT_PER_S = 1e7, 1e12
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
        check_ascending(self.losses)
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
        losses = tuple(replace(step, start_s=at_s + step.start_s) for at_s in begins_s for step in self.losses)
        return replace(
            self, rates=RateSchedule(steps=rates), losses=losses, duration_s=turns * self.duration_s, repeats=False
        )


def read_trace(path: Path) -> LinkTrace:
    """Read a trace of either kind; lines that start with ``#`` and blank lines are ignored.

    CSV: a header ``time_s,rate_bit_per_s`` or ``time_s,rate_bit_per_s,loss``, then one row per change, by ascending
    time, the first at 0. A rate of 0 carries nothing; the last row holds without end.

    mahimahi: one line per delivery of 1500 bytes, each a whole number of milliseconds, never falling; after the last
    one the trace starts again. It becomes the mean rates of spans of 20 ms (the last may be shorter). Each span, and so
    the whole, has the exact bytes. A delivery at the end of a span belongs to it.

    Raises
    ------
    TraceError
        If the file cannot be read or is of neither kind; the message names the place and the way out.
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
        return _csv(path.name, reader)
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


# -- CSV


def _csv(name: str, reader: _Reader) -> LinkTrace:
    lines = reader.lines()
    columns = _header(reader, *next(lines))
    rates: list[RateStep] = []
    losses: list[LossStep] = []
    for number, line in lines:
        cells = list(_cells(line))
        if len(cells) != len(columns):
            column = cells[len(columns)][0] if len(cells) > len(columns) else len(line) + 1
            raise reader.fault(number, column, f"{len(cells)} values", f"write {len(columns)}: {','.join(columns)}")
        values = [_value(reader, number, cell, what) for cell, what in zip(cells, columns, strict=True)]
        start_s = values[0]
        if not rates and start_s != 0.0:
            raise reader.fault(number, cells[0][0], f"the first row is at {start_s:g} s", "start at 0")
        if rates and start_s <= rates[-1].start_s:
            raise reader.fault(
                number,
                cells[0][0],
                f"{start_s:g} s comes after {rates[-1].start_s:g} s",
                "sort the rows by time, one per moment",
            )
        rates.append(RateStep(start_s=start_s, rate_bytes_per_second=values[1] / 8.0))
        if len(columns) == len(_COLUMNS):
            losses.append(LossStep(start_s=start_s, loss=values[2]))
    if not rates:
        number, line = reader.first()
        raise reader.fault(number, len(line) + 1, "no row follows the header", "add one at 0 s")
    return LinkTrace(
        name=name, rates=RateSchedule(steps=tuple(rates)), losses=tuple(losses), duration_s=rates[-1].start_s
    )


def _header(reader: _Reader, number: int, line: str) -> Sequence[str]:
    cells = list(_cells(line))
    for (column, cell), expected in zip(cells, _COLUMNS, strict=False):
        if cell != expected:
            raise reader.fault(number, column, f"{cell!r} where {expected!r} was expected", f"write {_HEADER}")
    if len(cells) < len(_COLUMNS) - 1:
        raise reader.fault(number, len(line) + 1, "the header has no rate", f"write {_HEADER}")
    if len(cells) > len(_COLUMNS):
        column, cell = cells[len(_COLUMNS)]
        raise reader.fault(number, column, f"unknown column {cell!r}", f"write {_HEADER}")
    return _COLUMNS[: len(cells)]


def _cells(line: str) -> Iterator[tuple[int, str]]:
    """Yield the cells of a row, each with its column."""
    column = 1
    for cell in line.split(","):
        yield column + len(cell) - len(cell.lstrip()), cell.strip()
        column += len(cell) + 1


def _value(reader: _Reader, number: int, cell: tuple[int, str], what: str) -> float:
    column, text = cell
    most = {"time_s": _MOST_S, "rate_bit_per_s": _MOST_BIT_PER_S, "loss": 1.0}[what]
    if not _NUMBER.fullmatch(text):
        raise reader.fault(number, column, f"{what} {text!r} is not a number", f"write one from 0 to {most:g}")
    value = float(text)
    if not 0.0 <= value <= most:
        raise reader.fault(number, column, f"{what} {text} is out of range", f"write a number from 0 to {most:g}")
    return value


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
