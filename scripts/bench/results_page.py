"""Fill the generated blocks of docs/results.md and README.md from the benchmarks' documents in scripts/bench/results.

Usage: .venv/bin/python scripts/bench/results_page.py

A benchmark's ``report`` writes the text between `<!-- NAME:begin -->` and `<!-- NAME:end -->` from the JSON; nobody
types a figure there by hand. A block without results stays as it is.
"""

from __future__ import annotations

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


@dataclass(frozen=True, slots=True)
class Block:
    """A generated block of a page.

    Parameters
    ----------
    module : module of scripts/bench that writes the block
    results : names of the documents, which the function takes
    function : function of the module
    """

    module: str
    results: tuple[str, ...]
    function: str = "report"

    def text(self, results: Path) -> str | None:
        """Return the block's Markdown; None while a document is missing."""
        paths = [results / f"{name}.json" for name in self.results]
        if not all(path.exists() for path in paths):
            return None
        # Imported late: without results, the benchmark need not be importable.
        write = getattr(importlib.import_module(f"scripts.bench.{self.module}"), self.function)
        return "\n".join(map(_wrapped, write(*map(read, paths)).strip("\n").split("\n")))


PAGES: Mapping[Path, Mapping[str, Block]] = {
    REPO / "README.md": {
        "adapt-summary": Block("adapt_targets", ("adapt",), "summary"),
        "sizes": Block("pi", ("pi",), "sizes"),
    },
    REPO / "docs/results.md": {
        "demo": Block("demo", ("demo",)),
        "adapt": Block("adapt_targets", ("adapt",)),
        "paper": Block("paper", ("paper",)),
        "overhead": Block("overhead", ("overhead",)),
        "pi": Block("pi", ("pi",)),
        "reliability": Block("reliability_figures", ("reliability", "fuzz")),
        "two_ends": Block("two_ends_findings", ("two_ends",)),
        "estimate": Block("estimate_targets", ("estimate", "adapt")),
        "weights": Block("weights", ()),
        "solve": Block("solve", ("solve",)),
        "swap": Block("swap", ("swap",)),
        "relay": Block("relay", ("relay",)),
        "discovery": Block("discovery", ("discovery",)),
        "http": Block("http_load", ("http_load",)),
    },
}
_BLOCK = re.compile(r"(?P<begin><!-- (?P<name>[\w-]+):begin -->\n).*?(?P<end><!-- (?P=name):end -->\n)", re.DOTALL)


def _wrapped(line: str) -> str:
    """Break prose and bullets to the width of the page; tables, headings, pictures and HTML stay whole."""
    if not line or line.startswith(("|", "#", "<", "!", "```", "    ")):
        return line
    bullet = re.match(r" *- ", line)
    indent = " " * len(bullet[0]) if bullet else ""
    return textwrap.fill(line, _WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def regenerated(page: str, blocks: Mapping[str, Block], results: Path) -> str:
    """Return a page with every block rewritten that has results.

    Raises
    ------
    ValueError
        If a block has no pair of markers or several, or a marker names no block.
    """
    found = [match["name"] for match in _BLOCK.finditer(page)]
    if sorted(found) != sorted(blocks) or len(re.findall(r"<!-- [\w-]+:(?:begin|end) -->", page)) != 2 * len(blocks):
        raise ValueError(f"the page has markers for {', '.join(found)}, and there are blocks for {', '.join(blocks)}")

    def written(match: re.Match[str]) -> str:
        text = blocks[match["name"]].text(results)
        return match[0] if text is None else f"{match['begin']}{text}\n{match['end']}"

    return _BLOCK.sub(written, page)


def main() -> None:
    for path, blocks in PAGES.items():
        path.write_text(regenerated(path.read_text(encoding="utf-8"), blocks, RESULTS), encoding="utf-8")
        for name, block in blocks.items():
            if block.text(RESULTS) is None:
                print(f"{name} stays as it is: a document of {', '.join(block.results)} is missing")


if __name__ == "__main__":
    main()
