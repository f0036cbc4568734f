"""A grid of links and robots for `scripts/bench/estimate.py`, of which a sample is played beside the bound.

A cell is a link that changes its capacity once, and everything that may disturb the estimate. Its queue and goodput
after the change are judged against the bound's, so what no estimate can avoid does not count:

p50, p99            (queue + 10 ms) / (the bound's + 10 ms), each that percentile of the moments after the change
goodput             payload that the bound delivers after the change, over arpd's
ratio               the largest of the three; 1 = as good as the bound
"""

from __future__ import annotations

import logging
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields
from functools import partial
from random import Random
from statistics import median
from typing import TYPE_CHECKING, Any

from arpd.adapters.sim.baselines import Oracle
from arpd.adapters.sim.demo import demo_topics
from arpd.adapters.sim.foreign import ForeignFlow
from arpd.adapters.sim.link import LinkModel
from arpd.adapters.sim.result import percentile
from arpd.adapters.sim.schedule import RateSchedule, RateStep
from arpd.cli.progress import progress
from arpd.daemon.compare import between
from arpd.daemon.scenario import run
from scripts.bench.estimate_scenarios import BUSY_ROBOT, LIGHT_ROBOT, LOCAL_MAP, LOW_FLOORS, MBIT
from scripts.bench.report import milli, paragraphs, scaled, table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.daemon.scenario import ScenarioResult

CELLS = 160  # about five minutes on two cores
SEED = 1
SHOWN = 10
_CHANGE_S, _END_S = 14.0, 30.0
_USUAL = 0.6  # probability that a disturbance is absent
_GRACE_S = 0.01
_ROBOTS = {"light": LIGHT_ROBOT, "demo": demo_topics(), "busy": BUSY_ROBOT}
_OVERHEAD_S = 200e-6


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """One link with its robot; the first choice of each disturbance is its absence.

    Parameters
    ----------
    before_mbit, change : capacity before the change (Mbit/s), and that after it as a multiple
    load : robot that publishes 4, 12 or 27 Mbit/s
    upload : other traffic from the robot, as a share of the smaller capacity
    download_mbit : other traffic into the peer, which does not cross the link
    loss : share of packets lost at random
    queue_bytes : queue in front of the link
    is_unseen : the queue is out of the host's sight
    aggregate : packets that share a transmission; each takes 200 us beyond its bytes. 0 = neither
    has_map : a publisher of 2 MB samples that nobody remote reads
    has_peer : a peer reports
    """

    before_mbit: float
    change: float
    load: str
    upload: float = 0.0
    download_mbit: float = 0.0
    loss: float = 0.0
    queue_bytes: int = 256_000
    is_unseen: bool = False
    aggregate: int = 0
    has_map: bool = False
    has_peer: bool = True

    @property
    def text(self) -> str:
        """What is not as usual, in words."""
        parts = [f"{self.before_mbit:g}→{self.before_mbit * self.change:.3g}", self.load]
        usual = {field.name: field.default for field in fields(self)}
        for name, spelled in (
            ("upload", f"upload {100 * self.upload:g} %"),
            ("download_mbit", f"download {self.download_mbit:g}"),
            ("loss", f"loss {100 * self.loss:g} %"),
            ("queue_bytes", f"queue {self.queue_bytes / 1000:g} kB"),
            ("is_unseen", "unseen"),
            ("aggregate", f"aggregates of {self.aggregate}"),
            ("has_map", "local map"),
            ("has_peer", "no peer"),
        ):
            if getattr(self, name) != usual[name]:
                parts.append(spelled)
        return ", ".join(parts)


