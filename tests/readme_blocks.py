"""Fenced blocks of the documents that a user follows."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

REPO = Path(__file__).resolve().parents[1]
#: What a user follows from an empty computer to topics that arpd manages, in this order.
SECTIONS = (
    ("README.md", "Install"),
    ("README.md", "Configure"),
    ("docs/operating.md", "The Fast DDS profile"),
)
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True, kw_only=True, slots=True)
class Block:
    """A fenced block.

    Parameters
    ----------
    place : document and line of its first line, for a failure
    language : as the fence says, empty if it says none
    text : the lines between the fences
    """

    place: str
    language: str
    text: str

    @property
    def commands(self) -> list[str]:
        """Lines of a shell, without comments and without their prompts."""
        if self.language in {"python", "yaml"}:
            return []
        lines = (re.sub(r"(^|\s+)#.*", "", line).removeprefix("$ ").strip() for line in self.text.splitlines())
        return [line for line in lines if line]


def blocks(sections=SECTIONS, *, repo=REPO):
    """Return the blocks of the sections, in order; fail where a section is gone or has none."""
    return [block for name, heading in sections for block in _section(repo, name, heading)]


def lines(found, pattern):
    """Return the shell lines that a pattern describes, of which there must be one."""
    described = [line for block in found for line in block.commands if re.fullmatch(pattern, line)]
    assert described, f"no line of the documents is {pattern} any more"
    return described


def _section(repo, name, heading):
    document = (repo / name).read_text(encoding="utf-8")
    found = re.search(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", document, re.MULTILINE | re.DOTALL)
    assert found, f"{name} has no section called {heading!r}; name what replaces it in {__name__}.SECTIONS"
    inside = [
        Block(
            place=f"{name}:{document.count(chr(10), 0, found.start(1) + fence.start(2)) + 1}",
            language=fence[1],
            text=fence[2],
        )
        for fence in _FENCE.finditer(found[1])
    ]
    marks = len(re.findall(r"^\s*(?:```|~~~)", found[1], re.MULTILINE))
    assert marks == 2 * len(inside), f"section {heading!r} of {name} has a fence that is indented or not closed"
    assert inside, f"section {heading!r} of {name} has no fenced block any more"
    return inside
