"""Writes the man page and the bash completion of `arpd` from its argparse parser.

Usage: python -m scripts.command_pages

argparse-manpage and shtab write them. argparse-manpage drops the epilogs of commands, which have the examples, and
fills tables; so both get to it inside the description, as troff. Both texts depend on the parser only, neither on the
terminal's width nor on the version of Python.
"""

from __future__ import annotations

import argparse
import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import shtab
from argparse_manpage.manpage import Manpage

from arpd.cli.main import _parser, is_table

if TYPE_CHECKING:
    from collections.abc import Iterator

_REPO = Path(__file__).resolve().parents[1]
MAN_PAGE = _REPO / "etc/man/arpd.1"
COMPLETION = _REPO / "etc/bash-completion/arpd"
_UNFOLDED = 10_000  # columns; a usage on one line is the same in every Python
_FILES = r""".TP
.I /etc/arpd/arpd.yaml
configuration of the daemon, the relay and, with two ends, the peer
.TP
.I /etc/default/arpd
environment of the units
.TP
.I /usr/share/arpd/fastdds.xml
Fast DDS profile for your own nodes: export FASTRTPS_DEFAULT_PROFILES_FILE=/usr/share/arpd/fastdds.xml"""
_AS_TYPED = str.maketrans({"'": r"\(aq", "`": r"\(ga", "^": r"\(ha"})  # troff makes typographic ones of them


def man_page() -> str:
    """Return the man page in the man(7) language."""
    parser = _parser()
    summary = parser.description or ""
    for each in (parser, *(command for _, command in _commands(parser))):
        each.formatter_class = partial(argparse.RawDescriptionHelpFormatter, width=_UNFOLDED)
        each.description, each.epilog = _troff(f"{each.description}\n\n{each.epilog or ''}"), None
    page = Manpage(parser, format="single-commands-section")
    page.date, page.manual, page.description = "", "User Commands", summary[:1].lower() + summary[1:].rstrip(".")
    page.add_section("files", "=", _FILES)
    page.add_section("see also", "=", "systemctl(1), journalctl(1), https://github.com/arpd/arpd")
    head, name, rest = str(page).partition(".SH NAME\n")
    made = '.\\" made by `python -m scripts.command_pages`; edit the parser in arpd/cli instead\n'
    return made + head + ".nh\n.ad l\n" + name + "\n".join(map(_as_typed, rest.splitlines())) + "\n"


def completion() -> str:
    """Return the bash completion."""
    parser = _parser()
    for _, command in _commands(parser):
        for action in command._actions:  # noqa: SLF001 - argparse has no public list
            if action.type is Path:
                action.complete = shtab.FILE  # type: ignore[attr-defined] # shtab's own attribute
    return shtab.complete(parser, shell="bash").rstrip("\n") + "\n"


def _commands(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield name and parser of each command."""
    for action in parser._actions:  # noqa: SLF001 - argparse has no public list
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 - the same
            yield from action.choices.items()


def _troff(text: str) -> str:
    """Return prose to be filled, and tables, equations and examples line by line."""
    paragraphs = re.split(r"\n\s*\n", text.strip("\n"))
    return "\n".join(f".PP\n.nf\n{each}\n.fi" if is_table(each) else f".PP\n{each}" for each in paragraphs)


def _as_typed(line: str) -> str:
    """Return a line whose hyphens and quotes can be copied into a shell, and whose options stay whole."""
    if line.startswith("."):
        return line
    line = re.sub(r"(?<!\\)-", r"\\-", line).translate(_AS_TYPED)
    if not line.startswith("usage: "):
        return line
    return re.sub(r"\[[^][|]*\]", lambda option: option[0].replace(" ", "\\ "), line.removeprefix("usage: "))


if __name__ == "__main__":
    for path, text in ((MAN_PAGE, man_page()), (COMPLETION, completion())):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        print(f"wrote {path.relative_to(_REPO)}")
