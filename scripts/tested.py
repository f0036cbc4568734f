"""Sums up pytest's runs: what failed, what passed only alone, what was not tested and why, and last the counts.

Usage: python -m scripts.tested JUNIT.xml... [--again JUNIT.xml]

Exits with 1 if a test failed, and failed again where it ran again.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


@dataclass(kw_only=True, slots=True)
class Tally:
    """Counts of several runs.

    Parameters
    ----------
    passed : number of tests
    wrong : tests that failed or broke, as pytest calls them
    only_alone : tests that failed, and passed when they ran again with nothing beside them
    reasons : skipped tests by reason
    """

    passed: int = 0
    wrong: list[str] = field(default_factory=list)
    only_alone: list[str] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)


def tally(files: Iterable[Path], again: Iterable[Path] = ()) -> Tally:
    """Read the files that pytest has written with --junit-xml and junit_family=xunit1.

    Parameters
    ----------
    files : of the runs
    again : of a further run of what failed
    """
    found = Tally()
    for case in _cases(files):
        if case.find("failure") is not None or case.find("error") is not None:
            found.wrong.append(_name(case))
        elif (skipped := case.find("skipped")) is not None:
            found.reasons[_reason(skipped)] += 1
        else:
            found.passed += 1
    second = {_name(case): {part.tag for part in case} for case in _cases(again)}
    found.only_alone = [
        name for name in found.wrong if not second.get(name, {"error"}) & {"failure", "error", "skipped"}
    ]
    found.wrong = [name for name in found.wrong if name not in found.only_alone]
    found.passed += len(found.only_alone)
    return found


def _cases(files: Iterable[Path]) -> Iterator[ET.Element]:
    for path in files:
        yield from ET.parse(path).iter("testcase")


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
    told += [f"passed only alone: {name}" for name in found.only_alone]
    told += [f"not tested: {count} ({reason})" for reason, count in found.reasons.most_common()]
    skipped = found.reasons.total()
    counts = f"{found.passed} passed, {len(found.wrong)} failed"
    return [*told, f"{counts}, {skipped} skipped" if skipped else counts]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Sum up pytest's runs.")
    parser.add_argument("files", type=Path, nargs="*")
    parser.add_argument("--again", type=Path, action="append", default=[])
    arguments = parser.parse_args()
    found = tally(arguments.files, arguments.again)
    print("\n".join(lines(found)))
    sys.exit(bool(found.wrong))
