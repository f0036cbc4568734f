"""Sums up pytest's runs: what failed, what was not tested and why, and last the counts in pytest's own form.

Usage: python -m scripts.tested JUNIT.xml...
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

if TYPE_CHECKING:
    from collections.abc import Iterable

_WORDS = ("failed", "passed", "skipped", "errors")


@dataclass(kw_only=True, slots=True)
class Tally:
    """Counts of several runs.

    Parameters
    ----------
    counts : tests by outcome, one of `_WORDS`
    wrong : tests that failed, as pytest calls them
    reasons : skipped tests by reason
    seconds : length of all runs together (s)
    """

    counts: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0


def tally(files: Iterable[Path]) -> Tally:
    """Read the files that pytest has written with --junit-xml and junit_family=xunit1."""
    found = Tally()
    for path in files:
        for suite in ET.parse(path).iter("testsuite"):
            found.seconds += float(suite.get("time", "0"))
            for case in suite.iter("testcase"):
                _count(case, found)
    return found


def _count(case: ET.Element, found: Tally) -> None:
    for tag, word in (("failure", "failed"), ("error", "errors")):
        if case.find(tag) is not None:
            found.counts[word] += 1
            found.wrong.append(_name(case))
            return
    skipped = case.find("skipped")
    if skipped is None:
        found.counts["passed"] += 1
    else:
        found.counts["skipped"] += 1
        found.reasons[_reason(skipped)] += 1


def _name(case: ET.Element) -> str:
    """Return the test's name as pytest writes and reads it."""
    file, of_class = case.get("file", ""), case.get("classname", "")
    if not of_class:  # a whole file: it could not be read
        return file
    module = file.removesuffix(".py").replace("/", ".")
    classes = of_class.removeprefix(module).strip(".").split(".")
    return "::".join(part for part in (file, *classes, case.get("name", "")) if part)


def _reason(skipped: ET.Element) -> str:
    told = skipped.get("message", "")
    if told == "collection skipped":  # of a whole file: the text is a tuple of its path, a line and the reason
        told = str(ast.literal_eval(skipped.text or "('', 0, '')")[2])
    return " ".join(told.removeprefix("Skipped: ").split())


def lines(found: Tally) -> list[str]:
    """Return the closing lines."""
    told = [f"FAILED {name}" for name in found.wrong]
    if found.reasons:
        reasons = "; ".join(f"{count} ({reason})" for reason, count in found.reasons.most_common())
        told.append(f"not tested: {reasons}")
    counts = ", ".join(f"{found.counts[word]} {word}" for word in _WORDS if found.counts[word]) or "no tests ran"
    return [*told, f"{counts} in {found.seconds:.2f}s"]


if __name__ == "__main__":
    print("\n".join(lines(tally(Path(name) for name in sys.argv[1:]))))
