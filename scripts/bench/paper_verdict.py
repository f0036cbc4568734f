"""What the paper says of its optimum, held against every fixed configuration; where it does not hold, why."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from itertools import groupby
from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.paper_cells import FIGURES, FIXED_DEPTHS, HEARTBEAT_S
from scripts.bench.paper_numbers import milliseconds, percent

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

LIKE = 2.0  # two latencies are alike within this factor
_FULL_RATIO = 0.9  # of a link, from which on samples queue
_STALL_S = 0.1  # no queue of a link that is not full takes that long


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """One configuration in one experiment over one link, all rounds of it.

    Parameters
    ----------
    runs : the turns that say something
    why_void : what those that say nothing lacked; empty where there are none
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
        """What it is, without the link."""
        return f"{self.payload_bytes} B {self.name_in_link}"

    @property
    def name_in_link(self) -> str:
        """Rate and depth, as the paper writes them."""
        return f"({self.deadline_hz} Hz, {self.depth})"

    @property
    def p50_s(self) -> float | None:
        """End-to-end latency (s)."""
        return self.middle("end_to_end", "p50_s")

    @property
    def p99_s(self) -> float | None:
        """End-to-end latency (s)."""
        return self.middle("end_to_end", "p99_s")

    @property
    def p99_range_s(self) -> tuple[float | None, float | None]:
        """The least and the largest p99 of a round (s)."""
        values = [run["end_to_end"]["p99_s"] for run in self.runs]
        return (None, None) if not values or None in values else (min(values), max(values))

    @property
    def lost(self) -> int:
        """How many samples were lost in all rounds."""
        return sum(run["lost"] for run in self.runs)

    @property
    def lost_ratio(self) -> float | None:
        """Share of all samples of all topics that was lost."""
        published = sum(run["published"] for run in self.runs)
        return self.lost / published if published else None

    @property
    def used_ratio(self) -> float:
        """Share of the link that the robot's traffic took."""
        return self.middle("used_ratio") or 0.0

    @property
    def overflows(self) -> int:
        """How many datagrams found their socket's buffer full in all rounds: no loss of the link's."""
        return sum(run["receive_buffer_overflows"] for run in self.runs)

    def middle(self, *keys: str) -> float | None:
        """Median of a figure over rounds; None where a round has none."""
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
    rmax_hz : the Rmax the optimum is for (Hz)
    at_rmax : the fixed configurations at that rate, the smaller DEPTH first
    slower_than : those that lose nothing and whose p99 is not above the optimum's
    lossier_than : those of a like latency that lose less than the optimum
    """

    rmax_hz: int
    optimum: Cell
    at_rmax: tuple[Cell, ...]
    slower_than: tuple[Cell, ...]
    lossier_than: tuple[Cell, ...]


def rounds(document: dict[str, Any]) -> str:
    """Say how often every configuration was measured; a run that was interrupted has measured some more often."""
    counts = Counter((run["experiment"], *_place(run)) for run in document["runs"])
    least, most = (min(counts.values()), max(counts.values())) if counts else (0, 0)
    spoken = f"{least}" if least == most else f"{least} to {most}"
    return f"{spoken} round{'s' * (most != 1)} of {document['conditions']['seconds']:g} s"


def _place(run: dict[str, Any]) -> tuple[Any, ...]:
    names = ("link", "link_loss", "heartbeat", "payload_bytes", "deadline_hz", "depth")
    return tuple(run[name] for name in names)


def cells(document: dict[str, Any], experiment: str) -> list[Cell]:
    """Return every configuration of an experiment, by link, payload, rate and depth."""
    runs = [run for run in document["runs"] if run["experiment"] == experiment and "failed" not in run]
    found = []
    for about, together in groupby(sorted(runs, key=_place), key=_place):
        link, link_loss, heartbeat, payload_bytes, deadline_hz, depth = about
        every = list(together)
        found.append(
            Cell(
                link=link,
                link_loss=link_loss,
                heartbeat=heartbeat,
                payload_bytes=payload_bytes,
                deadline_hz=deadline_hz,
                depth=depth,
                runs=tuple(run for run in every if not run["void"]),
                why_void=" ".join(sorted({f"void: {run['void']}" for run in every if run["void"]})),
            )
        )
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


def misses(document: dict[str, Any], judged: Sequence[Verdict]) -> Iterator[str]:
    """Yield a sentence for every reason why optima miss a target: the worst case of each, and both numbers."""
    losses = {link["name"]: link["loss"] for link in document["links"]}
    slow: dict[str, list[tuple[float, str]]] = {}
    lossy: dict[str, list[tuple[float, str]]] = {}
    for verdict in judged:
        best = verdict.optimum
        if verdict.slower_than:
            other = min(verdict.slower_than, key=lambda cell: cell.p99_s or 0.0)
            pair = (
                f"{best.name} {milliseconds(best.p99_s)} ms against {other.name_in_link} {milliseconds(other.p99_s)} ms"
            )
            by = (best.p99_s or math.inf) - (other.p99_s or 0.0)
            slow.setdefault(_why_slower(best, other, losses[best.link]), []).append((by, pair))
        if verdict.lossier_than:
            other = min(verdict.lossier_than, key=lambda cell: cell.lost_ratio or 0.0)
            pair = (
                f"{best.name} {percent(best.lost_ratio)} % against {other.name_in_link} {percent(other.lost_ratio)} %"
            )
            by = (best.lost_ratio or 0.0) - (other.lost_ratio or 0.0)
            lossy.setdefault(_why_lossier(best), []).append((by, pair))
    for what, found in (("p99", slow), ("loss", lossy)):
        for why, pairs in found.items():
            worst = max(pairs)[1]
            yield f"{what}, {why}: {worst if len(pairs) == 1 else f'{len(pairs)} optima, most {worst}'}."


def _why_slower(best: Cell, other: Cell, link_loss: float) -> str:
    if best.used_ratio >= _FULL_RATIO:
        return "the optimum fills the link itself, which has less than this Rmax for samples of that size"
    low, high = best.p99_range_s[0], other.p99_range_s[1]
    if low is not None and high is not None and low < high:
        return "the two differ by less than the rounds do"
    if best.p99_s is not None and best.p99_s > _STALL_S and (link_loss > 0.0 or best.overflows):
        lost = "a lost packet" if link_loss > 0.0 else "what a full socket of this machine dropped"
        return f"{lost} is sent again only after a heartbeat of {HEARTBEAT_S[best.heartbeat]:g} s"
    if other.used_ratio < _FULL_RATIO:
        return "the fixed configuration does not fill the link either, so nothing queues"
    return "for a reason these figures do not tell"


def _why_lossier(best: Cell) -> str:
    if best.used_ratio >= _FULL_RATIO:
        return "the optimum fills the link itself, which has less than this Rmax for samples of that size"
    if best.overflows:
        return f"sockets of this machine overflowed ({best.overflows} datagrams)"
    return "for a reason these figures do not tell"