_ALWAYS: dict[str, Sequence[Any]] = {
    "before_mbit": (20.0, 5.0),
    "change": (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.95, 1.5, 4.0),
    "load": tuple(_ROBOTS),
    "queue_bytes": (64_000, 256_000, 1_500_000),
}
_SOMETIMES: dict[str, Sequence[Any]] = {
    "upload": (0.15, 0.4),
    "download_mbit": (3.0, 40.0),
    "loss": (0.01, 0.05),
    "is_unseen": (True,),
    "aggregate": (1, 16),
    "has_map": (True,),
    "has_peer": (False,),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Judged:
    """One cell, and each figure of arpd's and of the bound's run."""

    cell: Cell
    arpd: dict[str, float]
    bound: dict[str, float]

    @property
    def ratios(self) -> dict[str, float]:
        """Each figure compared with the bound's, above 1 = worse."""
        queues = {name: (self.arpd[name] + _GRACE_S) / (self.bound[name] + _GRACE_S) for name in ("p50", "p99")}
        return queues | {"goodput": self.bound["goodput"] / max(1.0, self.arpd["goodput"])}

    @property
    def ratio(self) -> float:
        """The largest ratio."""
        return max(self.ratios.values())

    def document(self) -> dict[str, Any]:
        """Return everything for JSON."""
        return {
            "cell": self.cell.text,
            **asdict(self.cell),
            "ratio": round(self.ratio, 3),
            **{
                f"{side}_{name}": round(value, 4)
                for side in ("arpd", "bound")
                for name, value in getattr(self, side).items()
            },
        }


def sample(count: int, seed: int = SEED) -> list[Cell]:
    """Draw cells; a longer sample begins with the shorter one."""
    random = Random(f"grid {seed}")
    cells = []
    for _ in range(count):
        chosen = {name: random.choice(choices) for name, choices in _ALWAYS.items()}
        for name, choices in _SOMETIMES.items():
            choice, is_absent = random.choice(choices), random.random() < _USUAL
            if not is_absent:
                chosen[name] = choice
        cells.append(Cell(**chosen))
    return cells


def play_grid(count: int, *, processes: int) -> list[Judged]:
    """Play a sample, the worst cell first."""
    if not (cells := sample(count)):
        return []
    with ProcessPoolExecutor(processes) as pool, progress("playing the grid", total=count) as shown:
        judged = []
        for cell, figures in zip(cells, pool.map(_play, cells), strict=True):
            judged.append(Judged(cell=cell, arpd=figures[0], bound=figures[1]))
            shown.reach(len(judged))
    return sorted(judged, key=lambda each: each.ratio, reverse=True)


def grid_report(judged: Sequence[dict[str, Any]]) -> str:
    """Return the worst cells, which are the first, arpd's figures beside the bound's."""
    if not judged:
        return ""
    pairs = (("queue p50 ms", "p50", milli), ("queue p99 ms", "p99", milli), ("Mbit/s", "goodput", scaled(8e-6, ".1f")))
    return paragraphs(
        f"A grid of links and disturbances, {len(judged)} cells at random (`scripts/bench/estimate_grid.py`): queue or "
        f"goodput is {median([each['ratio'] for each in judged]):.2f} times as bad as the bound's in the median. The "
        "worst cells:",
        table(
            judged[:SHOWN],
            ("", "cell"),
            ("ratio", "ratio", "{:.1f}"),
            *(
                (head if side == "arpd" else "bound's", f"{side}_{name}", form)
                for head, name, form in pairs
                for side in ("arpd", "bound")
            ),
        ),
    )


def _play(cell: Cell) -> tuple[dict[str, float], dict[str, float]]:
    logging.disable(logging.CRITICAL)
    before, after = cell.before_mbit * MBIT, cell.before_mbit * cell.change * MBIT
    steps = ((0.0, before), (_CHANGE_S, after))
    forever = partial(ForeignFlow, start_s=0.0, end_s=2 * _END_S)
    upload, download = cell.upload * min(before, after), cell.download_mbit * MBIT
    one = partial(
        run,
        LOW_FLOORS,
        RateSchedule(steps=tuple(RateStep(start_s=at_s, rate_bytes_per_second=rate) for at_s, rate in steps)),
        _END_S,
        seed=1,
        managed=True,
        model=LinkModel(
            loss=cell.loss,
            queue_bytes=0 if cell.is_unseen else cell.queue_bytes,
            firmware_bytes=cell.queue_bytes if cell.is_unseen else 0,
            packet_overhead_s=_OVERHEAD_S if cell.aggregate else 0.0,
            aggregate_packets=max(1, cell.aggregate),
        ),
        foreign=(forever(rate_bytes_per_second=upload),) if upload else (),
        into_peer=(forever(rate_bytes_per_second=download),) if download else (),
        has_peer=cell.has_peer,
        topics=(*_ROBOTS[cell.load], *((LOCAL_MAP,) if cell.has_map else ())),
    )
    return _figures(one()), _figures(one(make_estimator=Oracle))


def _figures(result: ScenarioResult) -> dict[str, float]:
    span = between(result.moments, _CHANGE_S, _END_S)
    queues = [moment.queue_delay_s for moment in span]
    delivered = span[-1].delivered_bytes - span[0].delivered_bytes
    return {
        "p50": percentile(queues, 0.5) or 0.0,
        "p99": percentile(queues, 0.99) or 0.0,
        "goodput": delivered / (span[-1].t_s - span[0].t_s),
    }
