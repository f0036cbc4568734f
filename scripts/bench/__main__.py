"""List the benchmarks, run them, and write docs/results.md from what they found.

Usage: python -m scripts.bench                          list them, with the date of each
       python -m scripts.bench NAME … [--quick|--full]  run those that have not measured this tree; `usual`: for an
                                                        hour, `all`: every one; --again: also those that have
       python -m scripts.bench --docs                   only write docs/results.md and README.md's table

Most need root, as the simulated link does, and a machine that does nothing else: a run that another process disturbed
is void, and is not kept. With --quick, --tree or, but for robots, --only nothing is kept but in --out. --full has
more rounds, seeds and sizes, for hours.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import time
from pathlib import Path
from typing import Any

from scripts.bench.harness import conditions, watched
from scripts.bench.report import RESULTS, Summary, targets, write_pages
from scripts.bench.robots import CELL, USUAL_CELLS, summary_of
from scripts.bench.world import TREE

#: By name: module and function that return the summary, about how many minutes it takes, and those of the quick form.
SCENARIOS = {
    "demo": ("demo.play", 1.5, 1.5, "does the demo show what arpd is for?"),
    "robots": ("robots.play", 46, 1.5, "how do robots on changing links fare with arpd, and with what else there is?"),
    "paper": ("paper.play", 6, 1.5, "does the paper's optimum hold with real ROS 2?"),
    "swap": ("swap.play", 5, 1.5, "what does a change of QoS lose?"),
    "faults": ("faults.play", 6, 2.5, "what is lost when processes and links fail, and how soon does it flow again?"),
    "cost": ("cost.play_topics", 5, 1, "what do 12 to 1,000 topics cost?"),
    "pi": ("cost.play_pi", 4, 1, "does a Raspberry Pi suffice?"),
    "relay": ("cost.play_relay", 4, 1, "what does a relayed message cost?"),
    "rest": ("cost.play_rest", 3, 1, "what does a link carry at rest?"),
    "http": ("cost.play_http", 1.5, 1, "do scrapes and idle clients delay ticks?"),
    "estimate": ("estimate.play", 4, 1, "how good is the estimate beside the bound, in virtual time?"),
    "traces": ("traces.play", 3, 0.5, "how much of a recorded link is used, and how long do packets wait for it?"),
    "solve": ("solve.play", 0.5, 0.5, "how fast is a plan?"),
    "fuzz": ("fuzz.play", 3, 0.5, "does foreign input crash a reader?"),
}
#: What `usual` plays, in an hour.
USUAL = ("demo", "robots", "relay", "http", "traces", "estimate", "solve")
#: Scenarios of which each part is kept: what makes a summary of rounds, and how many cells of a round name it.
PARTS = {"robots": (summary_of, len(CELL))}
#: Scenarios whose parts have names.
NAMED = ("robots", "estimate", "fuzz")
FULL_ROUNDS = 3


def is_known(name: str) -> bool:
    """Return whether a benchmark has measured this tree, all of it; without git nobody knows which one it is."""
    path, now = RESULTS / f"{name}.json", conditions()
    if not (path.exists() and now["tree"]):
        return False
    kept = Summary.read(path)
    played = {tuple(row[: len(CELL)]) for row in kept.rounds.rows} if kept.rounds else set()
    return (name not in PARTS or played >= {*USUAL_CELLS}) and not any(
        each["is_modified"] or each.get("tree") != now["tree"] for each in (now, *kept.conditions)
    )


def is_valid(name: str, *, is_quick: bool, asked: dict[str, Any], is_part: bool, out: Path | None) -> bool:
    """Run a benchmark, print its summary and keep it; return whether it is, unless it is a short form, valid."""
    plays, *minutes, _ = SCENARIOS[name]
    module, _, function = plays.partition(".")
    print(f"{name}: about {minutes[is_quick]:g} min, load average {os.getloadavg()[0]:.1f}", flush=True)
    began_s = time.monotonic()
    with watched() as noted:
        play = getattr(importlib.import_module(f"scripts.bench.{module}"), function)
        summary: Summary = play(is_quick=is_quick, **{key: value for key, value in asked.items() if value})
    summary.conditions.append(noted | ({"of": asked["only"]} if asked["only"] else {}))
    print(targets({name: summary}), summary.markdown(), f"{time.monotonic() - began_s:.0f} s", sep="\n\n", flush=True)
    path = (out or RESULTS) / f"{name}.json"
    if out or not (is_part or noted.get("void")):
        if asked["only"] and name in PARTS and path.exists():
            made, names = PARTS[name]
            summary = Summary.read(path).with_part(summary, made, names=names)
        summary.write(path)
    return is_quick or not noted.get("void")


def listed() -> str:
    """Return every benchmark with its question, and when it was measured."""
    lines = []
    for name, (_, minutes, _, question) in SCENARIOS.items():
        path = RESULTS / f"{name}.json"
        kept = Summary.read(path).conditions if path.exists() else []
        when = ", ".join(dict.fromkeys(f"{one['date']} at {one['commit'][:7]}" for one in kept)) or "never"
        lines.append(f"{name:9} {minutes:4g} min  {question}  ({when})")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m scripts.bench", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join([*SCENARIOS, "usual", "all"]))
    parser.add_argument("--quick", action="store_true", help="the short forms, a minute or two each")
    parser.add_argument("--full", action="store_true", help="the long forms: more rounds, seeds and sizes")
    parser.add_argument("--again", action="store_true", help="also those that this tree was measured by")
    about = f"{', '.join(NAMED)}: parts whose names have it; of robots a regular expression"
    parser.add_argument("--only", default="", metavar="TEXT", help=about)
    parser.add_argument("--folder", type=Path, help="traces: your own recordings; nothing is kept but in --out")
    parser.add_argument("--tree", type=Path, help="arpd's own processes from another source tree; nothing is kept")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="keep the summaries there")
    parser.add_argument("--docs", action="store_true", help="write docs/results.md and README.md from the summaries")
    options = parser.parse_args()
    is_part = bool(
        options.quick or options.tree or options.folder or (options.only and not PARTS.keys() >= {*options.names})
    )
    if options.tree:
        os.environ[TREE] = str(options.tree.resolve())
    names = {("all",): [*SCENARIOS], ("usual",): [*USUAL]}.get(tuple(options.names), options.names)
    if unknown := sorted({*names} - {*SCENARIOS}):
        parser.error(f"no benchmark {', '.join(unknown)}; there are {', '.join(SCENARIOS)}")
    able = ("traces",) if options.folder and not options.only else NAMED
    if (options.only or options.folder) and (others := sorted({*names} - {*able})):
        parser.error(f"--only, --folder: no such parts in {', '.join(others)}; there are some in {', '.join(able)}")
    if not names and not options.docs:
        print(listed())
        return 0
    asked = {"only": options.only, "folder": options.folder, "rounds": options.full and FULL_ROUNDS}
    wrong = []
    for name in names:
        if not (is_part or options.again or options.only) and is_known(name):
            print(f"{name}: this tree has been measured")
        elif not is_valid(name, is_quick=options.quick, asked=asked, is_part=is_part, out=options.out):
            wrong.append(name)
    if options.docs or (names and not (is_part or options.out)):
        write_pages()
    if wrong:
        print(f"void, and not kept: {', '.join(wrong)}")
    return len(wrong) > 0


if __name__ == "__main__":
    sys.exit(main())
