"""The paper's claims for its optimum, checked against every fixed configuration, with a reason for each miss."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from itertools import groupby
from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.paper_cells import FIGURES, FIXED_DEPTHS, HEARTBEAT_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

LIKE = 2.0  # two latencies are alike within this factor
FULL = "the optimum fills the link itself, which has less than this Rmax for samples of that size"
SPREAD = "the two differ by less than the rounds do"
UNFILLED = "the fixed configuration does not fill the link either, so nothing queues"
UNKNOWN = "these figures give no reason"
_FULL_RATIO = 0.9  # of a link; above this, samples queue
_STALL_S = 0.1  # longer than any queue of a link that is not full


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


def misses(document: dict[str, Any], judged: Sequence[Verdict]) -> Iterator[str]:
    """Yield a sentence for every reason why optima miss a target, with the worst case and both its numbers."""
    losses = {link["name"]: link["loss"] for link in document["links"]}
    found: dict[tuple[str, str], list[tuple[float, str]]] = {}
    for verdict in judged:
        best = verdict.optimum
        if verdict.slower_than:
            other = min(verdict.slower_than, key=lambda cell: cell.p99_s or 0.0)
            ours, theirs = milliseconds(best.p99_s), milliseconds(other.p99_s)
            by = (best.p99_s or math.inf) - (other.p99_s or 0.0)
            pair = f"{best.name} {ours} ms against {other.name_in_link} {theirs} ms"
            found.setdefault(("p99", why_slower(best, other, losses[best.link])), []).append((by, pair))
        if verdict.lossier_than:
            other = min(verdict.lossier_than, key=lambda cell: cell.lost_ratio or 0.0)
            ours, theirs = percent(best.lost_ratio), percent(other.lost_ratio)
            by = (best.lost_ratio or 0.0) - (other.lost_ratio or 0.0)
            pair = f"{best.name} {ours} % against {other.name_in_link} {theirs} %"
            found.setdefault(("loss", why_lossier(best)), []).append((by, pair))
    for (what, why), pairs in sorted(found.items(), key=lambda item: item[0][0] == "loss"):
        worst = max(pairs)[1]
        yield f"{what}, {why}: {worst if len(pairs) == 1 else f'{len(pairs)} optima, most {worst}'}."


def why_slower(best: Cell, other: Cell, link_loss: float) -> str:
    """Return why the p99 of an optimum is not below that of a fixed configuration without loss."""
    if best.used_ratio >= _FULL_RATIO:
        return FULL
    low, high = best.p99_range_s[0], other.p99_range_s[1]
    if low is not None and high is not None and low < high:
        return SPREAD
    if best.p99_s is not None and best.p99_s > _STALL_S and (link_loss > 0.0 or best.overflows):
        lost = "a lost packet" if link_loss > 0.0 else "a packet that a full socket of this machine dropped"
        return f"{lost} is sent again only after a heartbeat of {HEARTBEAT_S[best.heartbeat]:g} s"
    return UNFILLED if other.used_ratio < _FULL_RATIO else UNKNOWN


def why_lossier(best: Cell) -> str:
    """Return why an optimum loses more than a fixed configuration with a similar latency."""
    if best.used_ratio >= _FULL_RATIO:
        return FULL
    return f"sockets of this machine overflowed ({best.overflows} datagrams)" if best.overflows else UNKNOWN


def milliseconds(value_s: float | None) -> str:
    """Write a time (s) in milliseconds."""
    return "–" if value_s is None else short(value_s * 1e3)


def percent(ratio: float | None) -> str:
    """Write a share in per cent."""
    return "–" if ratio is None else short(ratio * 100.0)


def short(value: float) -> str:
    """Write two significant digits, or all before the point, so that only zero shows as zero."""
    if value == 0.0:
        return "0"
    digits = max(0, 1 - math.floor(math.log10(abs(value))))
    text = f"{value:.{digits}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
