"""Writes the man page and the bash completion of `arpd` from its argparse parser.

Usage: python -m scripts.command_pages

shtab writes the completion. The man page is made here, because argparse-manpage drops examples and refills tables.
Both texts depend on the parser only, neither on the terminal's width nor on the version of Python.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

import shtab

from arpd.cli.main import _parser

if TYPE_CHECKING:
    from collections.abc import Iterator

_REPO = Path(__file__).resolve().parents[1]
MAN_PAGE = _REPO / "etc/man/arpd.1"
COMPLETION = _REPO / "etc/bash-completion/arpd"
_UNFOLDED = 10_000  # columns; a usage on one line is the same in every Python
_FILES = (
    ("/etc/arpd/arpd.yaml", "configuration of the daemon, the relay and, with two ends, the peer"),
    ("/etc/default/arpd", "environment of the units"),
    (
        "/usr/local/share/arpd/fastdds.xml",
        "Fast DDS profile for your own nodes: export FASTRTPS_DEFAULT_PROFILES_FILE=/usr/local/share/arpd/fastdds.xml",
    ),
)


def man_page() -> str:
    """Return the man page in the man(7) language."""
    parser = _parser()
    name, _, summary = parser.prog, " ", parser.description or ""
    lines = [
        '.\\" made by `python -m scripts.command_pages`; edit the parser in arpd/cli instead',
        f'.TH {name.upper()} 1 "" {name} "User Commands"',
        ".nh",
        ".ad l",
        ".SH NAME",
        f"{name} \\- {_escaped(summary[:1].lower() + summary[1:].rstrip('.'))}",
        ".SH SYNOPSIS",
        _usage(parser),
        ".SH DESCRIPTION",
        *_text(parser.epilog),
        *_options(parser),
        ".SH COMMANDS",
    ]
    for command, help_text, subparser in _commands(parser):
        lines += [
            f".SS {name} {command}",
            f"{_escaped(help_text[:1].upper() + help_text[1:])}.",
            ".PP",
            _usage(subparser),
        ]
        lines += [*_text(subparser.description), *_options(subparser), *_text(subparser.epilog)]
    lines.append(".SH FILES")
    for path, meaning in _FILES:
        lines += [".TP", f".I {_escaped(path)}", _escaped(meaning)]
    lines += [".SH SEE ALSO", "systemctl(1), journalctl(1), https://github.com/arpd/arpd"]
    return "\n".join(lines) + "\n"


def completion() -> str:
    """Return the bash completion."""
    parser = _parser()
    for _, _, subparser in _commands(parser):
        for action in subparser._actions:  # noqa: SLF001 - argparse has no public list
            if action.type is Path:
                action.complete = shtab.FILE  # type: ignore[attr-defined] # shtab's own attribute
    return shtab.complete(parser, shell="bash").rstrip("\n") + "\n"


def _commands(parser: argparse.ArgumentParser) -> Iterator[tuple[str, str, argparse.ArgumentParser]]:
    """Yield name, help text and parser of each command."""
    for action in parser._actions:  # noqa: SLF001 - argparse has no public list
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 - the same
            for choice in action._choices_actions:  # noqa: SLF001 - the same
                yield choice.dest, choice.help or "", action.choices[choice.dest]


def _usage(parser: argparse.ArgumentParser) -> str:
    formatter = argparse.HelpFormatter(parser.prog, width=_UNFOLDED)
    formatter.add_usage(parser.usage, parser._actions, parser._mutually_exclusive_groups, prefix="")  # noqa: SLF001
    words = _escaped(formatter.format_help().strip())
    # An option and its value stay on one line.
    return re.sub(r"\[[^][|]*\]", lambda option: option[0].replace(" ", "\\ "), words)


def _options(parser: argparse.ArgumentParser) -> list[str]:
    lines = []
    for group in parser._action_groups:  # noqa: SLF001 - argparse has no public list
        entries = []
        for action in group._group_actions:  # noqa: SLF001 - the same
            if isinstance(action, (argparse._HelpAction, argparse._SubParsersAction)):  # noqa: SLF001 - the same
                continue
            entries += [".TP", _invocation(action), _escaped(_help(action, parser.prog))]
        if entries:
            lines += [".PP", f"{_escaped(group.title or '')}:", *_text(group.description), *entries]
    return lines


def _invocation(action: argparse.Action) -> str:
    metavar = action.metavar if isinstance(action.metavar, str) else None
    if action.choices is not None:
        metavar = metavar or "|".join(map(str, action.choices))
    value = metavar or action.dest.upper()
    if not action.option_strings:
        return f"\\fI{_escaped(value)}\\fR"
    names = ", ".join(f"\\fB{_escaped(option)}\\fR" for option in action.option_strings)
    return names if action.nargs == 0 else f"{names} \\fI{_escaped(value)}\\fR"


def _help(action: argparse.Action, prog: str) -> str:
    return (action.help or "") % {**vars(action), "prog": prog}


def _text(text: str | None) -> list[str]:
    """Return prose to be filled, and tables, equations and examples line by line."""
    lines = []
    for paragraph in re.split(r"\n\s*\n", (text or "").strip("\n")):
        if not paragraph.strip():
            continue
        is_table = re.search(r"^ |\S {2,}\S", paragraph, re.MULTILINE)
        shown = [_escaped(line) for line in paragraph.splitlines()]
        lines += [".PP", *([".nf", *shown, ".fi"] if is_table else shown)]
    return lines


def _escaped(text: str) -> str:
    """Return text that troff prints as it is."""
    text = (
        text.replace("\\", "\\e").replace("-", "\\-").replace("`", "\\(ga").replace("'", "\\(aq").replace("^", "\\(ha")
    )
    text = "".join(letter if letter.isascii() else f"\\[u{ord(letter):04X}]" for letter in text)
    return f"\\&{text}" if text.startswith(".") else text


if __name__ == "__main__":
    for path, text in ((MAN_PAGE, man_page()), (COMPLETION, completion())):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="ascii")
        print(f"wrote {path.relative_to(_REPO)}")
