"""scripts/bench: what counts as measured."""

from __future__ import annotations

import pytest

from scripts.bench import __main__ as bench
from scripts.bench.harness import conditions
from scripts.bench.report import Summary

NOW = {"commit": "c2", "tree": "t1", "is_modified": False}


@pytest.mark.parametrize(
    ("kept", "now", "is_known"),
    [
        ({"commit": "c1", "tree": "t1", "is_modified": False}, {}, True),
        ({"commit": "c2", "tree": "t0", "is_modified": False}, {}, False),
        ({"commit": "c2", "tree": "t1", "is_modified": True}, {}, False),
        ({"commit": "c2", "tree": "t1", "is_modified": False}, {"is_modified": True}, False),
        ({"commit": "", "tree": "", "is_modified": False}, {"commit": "", "tree": ""}, False),
        ({"commit": "c2", "is_modified": False}, {}, False),
    ],
    ids=["results committed", "another tree", "modified then", "modified now", "no git", "of before"],
)
def test_a_benchmark_is_known_while_what_it_measures_is_the_same(monkeypatch, tmp_path, kept, now, is_known):
    """A commit of results leaves it known; one of arpd or scripts, or a change, does not."""
    monkeypatch.setattr(bench, "RESULTS", tmp_path)
    monkeypatch.setattr(bench, "conditions", lambda: NOW | now)
    assert not bench.is_known("demo")
    Summary(about="", conditions=[kept]).write(tmp_path / "demo.json")
    assert bench.is_known("demo") is is_known


@pytest.mark.parametrize("path", ["", None], ids=["no git", "no clone"])
def test_conditions_need_no_git(monkeypatch, tmp_path, path):
    """Without git, or in what was unpacked from an archive, they say no commit."""
    monkeypatch.setattr("scripts.bench.harness.REPO", tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    if path is not None:
        monkeypatch.setenv("PATH", path)
    assert (conditions()["commit"], conditions()["tree"], conditions()["is_modified"]) == ("", "", False)
