"""scripts/command_pages.py: the man page and the bash completion say what the parser says."""

from __future__ import annotations

import os
import shutil
import subprocess

import pytest

pytest.importorskip("argparse_manpage", reason="argparse-manpage is not installed: pip install argparse-manpage")
pytest.importorskip("shtab", reason="shtab is not installed: pip install shtab")

from arpd.cli.main import _parser
from scripts.command_pages import COMPLETION, MAN_PAGE, _commands, completion, man_page


def complete(line):
    """Return what bash offers for the last word of a line."""
    script = 'source "$1"; COMP_WORDS=($2); COMP_CWORD=$3; _shtab_arpd 2>/dev/null; printf "%s\\n" "${COMPREPLY[@]}"'
    words = line.split(" ")
    argv = ["bash", "-c", script, "bash", str(COMPLETION), line, str(len(words) - 1)]
    return subprocess.run(argv, capture_output=True, text=True, check=True).stdout.split()


@pytest.mark.parametrize("columns", ["40", "400"])
def test_the_committed_pages_match_the_parser(monkeypatch, columns):
    """The files are those that `python -m scripts.command_pages` writes, whatever the terminal's width."""
    monkeypatch.setenv("COLUMNS", columns)
    assert MAN_PAGE.read_text() == man_page()
    assert COMPLETION.read_text() == completion()


def test_man_shows_every_command_with_its_examples_and_warns_of_nothing():
    """Man keeps the lines of examples and tables, and troff takes no text for a request of its own."""
    if shutil.which("man") is None or shutil.which("groff") is None:
        pytest.skip("man-db and groff are not here")
    shown = subprocess.run(
        ["man", "--warnings", "--local-file", str(MAN_PAGE)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "MANWIDTH": "200", "LC_ALL": "C.UTF-8"},
    )
    assert (shown.returncode, shown.stderr) == (0, "")
    lines = [line.strip() for line in shown.stdout.splitlines()]
    for command, parser in _commands(_parser()):
        assert f"arpd {command}" in lines
        examples = [line.strip() for line in (parser.epilog or "").splitlines() if line.startswith("  ")]
        assert [line for line in examples if line not in lines] == []


@pytest.mark.parametrize("top", ["usr/local", "usr"], ids=["installer", "Debian package"])
def test_man_opens_this_page_although_iproute2_has_one_of_that_name(tmp_path, top):
    """Section 1 goes before section 8, wherever the page is placed and whichever folder is searched first."""
    if shutil.which("man") is None:
        pytest.skip("man-db is not here")
    theirs = tmp_path / "usr/share/man/man8/arpd.8"
    theirs.parent.mkdir(parents=True)
    theirs.write_text(".TH ARPD 8\n.SH NAME\narpd \\- userspace arp daemon\n")
    place = 'source scripts/install-files; set_places "$1"; place() { [[ $3 != *.1 ]] || install -D "$2" "$3"; }'
    placing = ["bash", "-euc", f"{place}; each_file place .", "bash", tmp_path / top]
    subprocess.run(placing, cwd=MAN_PAGE.parents[2], check=True)
    path = ":".join(f"{tmp_path}/{folder}/share/man" for folder in ("usr", "usr/local"))
    opened = subprocess.run(
        ["man", "--where", "arpd"], capture_output=True, text=True, check=True, env={**os.environ, "MANPATH": path}
    )
    assert opened.stdout.strip() == f"{tmp_path / top}/share/man/man1/arpd.1"


def test_bash_completes_commands_options_choices_and_files(tmp_path, monkeypatch):
    """The completion knows commands, their options, an option's choices, and that --config takes a file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.yaml").touch()
    assert complete("arpd st") == ["status"]
    assert complete("arpd run --log") == ["--log-level"]
    assert complete("arpd run --log-level w") == ["warning"]
    assert complete("arpd run --config rob") == ["robot.yaml"]
