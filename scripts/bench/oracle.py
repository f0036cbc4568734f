"""Run `arpd run` with an estimator that knows the course of the link: the bound.

Usage: python -m scripts.bench.oracle --config FILE --truth FILE

The truth is a JSON file: the link's course, and when it began. The capacity is the mean of the next 0.2 s, as in the
simulator; queue and delivery come from the robot's own interface. Budget, price, pacing, governor, swaps and relay are
arpd's.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections import deque
from pathlib import Path

from arpd.daemon.run import run_daemon
from arpd.host.netlink import read_counters
from arpd.model.link import CapacityKind, LinkEstimate, LinkState
from arpd.sim.oracle import Oracle
from arpd.sim.schedule import RateSchedule, RateStep, Service
from scripts.bench.links import Course, at
from scripts.netns.simlink import INTERFACE

AHEAD_S = 0.2  # as `arpd.daemon.scenario` averages the truth


def write_truth(path: Path, course: Course, started_s: float | None = None) -> None:
    """Tell the oracle the course, and when it began (monotonic s); None = not yet, and its first rate holds."""
    fresh = path.with_suffix(".new")
    fresh.write_text(json.dumps({"course": course, "started_s": started_s}))
    fresh.replace(path)


class Witness:
    """Tells the truth of the moment: the course from the file, queue and delivery from this host's interface."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._left: deque[tuple[float, int]] = deque()  # when (s), and the bytes that had left the interface by then
        self._read()

    def _read(self) -> None:
        found = json.loads(self._path.read_text())
        self._course: Course = [(start_s, rate, loss) for start_s, rate, loss in found["course"]]
        self._started_s = math.inf if found["started_s"] is None else found["started_s"]
        steps = (RateStep(start_s=start_s, rate_bytes_per_second=rate) for start_s, rate, _ in self._course)
        self._service = Service(RateSchedule(steps=tuple(steps)))

    def truth(self) -> LinkEstimate:
        """Return the truth of now."""
        if math.isinf(self._started_s):
            self._read()
        now_s, waiting_bytes = time.monotonic(), 0
        if counters := read_counters(INTERFACE):
            waiting_bytes = counters.backlog_bytes or 0
            self._left.append((now_s, counters.tx_bytes))
        while len(self._left) > 1 and self._left[1][0] <= now_s - AHEAD_S:
            self._left.popleft()
        span_s = self._left[-1][0] - self._left[0][0] if self._left else 0.0
        elapsed_s = max(0.0, now_s - self._started_s)
        carried, loss = self._service.by(elapsed_s), at(self._course, elapsed_s)[1]
        return LinkEstimate(
            kind=CapacityKind.CONFIGURED,
            state=LinkState.OUTAGE if loss >= 1.0 else LinkState.STEADY,
            age_s=0.0,
            evidence="the truth",
            capacity_bytes_per_second=(self._service.by(elapsed_s + AHEAD_S) - carried) / AHEAD_S,
            queue_delay_s=self._service.when(carried + waiting_bytes) - elapsed_s if waiting_bytes else 0.0,
            delivery_rate_bytes_per_second=(self._left[-1][1] - self._left[0][1]) / span_s if span_s > 0 else 0.0,
            loss_ratio=None if loss >= 1.0 else loss,
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--truth", type=Path, required=True)
    options = parser.parse_args()
    estimator = Oracle(Witness(options.truth).truth)
    return run_daemon(config_path=options.config, log_level="info", estimator=estimator)


if __name__ == "__main__":
    sys.exit(main())
