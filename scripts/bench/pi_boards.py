"""The boards of `pi.py`: how fast a core of each is beside one of this machine, by published figures.

A Raspberry Pi 4 takes 79.2 s for a benchmark in pure Python; this machine runs the same arithmetic. No such figure of a
Raspberry Pi 5 was found, so its core is as much faster than a Raspberry Pi 4's as 7-Zip's single-threaded benchmark
says. Other figures are noted, but nothing is computed from them.
"""

from __future__ import annotations

import math
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

CORES = 4
MEMORY_BYTES = 2**30
_PERIOD_US, _LEAST_QUOTA_US = 5000, 1000  # the kernel takes no quota below a millisecond
_PASSES = 5

PI_4_S = 79.216
PI_4_MIPS, PI_5_MIPS = 1769, 2967
SOURCES: dict[str, dict[str, Any]] = {
    "Raspberry Pi 4, pure Python (s)": {
        "value": PI_4_S,
        "source": "github.com/alexdedyura/cpu-benchmark, README.md at 65b79fb: Raspberry Pi 4, Ubuntu 22.04.3",
        "note": "Ubuntu 22.04 has Python 3.10, slower than this machine's; so the quota is rather too small",
    },
    "Raspberry Pi 4, 7-Zip, one thread (MIPS)": {
        "value": PI_4_MIPS,
        "source": "github.com/ThomasKaiser/sbc-bench, results/Sorted-Results.md: 1800 MHz, Bullseye arm64",
    },
    "Raspberry Pi 5, 7-Zip, one thread (MIPS)": {
        "value": PI_5_MIPS,
        "source": "github.com/ThomasKaiser/sbc-bench, results/reviews/RPi-5B-Rev1.0.md: 2400 MHz, Debian 12",
    },
    "Raspberry Pi 5 beside 4, sysbench, one thread (ratio)": {
        "value": round(2737.49 / 1477.83, 3),
        "source": "leoncode.co.uk/articles/raspberry-pi-benchmarks",
        "note": "not used: it divides integers only",
    },
    "Raspberry Pi 5, Geekbench 6, one core": {
        "value": 748,
        "source": "github.com/geerlingguy/sbc-reviews/issues/21",
        "note": "not used: no figure of this machine",
    },
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Board:
    """A computer.

    Parameters
    ----------
    name : as the tables have it
    share : speed of its core beside one of this machine (0..1); None = this machine, without a limit
    """

    name: str
    share: float | None = None

    def quota(self, cores: int = 1) -> tuple[int, int]:
        """Return quota and period that give cores of this board (us).

        With the kernel's period of 100 ms, a thread on a Pi 4's core would run for 20 ms and wait for 80. This period
        is about the least that the tick of 4 ms and the least quota of 1 ms allow. A loop on a Pi 4's core then runs
        for 1 ms and waits for 4 (medians, measured), and its ticks of 100 ms see a slow core.
        """
        assert self.share is not None
        period_us = max(_PERIOD_US, math.ceil(_LEAST_QUOTA_US / self.share))
        return round(cores * self.share * period_us), period_us


THIS = Board(name="this machine")


def boards(here_s: float) -> dict[str, Board]:
    """Return the boards by short name.

    Parameters
    ----------
    here_s : time that one core of this machine takes for the work that takes a Raspberry Pi 4 `PI_4_S` (s)
    """
    pi_4 = min(1.0, here_s / PI_4_S)
    return {
        "pi4": Board(name="Pi 4", share=pi_4),
        "pi5": Board(name="Pi 5", share=min(1.0, pi_4 * PI_5_MIPS / PI_4_MIPS)),
        "none": THIS,
    }


def reference() -> dict[str, float]:
    """Return the shortest time for the work of `pi_reference.py` of each Python here (s of CPU)."""
    script = str(Path(__file__).with_name("pi_reference.py"))
    found = {}
    for python in dict.fromkeys(filter(None, (sys.executable, shutil.which("python3", path="/usr/bin")))):
        runs = [
            subprocess.run([python, "-I", script], capture_output=True, text=True, check=True) for _ in range(_PASSES)
        ]
        found[python] = min(float(each.stdout) for each in runs)
    return found
