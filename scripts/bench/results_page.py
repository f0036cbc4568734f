"""Fill the generated blocks of docs/results.md and README.md from the benchmarks' documents in scripts/bench/results.

Usage: .venv/bin/python scripts/bench/results_page.py [--check]

A benchmark's report module writes the text between `<!-- NAME:begin -->` and `<!-- NAME:end -->` from the JSON; nobody
types a figure there by hand. A block without results stays as it is. With --check the program writes nothing, prints
the differences, and exits with 1 if there are any.
"""

from __future__ import annotations

import argparse
import difflib
import importlib
import re
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from scripts.bench.record import REPO, RESULTS, read

if TYPE_CHECKING:
    from collections.abc import Mapping

_WIDTH = 130


@dataclass(frozen=True, kw_only=True, slots=True)
class Block:
    """A generated block of a page.

    Parameters
    ----------
    results : names of the documents
    report : module of scripts/bench that writes the block
    function : function of that module; takes the documents
    """

    results: tuple[str, ...]
    report: str
    function: str = "markdown"

    def text(self, results: Path) -> str | None:
        """Return the block's Markdown; None while a document is missing."""
        paths = [results / f"{name}.json" for name in self.results]
        if not all(path.exists() for path in paths):
            return None
        documents = map(read, paths)
        # Imported late: without results, the report's module need not be importable.
        write = getattr(importlib.import_module(f"scripts.bench.{self.report}"), self.function)
        return "\n".join(map(_wrapped, str(write(*documents)).strip("\n").split("\n")))


PAGES: Mapping[Path, Mapping[str, Block]] = {
    REPO / "README.md": {
        "adapt-summary": Block(results=("adapt",), report="adapt_report", function="summary"),
        "sizes": Block(results=("pi",), report="pi_report", function="sizes"),
    },
    REPO / "docs/results.md": {
        "demo": Block(results=("demo",), report="demo_report"),
        "adapt": Block(results=("adapt",), report="adapt_report"),
        "paper": Block(results=("paper",), report="paper_report"),
        "overhead": Block(results=("overhead",), report="overhead_report"),
        "pi": Block(results=("pi",), report="pi_report"),
        "reliability": Block(results=("reliability", "fuzz"), report="reliability_report"),
        "two_ends": Block(results=("two_ends",), report="two_ends_report"),
        "estimate": Block(results=("estimate", "link"), report="capacity_report"),
        "weights": Block(results=(), report="weights_report"),
        "solve": Block(results=("solve",), report="solve_report"),
        "swap": Block(results=("swap",), report="swap_report"),
        "soak": Block(results=("soak",), report="soak_report"),
        "relay": Block(results=("relay",), report="relay_report"),
        "discovery": Block(results=("discovery",), report="discovery_report"),
        "exposition": Block(results=("exposition",), report="exposition_report"),
    },
}
_BLOCK = re.compile(r"<!-- (?P<name>[\w-]+):begin -->\n(?P<text>.*?)<!-- (?P<end>[\w-]+):end -->\n", re.DOTALL)


def _wrapped(line: str) -> str:
    """Break prose and bullets to the width of the page; tables, headings, pictures and HTML stay whole."""
    if not line or line.startswith(("|", "#", "<", "!", "```", "    ")):
        return line
    bullet = re.match(r" *- ", line)
    indent = " " * len(bullet[0]) if bullet else ""
    return textwrap.fill(line, _WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


class MarkerError(Exception):
    """The markers of a page do not match its blocks."""


def regenerated(page: str, blocks: Mapping[str, Block], results: Path) -> str:
    """Return a page with every block rewritten that has results.

    Raises
    ------
    MarkerError
        If a block has no markers or several, or a marker names no block.
    """
    found = [match["name"] for match in _BLOCK.finditer(page)]
    if sorted(found) != sorted(blocks):
        wrong = sorted({*found} ^ {*blocks}) or sorted(name for name in {*found} if found.count(name) > 1)
        raise MarkerError(f"these have no markers, several, or no block in results_page.py: {', '.join(wrong)}")

    def written(match: re.Match[str]) -> str:
        name = match["name"]
        if match["end"] != name:
            raise MarkerError(f"the end marker of {name} names {match['end']}")
        text = blocks[name].text(results)
        return match[0] if text is None else f"<!-- {name}:begin -->\n{text}\n<!-- {name}:end -->\n"

    return _BLOCK.sub(written, page)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="print the differences and write nothing")
    options = parser.parse_args()
    before = {path: path.read_text(encoding="utf-8") for path in PAGES}
    after: dict[Path, str] = {}
    for path, blocks in PAGES.items():
        try:
            after[path] = regenerated(before[path], blocks, RESULTS)
        except MarkerError as error:
            sys.exit(f"{path.relative_to(REPO)}: {error}")
    for path in PAGES:
        name = str(path.relative_to(REPO))
        if options.check:
            now, wanted = before[path].splitlines(keepends=True), after[path].splitlines(keepends=True)
            sys.stdout.writelines(difflib.unified_diff(now, wanted, name, "from the results", n=1))
        else:
            path.write_text(after[path], encoding="utf-8")
    if options.check:
        sys.exit(int(before != after))
    for name, block in (item for blocks in PAGES.values() for item in blocks.items()):
        if missing := [result for result in block.results if not (RESULTS / f"{result}.json").exists()]:
            print(f"{name} stays as it is, because {missing[0]}.json is missing")


if __name__ == "__main__":
    main()
