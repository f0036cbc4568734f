"""What stands between the fences of the documents: each command exists, and what a user copies can be read."""

import ast
import re

import pytest

from arpd.cli.main import _parser
from arpd.host.config.load import load_settings
from tests.readme_blocks import REPO, blocks

UNITS = {path.stem for path in (REPO / "systemd").glob("*.service")}
# Sections whose blocks without a language are pictures and output.
SHOWN = {"See"}


def commands(name):
    """Return the lines of a document that a user types, in order."""
    return [line for block in blocks(name) if block.section not in SHOWN for line in block.commands]


def is_known(line):
    """Return whether a command line names only what there is."""
    program, *arguments = re.split(r" [|>] ", line)[0].removeprefix("sudo ").split()
    if program.startswith("scripts/"):
        return _is_script(program, arguments)
    return program in KNOWN and KNOWN[program](arguments)


def _is_script(program, arguments):
    path = REPO / program
    return path.is_file() and all(word in path.read_text() for word in arguments if word.startswith("-"))


def _is_usage(arguments):
    try:
        _parser().parse_args(arguments)
    except SystemExit:
        return False
    return True


def _names_the_profile(arguments):
    found = re.fullmatch(r"FASTRTPS_DEFAULT_PROFILES_FILE=/usr/share/arpd/(\S+)", arguments[0])
    return bool(found) and (REPO / "arpd/ros" / found[1]).is_file()


KNOWN = {
    "arpd": _is_usage,
    "systemctl": lambda arguments: set(arguments) - {"status", "reload", "enable", "--now"} <= UNITS,
    "journalctl": lambda arguments: arguments[0] == "-u" and arguments[1] in UNITS,
    "apt": lambda arguments: arguments[0] == "install" and arguments[1].startswith("./arpd-ros_"),
    "export": _names_the_profile,
}


@pytest.mark.parametrize("line", commands("README.md"))
def test_every_line_is_a_command_that_there_is(line):
    """Scripts, their options, subcommands, units and files of every line in the README's blocks exist."""
    assert is_known(line)


@pytest.mark.parametrize("name", ["docs/configuration.md", "docs/operating.md", "docs/security.md"])
def test_commands_of_arpd_in_the_manual_exist(name):
    """Every line of the manual that begins with arpd or a script is one that they accept."""
    typed = [line for line in commands(name) if re.match(r"(sudo )?(arpd|scripts/)", line)]
    assert [line for line in typed if not is_known(line)] == []


def test_what_a_user_copies_into_files_can_be_read(tmp_path):
    """Each YAML block of the README is a configuration, and each Python block compiles."""
    found = {"yaml": 0, "python": 0}
    for _, language, text in blocks("README.md"):
        if language == "yaml":
            (tmp_path / "arpd.yaml").write_text(text)
            load_settings(tmp_path / "arpd.yaml", interfaces=None)
        elif language == "python":
            ast.parse(text)
        else:
            assert not language
            continue
        found[language] += 1
    assert min(found.values()) > 0
