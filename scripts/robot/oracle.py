"""Run `arpd run` with an estimator that knows the link.

Usage: python -m scripts.robot.oracle --config FILE --truth FILE

The truth is a JSON file that the benchmark rewrites at every change of the link (`write_truth`); the queue comes from
the robot's own interface. Governor, dwell, swaps and relay are arpd's.
"""

from __future__ import annotations

import argparse
import json
import socket
import sys
from contextlib import suppress
from pathlib import Path

from arpd.adapters.host.netlink import read_backlog
from arpd.adapters.sim.baselines import Oracle, Truth
from arpd.daemon.run import run_daemon
from scripts.netns.simlink import INTERFACE


def write_truth(path: Path, *, capacity_bytes_per_second: float, loss: float) -> None:
    """Write the state of the link for the oracle, which never reads half a file."""
    fresh = path.with_suffix(".new")
    fresh.write_text(json.dumps({"capacity_bytes_per_second": capacity_bytes_per_second, "loss": loss}))
    fresh.replace(path)


def read_truth(path: Path) -> Truth:
    """Read the file, and this host's own queue."""
    truth = json.loads(path.read_text())
    capacity = truth["capacity_bytes_per_second"]
    backlog = None
    with suppress(OSError):
        backlog = read_backlog(socket.if_nametoindex(INTERFACE))
    return Truth(
        capacity_bytes_per_second=capacity,
        queue_delay_s=backlog.waiting_bytes / capacity if backlog else 0.0,
        is_out=truth["loss"] >= 1.0,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--truth", type=Path, required=True)
    options = parser.parse_args()
    estimator = Oracle(lambda: read_truth(options.truth))
    return run_daemon(config_path=options.config, log_level="info", estimator=estimator)


if __name__ == "__main__":
    sys.exit(main())
