"""Run every benchmark, one after the other, and fill docs/results.md and README.md with the results.

Usage: scripts/bench/all [--quick] [--only NAME,...]

Needs root, as the simulated link does, and a machine that does nothing else during the time it prints. The output of
each benchmark goes to the folder that the first line names. If a benchmark fails, the others still run, and the exit
code is 1. With --quick, the short forms run and write to that folder only: results and pages do not change.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from arpd.cli.progress import progress
from scripts.bench.record import REPO

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, kw_only=True, slots=True)
class Benchmark:
    """A benchmark: its module in scripts/bench, roughly its duration (s), and whether it draws a picture."""

    name: str
    lasts_s: float
    quick_s: float
    has_plot: bool = False

    def command(self, folder: Path, *, is_quick: bool) -> list[str]:
        """Return the command that runs it; a quick run writes into the folder, a complete one into results/."""
        command = [sys.executable, "-u", "-m", f"scripts.bench.{self.name}"]
        if is_quick:
            command += ["--quick", "--json", str(folder / f"{self.name}.json")]
            if self.has_plot:
                command += ["--plot", str(folder / f"{self.name}.png")]
        return command


#: Fuzz comes before reliability, because the table of reliability shows its findings.
BENCHMARKS = (
    Benchmark(name="demo", lasts_s=110, quick_s=110),
    Benchmark(name="solve", lasts_s=60, quick_s=15),
    Benchmark(name="estimate", lasts_s=520, quick_s=60, has_plot=True),
    Benchmark(name="swap", lasts_s=2900, quick_s=70),
    Benchmark(name="relay", lasts_s=360, quick_s=70, has_plot=True),
    Benchmark(name="discovery", lasts_s=350, quick_s=40),
    Benchmark(name="fuzz", lasts_s=760, quick_s=60),
    Benchmark(name="reliability", lasts_s=920, quick_s=280),
    Benchmark(name="two_ends", lasts_s=650, quick_s=150),
    Benchmark(name="http_load", lasts_s=480, quick_s=50),
    Benchmark(name="paper", lasts_s=2000, quick_s=70),
    Benchmark(name="adapt", lasts_s=2300, quick_s=60),
    Benchmark(name="overhead", lasts_s=1500, quick_s=50),
    Benchmark(name="pi", lasts_s=1700, quick_s=110),
)


def run(benchmarks: Sequence[Benchmark], folder: Path, *, is_quick: bool) -> dict[str, str]:
    """Run the benchmarks; return the failures by name."""
    wrong: dict[str, str] = {}
    lasts_s = [each.quick_s if is_quick else each.lasts_s for each in benchmarks]
    with progress("benchmarks", total=sum(lasts_s)) as shown:
        for number, each in enumerate(benchmarks):
            shown.reach(sum(lasts_s[:number]), each.name)
            print(f"{each.name:<12} ", end="", flush=True)
            started_s, log = time.monotonic(), folder / f"{each.name}.log"
            with log.open("w", encoding="utf-8") as written:
                command = each.command(folder, is_quick=is_quick)
                code = subprocess.run(
                    command, cwd=REPO, stdout=written, stderr=subprocess.STDOUT, check=False
                ).returncode
            took = f"{time.monotonic() - started_s:6.0f} s"
            print(took if not code else f"{took}  failed with {code}: {_last_line(log)}", flush=True)
            if code:
                wrong[each.name] = str(log)
    return wrong


def _last_line(log: Path) -> str:
    lines = [line for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    return lines[-1][:160] if lines else "no output"


def chosen(only: str) -> list[Benchmark]:
    """Return the benchmarks with these names, in the order of `BENCHMARKS`.

    Raises
    ------
    ValueError
        If a name is unknown.
    """
    names = {name.strip() for name in only.split(",") if name.strip()}
    known = [each.name for each in BENCHMARKS]
    if unknown := sorted(names - {*known}):
        raise ValueError(f"{', '.join(unknown)}: no such benchmark; there are {', '.join(known)}")
    return [each for each in BENCHMARKS if not names or each.name in names]


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="scripts/bench/all", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="run the short forms; results and pages do not change")
    parser.add_argument("--only", default="", metavar="NAME,...", help="run only these")
    options = parser.parse_args()
    try:
        benchmarks = chosen(options.only)
    except ValueError as error:
        parser.error(f"--only: {error}")
    folder = Path(tempfile.mkdtemp(prefix="arpd-bench-"))
    minutes = sum(each.quick_s if options.quick else each.lasts_s for each in benchmarks) / 60
    print(
        f"{len(benchmarks)} benchmarks, about {minutes:.0f} minutes; load average {os.getloadavg()[0]:.1f}; "
        f"their output goes to {folder}",
        flush=True,
    )
    wrong = run(benchmarks, folder, is_quick=options.quick)
    if not options.quick:
        code = subprocess.run([sys.executable, "-m", "scripts.bench.results_page"], cwd=REPO, check=False).returncode
        if code:
            wrong["docs/results.md"] = "not written"
    if wrong:
        print(f"failed: {', '.join(f'{name} ({why})' for name, why in wrong.items())}")
        return 1
    print("all benchmarks ran" + ("" if options.quick else "; docs/results.md has the results"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
