"""What python -m scripts.bench refuses."""

from __future__ import annotations

import sys

import pytest

from scripts.bench.__main__ import main


@pytest.mark.parametrize(("line", "word"), [("nosuch", "fuzz"), ("solve --only x", "robots"), ("all --only x", "fuzz")])
def test_wrong_usage_names_what_there_is(monkeypatch, capsys, line, word):
    """A benchmark that does not exist, or has no parts, is refused before anything is measured."""
    monkeypatch.setattr(sys, "argv", ["bench", *line.split()])
    with pytest.raises(SystemExit, match="2"):
        main()
    assert word in capsys.readouterr().err.splitlines()[-1]
