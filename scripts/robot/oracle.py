"""Run `arpd run` with an estimator that knows the course of the link: the bound.

Usage: python -m scripts.robot.oracle --config FILE --truth FILE

The truth is a JSON file with the whole course of the link (`write_course`), so the capacity is the mean of the next
0.2 s, as in the simulator. Queue and delivery come from the robot's own interface. Budget, price, pacing, governor,
swaps and relay are arpd's.
"""

from __future__ import annotations

import argparse
import json
import math
import socket
import sys
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from arpd.adapters.host.interface import read_counters
from arpd.adapters.sim.baselines import Oracle, Truth
from arpd.adapters.sim.loss import LossStep, loss_at
from arpd.adapters.sim.schedule import RateSchedule, RateStep
from arpd.adapters.sim.service import Service
from arpd.daemon.run import run_daemon
from scripts.netns.simlink import INTERFACE

if TYPE_CHECKING:
    from collections.abc import Sequence

AHEAD_S = 0.2  # as `arpd.daemon.scenario` averages the truth


def write_course(path: Path, rates: RateSchedule, losses: Sequence[LossStep], *, started_s: float = math.inf) -> None:
    """Write the course of the link for the oracle, which never reads half a file.

    Parameters
    ----------
    started_s : monotonic clock when the course began; inf = it has not begun, and its first rate holds (s)
    """
    course = {
        "started_s": started_s if math.isfinite(started_s) else None,
        "rates": [(step.start_s, step.rate_bytes_per_second) for step in rates.steps],
        "losses": [(step.start_s, step.loss) for step in losses],
    }
    fresh = path.with_suffix(".new")
    fresh.write_text(json.dumps(course))
    fresh.replace(path)


@dataclass(frozen=True, kw_only=True, slots=True)
class Course:
    """The course of the link, as the file has it.

    Parameters
    ----------
    losses : probability of loss over time, by ascending start; none before the first
    started_s : monotonic clock when it began; inf = it has not begun (s)
    """

    rates: RateSchedule
    losses: tuple[LossStep, ...]
    started_s: float

    @classmethod
    def read(cls, path: Path) -> Course:
        """Read the file that `write_course` wrote."""
        found = json.loads(path.read_text())
        return cls(
            rates=RateSchedule(
                steps=tuple(RateStep(start_s=start_s, rate_bytes_per_second=rate) for start_s, rate in found["rates"])
            ),
            losses=tuple(LossStep(start_s=start_s, loss=loss) for start_s, loss in found["losses"]),
            started_s=math.inf if found["started_s"] is None else found["started_s"],
        )

    def truth(self, now_s: float, *, waiting_bytes: int, delivered_bytes_per_second: float) -> Truth:
        """Return the mean capacity of the next 0.2 s, the wait behind the queue, and an outage of now.

        Parameters
        ----------
        now_s : monotonic clock (s)
        waiting_bytes : bytes in the robot's queue
        """
        elapsed_s = max(0.0, now_s - self.started_s)
        service = Service(self.rates, 0.0)
        carried, loss = service.by(elapsed_s), loss_at(self.losses, elapsed_s)
        return Truth(
            capacity_bytes_per_second=(service.by(elapsed_s + AHEAD_S) - carried) / AHEAD_S,
            queue_delay_s=service.when(carried + waiting_bytes) - elapsed_s if waiting_bytes else 0.0,
            delivered_bytes_per_second=delivered_bytes_per_second,
            loss_ratio=loss,
            is_out=loss >= 1.0,
        )


class Witness:
    """Tells the truth of the moment: the course from the file, queue and delivery from this host's interface."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._course = Course.read(path)
        self._left: deque[tuple[float, int]] = deque()  # when (s), and the bytes that had left the interface by then

    def truth(self) -> Truth:
        """Return the truth of now."""
        if math.isinf(self._course.started_s):
            self._course = Course.read(self._path)
        now_s = time.monotonic()
        waiting_bytes = 0
        with suppress(OSError):
            if counters := read_counters(socket.if_nametoindex(INTERFACE)):
                waiting_bytes = counters.backlog_bytes or 0
                self._left.append((now_s, counters.tx_bytes))
        return self._course.truth(now_s, waiting_bytes=waiting_bytes, delivered_bytes_per_second=self._rate(now_s))

    def _rate(self, now_s: float) -> float:
        """Return the rate at which bytes left over about the last 0.2 s (bytes/s)."""
        left = self._left
        while len(left) > 1 and left[1][0] <= now_s - AHEAD_S:
            left.popleft()
        span_s = left[-1][0] - left[0][0] if left else 0.0
        return (left[-1][1] - left[0][1]) / span_s if span_s > 0 else 0.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--truth", type=Path, required=True)
    options = parser.parse_args()
    estimator = Oracle(Witness(options.truth).truth)
    return run_daemon(config_path=options.config, log_level="info", estimator=estimator)


if __name__ == "__main__":
    sys.exit(main())
