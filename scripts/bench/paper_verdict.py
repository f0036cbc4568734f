"""The paper's claims for its optimum, checked against every fixed configuration, and what makes a document void."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from itertools import groupby
from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.paper_cells import FIGURES, FIXED_DEPTHS, LIVE
from scripts.bench.report import shown

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

LIKE = 2.0  # two latencies are alike within this factor


def short(value: float) -> str:
    """Write two significant digits, or all before the point, so that only zero shows as zero."""
    if value == 0.0:
        return "0"
    digits = max(0, 1 - math.floor(math.log10(abs(value))))
    text = f"{value:.{digits}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def milliseconds(value_s: float) -> str:
    return short(value_s * 1e3)


def percent(ratio: float) -> str:
    return short(ratio * 100.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """All rounds of one configuration in one experiment over one link.

    Parameters
    ----------
    runs : the turns that are not void
    why_void : reasons of the void turns
    """

    link: str
    link_loss: float
    heartbeat: str
    payload_bytes: int
    deadline_hz: int
    depth: int
    runs: tuple[dict[str, Any], ...]
    why_void: str

    @property
    def name(self) -> str:
        """Payload, rate and depth."""
        return f"{self.payload_bytes} B {self.name_in_link}"

    @property
    def name_in_link(self) -> str:
        """Rate and depth in the paper's notation."""
        return f"({self.deadline_hz} Hz, {self.depth})"

    @property
    def p50_s(self) -> float | None:
        """Median end-to-end latency (s)."""
        return self.middle("end_to_end", "p50_s")

    @property
    def p99_s(self) -> float | None:
        """End-to-end latency at p99 (s)."""
        return self.middle("end_to_end", "p99_s")

    @property
    def shown_p99(self) -> str:
        """End-to-end latency at p99 in ms, of several rounds with their range in brackets; or why it is void."""
        if not self.runs:
            return self.why_void
        between = "–".join(shown(value, milliseconds) for value in self.p99_range_s)
        return shown(self.p99_s, milliseconds) + (f" ({between})" if len(self.runs) > 1 else "")

    @property
    def p99_range_s(self) -> tuple[float | None, float | None]:
        """The least and the largest p99 of a round (s)."""
        values = [run["end_to_end"]["p99_s"] for run in self.runs]
        return (None, None) if not values or None in values else (min(values), max(values))

    @property
    def lost(self) -> int:
        """Number of samples lost in all rounds."""
        return sum(run["lost"] for run in self.runs)

    @property
    def lost_ratio(self) -> float | None:
        """Lost share of all samples of all topics."""
        published = sum(run["published"] for run in self.runs)
        return self.lost / published if published else None

    @property
    def used_ratio(self) -> float:
        """Share of the link that the robot's traffic uses."""
        return self.middle("used_ratio") or 0.0

    @property
    def overflows(self) -> int:
        """Number of datagrams lost at full sockets in all rounds; the link did not lose them."""
        return sum(run["receive_buffer_overflows"] for run in self.runs)

    def middle(self, *keys: str) -> float | None:
        """Return the median of a figure over rounds; None if a round has none."""
        values = []
        for run in self.runs:
            value: Any = run
            for key in keys:
                value = value[key]
            values.append(value)
        return None if not values or None in values else float(median(values))


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """An optimum beside all fixed configurations with the same payload over the same link.

    Parameters
    ----------
    rmax_hz : the optimum's Rmax (Hz)
    at_rmax : fixed configurations at that rate, the smaller DEPTH first
    slower_than : those without loss whose p99 is not above the optimum's
    lossier_than : those with a similar latency that lose less than the optimum
    """

    rmax_hz: int
    optimum: Cell
    at_rmax: tuple[Cell, ...]
    slower_than: tuple[Cell, ...]
    lossier_than: tuple[Cell, ...]


def rounds(document: dict[str, Any]) -> str:
    """Return the number of rounds; an interrupted run has measured some configurations more often than others."""
    counts = Counter((run["experiment"], *_key(run)) for run in document["runs"])
    least, most = (min(counts.values()), max(counts.values())) if counts else (0, 0)
    many = f"{least}" if least == most else f"{least} to {most}"
    return f"{many} round{'s' * (most != 1)} of {document['conditions']['seconds']:g} s"


