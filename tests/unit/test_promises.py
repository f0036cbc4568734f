"""tests/README.md: what arpd promises to a user, and the test that keeps each promise."""

from __future__ import annotations

import re
from pathlib import Path

REPO = Path(__file__).parents[2]
NAMED = re.compile(r"`(tests/[\w/]+\.py)(?:::(\w+))?`")


def test_every_promise_names_tests_that_exist():
    """A test that is renamed or deleted leaves no promise behind."""
    named = NAMED.findall((REPO / "tests/README.md").read_text())
    text_of = {file: path.read_text() if (path := REPO / file).exists() else "" for file, _ in named}
    assert len(text_of) > 50
    assert not [f"{file}::{name}" for file, name in named if not _defines(text_of[file], name)]


def _defines(text, name):
    return bool(text) and (not name or re.search(rf"^(def|class) {name}\b|^{name} = ", text, re.MULTILINE))
