"""Recorded links: rate over time, and loss if recorded, from CSV files, tables in Mbit/s, and mahimahi traces."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING

from arpd.model.errors import TraceError
from arpd.sim.schedule import LossStep, RateSchedule, RateStep

if TYPE_CHECKING:
    from pathlib import Path

_COLUMNS = ("time_s", "rate_bit_per_s", "loss")
_BARE = ("time_s", "rate_mbit_per_s")  # of a table without a header
_START = f"start with {','.join(_COLUMNS)}, with a row of seconds and Mbit/s, or with a delivery in milliseconds"
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]{1,3})?", re.ASCII)
# Larger values belong to no link, and sums of bytes over time would lose their precision.
_MOST = {"time_s": 1e7, "rate_bit_per_s": 1e12, "rate_mbit_per_s": 1e5, "loss": 1.0}
_MOST_MS = 10**10
_MOST_BYTES = 64_000_000  # somebody may name a recording of the robot
_DELIVERY_BYTES = 1500
# A trace with a line per packet gives a rate per span. In 20 ms, 1 Mbit/s has 1.7 packets; arpd ignores shorter queues.
_BIN_MS = 20


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkTrace:
    """A recorded link.

    Parameters
    ----------
    name : name of its file
    rates : rate over time
    losses : probability of loss over time, by ascending start; empty = not recorded
    duration_s : length of the recording, up to the last row or the last delivery (s)
    """

    name: str
    rates: RateSchedule
    losses: tuple[LossStep, ...] = ()
    duration_s: float


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
        If the file cannot be read or is of no kind; the message names the line and the way out.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(_MOST_BYTES + 1)
        if len(raw) > _MOST_BYTES:
            raise TraceError(f"{path}: is larger than {_MOST_BYTES / 1e6:g} MB; give a CSV or a mahimahi trace")
        text = raw.decode("utf-8-sig")
    except OSError as error:
        raise TraceError(f"{path}: cannot be read ({error.strerror}); give a CSV or a mahimahi trace") from error
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise TraceError(f"{path}:{line}: not UTF-8 text; save the trace as plain text") from None
    try:
        return _read(path.name, text.split("\n"))
    except _Fault as fault:
        raise TraceError(f"{path}:{fault.args[0]}: {fault.args[1]}") from None


class _Fault(Exception):
    """Number of a line, and what is wrong with it and the way out."""


_Lines = Iterator[tuple[int, str]]


def _read(name: str, text: Sequence[str]) -> LinkTrace:
    stripped = ((number, line.strip()) for number, line in enumerate(text, start=1))
    lines = ((number, line) for number, line in stripped if line and not line.startswith("#"))
    if (begin := next(lines, None)) is None:
        raise _Fault(1, f"the trace is empty; {_START}")
    number, first = begin
    if re.fullmatch(r"[-+]?[0-9]+", first, re.ASCII):
        return _mahimahi(name, number, chain([begin], lines))
    if "," in first or first in _COLUMNS:
        columns = tuple(cell.strip() for cell in first.split(","))
        if columns not in {_COLUMNS, _COLUMNS[:2]}:
            raise _Fault(number, f"{first!r} is no header; write {','.join(_COLUMNS)}")
        return _table(name, number, lines, columns, separator=",")
    if len(cells := first.split()) == len(_BARE) and all(map(_NUMBER.fullmatch, cells)):
        return _table(name, number, chain([begin], lines), _BARE, separator=None)
    raise _Fault(number, f"{first!r} starts no trace; {_START}")


def _table(name: str, first: int, lines: _Lines, columns: Sequence[str], *, separator: str | None) -> LinkTrace:
    rates: list[RateStep] = []
    losses: list[LossStep] = []
    first_s = 0.0
    for number, line in lines:
        cells = [cell.strip() for cell in line.split(separator) if cell.strip()]
        if len(cells) != len(columns):
            raise _Fault(number, f"{len(cells)} values; write {len(columns)}: {','.join(columns)}")
        at_s, rate, *loss = (_value(number, cell, what) for cell, what in zip(cells, columns, strict=True))
        if not rates:
            first_s = at_s if columns is _BARE else 0.0
        if not rates and at_s != first_s:
            raise _Fault(number, f"the first row is at {at_s:g} s; start at 0")
        if rates and at_s - first_s <= rates[-1].start_s:
            before_s = rates[-1].start_s + first_s
            raise _Fault(number, f"{at_s:g} s comes after {before_s:g} s; sort the rows by time, one per moment")
        rates.append(RateStep(at_s - first_s, rate * (1e6 if columns is _BARE else 1.0) / 8.0))
        losses += [LossStep(at_s - first_s, each) for each in loss]
    if not rates:
        raise _Fault(first, "no row follows the header; add one at 0 s")
    return LinkTrace(
        name=name, rates=RateSchedule(steps=tuple(rates)), losses=tuple(losses), duration_s=rates[-1].start_s
    )


def _value(number: int, text: str, what: str) -> float:
    if not (_NUMBER.fullmatch(text) and 0.0 <= float(text) <= _MOST[what]):
        raise _Fault(number, f"{what} {text!r} is no such number; write one from 0 to {_MOST[what]:g}")
    return float(text)


def _mahimahi(name: str, first: int, lines: _Lines) -> LinkTrace:
    deliveries: Counter[int] = Counter()
    last_ms = 0
    for number, text in lines:
        if not re.fullmatch(r"[0-9]{1,10}", text, re.ASCII):
            raise _Fault(number, f"{text!r} is not a moment; write whole milliseconds from 0 to {_MOST_MS}")
        if int(text) < last_ms:
            raise _Fault(number, f"{text} ms comes after {last_ms} ms; sort the lines by time")
        last_ms = int(text)
        deliveries[max(0, last_ms - 1) // _BIN_MS] += 1
    if not last_ms:
        raise _Fault(first, "the trace takes no time; its last delivery must come after 0 ms")
    duration_s = last_ms / 1000.0
    rates = RateSchedule(steps=tuple(_bins(deliveries, last_ms)), period_s=duration_s)
    return LinkTrace(name=name, rates=rates, duration_s=duration_s)


def _bins(deliveries: Counter[int], last_ms: int) -> Iterator[RateStep]:
    before = None
    for bin_ in sorted({0, *deliveries, *(bin_ + 1 for bin_ in deliveries)}):
        start_ms = bin_ * _BIN_MS
        if start_ms >= last_ms:
            return
        rate = deliveries[bin_] * _DELIVERY_BYTES * 1000.0 / min(_BIN_MS, last_ms - start_ms)
        if rate != before:
            yield RateStep(start_ms / 1000.0, rate)
        before = rate
