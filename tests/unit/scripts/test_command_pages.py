"""scripts/command_pages.py: the man page and the bash completion say what the parser says."""

import pytest

pytest.importorskip("argparse_manpage", reason="argparse-manpage is not installed: pip install argparse-manpage")
pytest.importorskip("shtab", reason="shtab is not installed: pip install shtab")

from scripts.command_pages import COMPLETION, MAN_PAGE, completion, man_page


@pytest.mark.parametrize("columns", ["40", "400"])
def test_the_committed_pages_match_the_parser(monkeypatch, columns):
    """The files are those that `python -m scripts.command_pages` writes, whatever the terminal's width."""
    monkeypatch.setenv("COLUMNS", columns)
    assert MAN_PAGE.read_text() == man_page()
    assert COMPLETION.read_text() == completion()