_KEY = ("link", "link_loss", "heartbeat", "payload_bytes", "deadline_hz", "depth")


def _key(run: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(run[name] for name in _KEY)


def cells(document: dict[str, Any], experiment: str) -> list[Cell]:
    """Return every configuration of an experiment, by link, payload, rate and depth."""
    runs = [run for run in document["runs"] if run["experiment"] == experiment and "failed" not in run]
    found = []
    for key, together in groupby(sorted(runs, key=_key), key=_key):
        every = list(together)
        valid = tuple(run for run in every if not run["void"])
        why_void = " ".join(sorted({f"void: {run['void']}" for run in every if run["void"]}))
        found.append(Cell(**dict(zip(_KEY, key, strict=True)), runs=valid, why_void=why_void))
    return found


def verdicts(document: dict[str, Any]) -> list[Verdict]:
    """Judge every optimum that was measured, by link, payload and Rmax."""
    found = cells(document, FIGURES)
    rates = {optimum["rmax_hz"] for optimum in document["optima"]}
    fixed = [cell for cell in found if cell.depth in FIXED_DEPTHS and cell.deadline_hz in rates]
    judged = []
    for cell in found:
        for known in document["optima"]:
            if (cell.deadline_hz, cell.depth) == (known["rate_hz"], known["depth"]):
                others = [f for f in fixed if (f.link, f.payload_bytes) == (cell.link, cell.payload_bytes)]
                judged.append(_verdict(known["rmax_hz"], cell, others))
    return judged


def _verdict(rmax_hz: int, optimum: Cell, fixed: Sequence[Cell]) -> Verdict:
    known = [cell for cell in fixed if cell.runs]
    return Verdict(
        rmax_hz=rmax_hz,
        optimum=optimum,
        at_rmax=tuple(cell for cell in fixed if cell.deadline_hz == rmax_hz),
        slower_than=tuple(cell for cell in known if cell.lost == 0 and not _is_below(optimum.p99_s, cell.p99_s)),
        lossier_than=tuple(
            cell
            for cell in known
            if _is_like(optimum.p99_s, cell.p99_s) and (optimum.lost_ratio or 0.0) > (cell.lost_ratio or 0.0)
        ),
    )


def _is_below(one_s: float | None, other_s: float | None) -> bool:
    return one_s is not None and (other_s is None or one_s < other_s)


def _is_like(one_s: float | None, other_s: float | None) -> bool:
    return one_s is not None and other_s is not None and max(one_s, other_s) <= LIKE * min(one_s, other_s)


def nonsense(document: dict[str, Any]) -> list[str]:
    """Return the faults that make the document worthless; void turns are not faults."""
    if not document["runs"]:
        return ["no turn came to its end"]
    found = []
    for run in document["runs"]:
        name = named(run)
        if "failed" in run:
            found.append(f"{name}: {run['failed']}")
            continue
        if not run["sensing"]["count"]:
            found.append(f"{name}: nothing arrived")
        elif not run["end_to_end"]["count"] and run["sensing"]["lost_ratio"] < 0.5:
            found.append(f"{name}: nothing was answered")
        if run["robot_sent_bytes"] < run["sensing"]["count"] * run["payload_bytes"]:
            found.append(f"{name}: more arrived than the link carried; it was bypassed")
        if any(not math.isfinite(number) for number in _numbers(run)):
            found.append(f"{name}: a figure is not a number")
    return found


def voids(document: dict[str, Any]) -> list[str]:
    """Return the void turns, and the processes without CPU time."""
    return [
        f"{named(run)}, round {run['round']}: the {run['void']} could not keep up"
        for run in document["runs"]
        if run.get("void")
    ]


def named(run: dict[str, Any]) -> str:
    """Name a turn in a few words."""
    if run["experiment"] == LIVE:
        return f"{run['link']}, {run['payload_bytes']} B under arpd"
    return f"{run['link']}, {run['payload_bytes']} B at {run['deadline_hz']} Hz, DEPTH {run['depth']}"


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, dict):
        for each in value.values():
            yield from _numbers(each)
    elif isinstance(value, float):
        yield value
