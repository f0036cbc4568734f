"""Fill the blocks of README.md from what the benchmarks left in scripts/bench/results.

Usage: .venv/bin/python scripts/bench/readme.py [--check]

What stands between `<!-- NAME:begin -->` and `<!-- NAME:end -->` is written by a function of that benchmark's report
from its JSON; nothing there is typed by hand. A block without results stays as it is. With --check nothing is written:
what differs is shown, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import difflib
import importlib
import json
import re
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from scripts.bench.record import REPO, RESULTS

README = REPO / "README.md"
_WIDTH = 130


@dataclass(frozen=True, kw_only=True, slots=True)
class Block:
    """A block of the README.

    Parameters
    ----------
    results : names of the documents it is made from
    report : module of scripts/bench that writes it
    function : of that module, called with the documents
    """

    results: tuple[str, ...]
    report: str
    function: str = "readme"

    def text(self, results: Path) -> str | None:
        """Return the block's Markdown; None while a document is not there."""
        paths = [results / f"{name}.json" for name in self.results]
        if not all(path.exists() for path in paths):
            return None
        documents = [json.loads(path.read_text(encoding="utf-8")) for path in paths]
        # By name, because a report is not needed, and need not be importable, before its results are there.
        write = getattr(importlib.import_module(f"scripts.bench.{self.report}"), self.function)
        return "\n".join(map(_wrapped, str(write(*documents)).strip("\n").split("\n")))


BLOCKS = {
    "adapt-summary": Block(results=("adapt",), report="adapt_report", function="summary"),
    "demo": Block(results=("demo",), report="demo_report"),
    "paper": Block(results=("paper",), report="paper_report"),
    "adapt": Block(results=("adapt",), report="adapt_report"),
    "overhead": Block(results=("overhead",), report="overhead_report"),
    "weights": Block(results=(), report="weights_report"),
    "reliability": Block(results=("reliability", "fuzz"), report="reliability_report"),
    "exposition": Block(results=("exposition",), report="exposition_report"),
    "solve": Block(results=("solve",), report="solve_report"),
    "estimate": Block(results=("estimate", "link"), report="capacity_report"),
    "swap": Block(results=("swap",), report="swap_report"),
    "soak": Block(results=("soak",), report="soak_report"),
    "relay": Block(results=("relay",), report="relay_report"),
}
_BLOCK = re.compile(r"<!-- (?P<name>[\w-]+):begin -->\n(?P<text>.*?)<!-- (?P<end>[\w-]+):end -->\n", re.DOTALL)


def _wrapped(line: str) -> str:
    """Break prose and bullets as the rest of the README is; tables, headings, pictures and HTML stay whole."""
    if not line or line.startswith(("|", "#", "<", "!", "```", "    ")):
        return line
    bullet = re.match(r" *- ", line)
    indent = " " * len(bullet[0]) if bullet else ""
    return textwrap.fill(line, _WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


class ReadmeError(Exception):
    """The README's markers and the blocks there are do not fit."""


def regenerated(readme: str, results: Path) -> str:
    """Return the README with every block that has results written anew.

    Raises
    ------
    ReadmeError
        If a block has no place, more than one, or a marker names no block.
    """
    found = [match["name"] for match in _BLOCK.finditer(readme)]
    if sorted(found) != sorted(BLOCKS):
        wrong = sorted({*found} ^ {*BLOCKS}) or sorted(name for name in {*found} if found.count(name) > 1)
        raise ReadmeError(f"these have no place, no block, or more than one place: {', '.join(wrong)}")

    def written(match: re.Match[str]) -> str:
        name = match["name"]
        if match["end"] != name:
            raise ReadmeError(f"{name} ends as {match['end']}")
        text = BLOCKS[name].text(results)
        return match[0] if text is None else f"<!-- {name}:begin -->\n{text}\n<!-- {name}:end -->\n"

    return _BLOCK.sub(written, readme)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="show what differs, and write nothing")
    options = parser.parse_args()
    before = README.read_text(encoding="utf-8")
    try:
        after = regenerated(before, RESULTS)
    except ReadmeError as error:
        sys.exit(f"README.md: {error}")
    if options.check:
        stands, results = before.splitlines(keepends=True), after.splitlines(keepends=True)
        sys.stdout.writelines(difflib.unified_diff(stands, results, "README.md", "from the results", n=1))
        sys.exit(int(before != after))
    README.write_text(after, encoding="utf-8")
    for name, block in BLOCKS.items():
        if missing := [result for result in block.results if not (RESULTS / f"{result}.json").exists()]:
            print(f"{name} stays as it is: there is no {missing[0]}.json")


if __name__ == "__main__":
    main()
