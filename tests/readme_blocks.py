"""Fenced blocks of the documents that a user follows."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

REPO = Path(__file__).resolve().parents[1]
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    section: str
    language: str
    text: str

    @property
    def commands(self) -> list[str]:
        """Lines of a shell, without comments and without their prompts."""
        if self.language:
            return []
        lines = (line.removeprefix("$ ") for line in self.text.replace("\\\n", " ").splitlines())
        return [bare for line in lines if (bare := re.sub(r"(^|\s+)#.*", "", line).strip())]


def blocks(name: str) -> list[Block]:
    """Return the fenced blocks of a document."""
    sections = re.split(r"^## (.*)\n", (REPO / name).read_text(encoding="utf-8"), flags=re.MULTILINE)
    return [
        Block(heading, *fence)
        for heading, text in zip(sections[1::2], sections[2::2], strict=True)
        for fence in _FENCE.findall(text)
    ]
