"""List the benchmarks, run them, and write docs/results.md from what they found.

Usage: python -m scripts.bench                          list them, and say which have measured this tree
       python -m scripts.bench NAME … [--quick|--full]  run those that have not measured this tree; `usual`: for an
                                                        hour, `all`: every one; --again: also those that have
       python -m scripts.bench --docs                   only write docs/results.md and README.md's table

Most need root, as the simulated link does, and a machine that does nothing else: a run that another process disturbed
is void, is played once more at the end, and is not kept if it is void again. With --quick, --tree or, but for robots,
--only nothing is kept but in --out. --full has more rounds, seeds and sizes, for hours.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import time
from pathlib import Path
from typing import Any

from arpd.model.errors import ArpdError, UsageError
from scripts.bench import robots
from scripts.bench.harness import conditions, watched
from scripts.bench.report import RESULTS, Summary, name_of, targets, write_pages
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
#: Scenarios that are played, and kept, in parts.
PARTS = {"robots": robots.USUAL_PARTS}
#: Scenarios whose parts have names.
NAMED = ("robots", "estimate", "fuzz")
FULL_ROUNDS = 3


def is_known(name: str, part: str = "") -> bool:
    """Return whether a benchmark, or a part of it, has measured this tree; without git nobody knows which one it is."""
    path, now = RESULTS / f"{name}.json", conditions()
    if not (path.exists() and now["tree"]):
        return False
    kept = Summary.read(path)
    noted = kept.conditions
    if name in PARTS:
        played = {name_of(row) for row in (*(kept.rounds.rows if kept.rounds else ()), *kept.failed)}
        wanted = [name_of(cell) for each in ([part] if part else PARTS[name]) for cell in robots.chosen(each)]
        noted = [kept.conditions_of(each) if each in played else {} for each in wanted]
    return all(each and not each["is_modified"] and each.get("tree") == now["tree"] for each in (now, *noted))


def module_of(name: str) -> Any:
    return importlib.import_module(f"scripts.bench.{SCENARIOS[name][0].partition('.')[0]}")


def is_valid(name: str, part: str, options: argparse.Namespace) -> bool:
    """Run a benchmark, print its summary and keep it; return whether it is, unless it is a short form, valid."""
    plays, *minutes, _ = SCENARIOS[name]
    about = minutes[options.quick] / (len(PARTS[name]) if part in PARTS.get(name, ()) else 1)
    print(f"{name} {part}".rstrip() + f": about {about:g} min, load average {os.getloadavg()[0]:.1f}", flush=True)
    asked = {"only": part, "folder": options.folder, "rounds": options.full and FULL_ROUNDS}
    began_s = time.monotonic()
    try:
        with watched() as noted:
            play = getattr(module_of(name), plays.partition(".")[2])
            summary: Summary = play(is_quick=options.quick, **{key: value for key, value in asked.items() if value})
    except ArpdError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return False
    summary.conditions.append(noted | ({"of": part} if part else {}))
    print(targets({name: summary}), summary.markdown(), f"{time.monotonic() - began_s:.0f} s", sep="\n\n", flush=True)
    path = (options.out or RESULTS) / f"{name}.json"
    if options.out or not (options.is_part or noted.get("void")):
        if part and name in PARTS and path.exists():
            summary = Summary.read(path).with_part(summary, robots.summary_of)
        summary.write(path)
    return options.quick or not noted.get("void")


def listed() -> str:
    """Return every benchmark with its question, when it was measured, and whether this tree was."""
    lines = []
    for name, (_, minutes, _, question) in SCENARIOS.items():
        path = RESULTS / f"{name}.json"
        kept = Summary.read(path).conditions if path.exists() else []
        when = ", ".join(dict.fromkeys(f"{one['date']} at {one['commit'][:7]}" for one in kept))
        state = ("known: " if is_known(name) else "to be measured; last: ") + when if when else "never measured"
        lines.append(f"{name:9} {minutes:4g} min  {question}  ({state})")
    return "\n".join(lines)


def parse() -> argparse.Namespace:
    """Return the options; `jobs` has what to play: names of benchmarks, each with the part of it or with none."""
    parser = argparse.ArgumentParser(
        prog="python -m scripts.bench", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join([*SCENARIOS, "usual", "all"]))
    parser.add_argument("--quick", action="store_true", help="the short forms, a minute or two each")
    parser.add_argument("--full", action="store_true", help="the long forms: more rounds, seeds and sizes")
    parser.add_argument("--again", action="store_true", help="also those that this tree was measured by")
    about = f"{', '.join(NAMED)}: parts in whose names this regular expression is found"
    parser.add_argument("--only", default="", metavar="REGEX", help=about)
    parser.add_argument("--folder", type=Path, help="traces: your own recordings; nothing is kept but in --out")
    parser.add_argument("--tree", type=Path, help="arpd's own processes from another source tree; nothing is kept")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="keep the summaries there")
    parser.add_argument("--docs", action="store_true", help="write docs/results.md and README.md from the summaries")
    options = parser.parse_args()
    names = {("all",): [*SCENARIOS], ("usual",): [*USUAL]}.get(tuple(options.names), options.names)
    if unknown := sorted({*names} - {*SCENARIOS}):
        parser.error(f"no benchmark {', '.join(unknown)}; there are {', '.join(SCENARIOS)}")
    able = ("traces",) if options.folder and not options.only else NAMED
    if (options.only or options.folder) and (others := sorted({*names} - {*able})):
        parser.error(f"--only, --folder: no such parts in {', '.join(others)}; there are some in {', '.join(able)}")
    for name in names if options.only else ():
        try:
            module_of(name).chosen(options.only)
        except UsageError as error:
            parser.error(f"{name}: {error}")
    options.is_part = bool(
        options.quick or options.tree or options.folder or (options.only and not PARTS.keys() >= {*names})
    )
    whole = [options.only] if options.is_part or options.only or options.full else []
    options.jobs = [(name, part) for name in names for part in whole or PARTS.get(name, [""])]
    return options


def main() -> int:
    options = parse()
    if options.tree:
        os.environ[TREE] = str(options.tree.resolve())
    if not options.jobs and not options.docs:
        print(listed())
        return 0
    wrong = []
    for name, part in options.jobs:
        if not (options.is_part or options.again or options.only) and is_known(name, part):
            print(f"{name} {part}".rstrip() + ": this tree has been measured")
        elif not is_valid(name, part, options):
            wrong.append((name, part))
    if not options.quick:  # what disturbed them may be over
        wrong = [(name, part) for name, part in wrong if not is_valid(name, part, options)]
    if options.docs or (options.jobs and not (options.is_part or options.out)):
        write_pages()
    if wrong:
        print(f"void or failed, and not kept: {', '.join(' '.join(job).rstrip() for job in wrong)}")
    return len(wrong) > 0


if __name__ == "__main__":
    sys.exit(main())
