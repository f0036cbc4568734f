"""python -m scripts.bench: what it refuses and plays, what counts as measured, and what its fuzzer draws for."""

import importlib
import subprocess
import sys
from contextlib import contextmanager

import pytest

from scripts.bench import __main__ as bench
from scripts.bench.child import ChildError
from scripts.bench.fuzz import READERS
from scripts.bench.harness import conditions
from scripts.bench.report import CELL, Summary, Table
from scripts.bench.robots import FAULTS, USUAL_PARTS, chosen, summary_of

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


def test_what_is_void_is_played_once_more_and_a_second_usual_measures_nothing(monkeypatch, tmp_path, capsys):
    """So is what failed; the list then says of each benchmark whether this tree was measured."""
    played, troubled = [], {("relay", ""), ("robots", USUAL_PARTS[1])}

    @contextmanager
    def watched():
        noted = NOW | {"date": "2026-11-27", "machine": "x", "load": 0.1}
        yield noted
        if played[-1] in troubled and played.count(played[-1]) == 1:
            noted["void"] = "another process"

    def play_robots(*, is_quick, only):
        played.append(("robots", only))
        rows = [[*cell, 1.0, *[0] * len(FAULTS)] for cell in chosen(only)]
        return summary_of(Table(columns=[*CELL, "small %", *FAULTS], rows=rows))

    def play_other(name):
        def play(*, is_quick):
            played.append((name, ""))
            if name == "relay" and played.count((name, "")) == 1:
                raise ChildError("a node ended")
            return Summary(about="")

        return play

    for name in bench.USUAL:
        play = play_robots if name == "robots" else play_other(name)
        monkeypatch.setattr(f"scripts.bench.{bench.SCENARIOS[name][0]}", play)
    monkeypatch.setattr(bench, "RESULTS", tmp_path)
    monkeypatch.setattr(bench, "conditions", lambda: NOW)
    monkeypatch.setattr(bench, "watched", watched)
    monkeypatch.setattr(bench, "write_pages", lambda: None)
    monkeypatch.setattr(sys, "argv", ["bench", "usual"])
    every = [(name, part) for name in bench.USUAL for part in bench.PARTS.get(name, [""])]
    for more in ([job for job in every if job in troubled], []):
        assert bench.main() == 0
        assert played == every + more if more else not played
        played.clear()
    capsys.readouterr()
    monkeypatch.setattr(sys, "argv", ["bench"])
    bench.main()
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert {name for name, line in lines.items() if "(known: 2026-11-27 at c2)" in line} == {*bench.USUAL}
    assert {name for name, line in lines.items() if "(never measured)" in line} == bench.SCENARIOS.keys() - {
        *bench.USUAL
    }


def test_a_tree_is_what_is_measured_and_not_the_commit(monkeypatch, tmp_path):
    """Results that are committed, and a clone without history, leave it; a change of arpd or scripts does not."""
    monkeypatch.setattr("scripts.bench.harness.REPO", tmp_path)
    for name in ("arpd/a.py", "scripts/b.py", "scripts/bench/results/c.json"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    trees = []
    for name in ("arpd/a.py", "scripts/bench/results/c.json", "scripts/b.py"):
        (tmp_path / name).write_text(name)
        identity = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
        for argv in (["init", "-q"], ["add", "-A"], [*identity, "commit", "-q", "--no-verify", "-m", name]):
            subprocess.run(["git", *argv], cwd=tmp_path, check=True)
        trees.append(conditions()["tree"])
    assert trees[0] == trees[1] != trees[2]


@pytest.mark.parametrize("reader", READERS)
def test_each_reader_has_a_test_that_takes_what_the_fuzzer_draws(reader):
    """A test that gets another name would end the fuzzer after minutes."""
    module, name = READERS[reader]
    assert hasattr(getattr(importlib.import_module(f"tests.unit.{module}"), name), "hypothesis")
