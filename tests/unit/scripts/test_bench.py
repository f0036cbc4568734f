"""python -m scripts.bench: what it refuses and plays, what counts as measured, and what its fuzzer draws for."""

import importlib
import sys

import pytest

from scripts.bench import __main__ as bench
from scripts.bench.fuzz import READERS
from scripts.bench.harness import conditions
from scripts.bench.links import links
from scripts.bench.report import Summary, Table
from scripts.bench.robots import CELL, ROBOTS, USUAL_CELLS, throttled

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


@pytest.mark.parametrize("lacking", [0, 1])
def test_robots_are_known_once_each_usual_side_was_played(monkeypatch, tmp_path, lacking):
    """A part alone leaves the others to play; parts that are the whole together do not."""
    monkeypatch.setattr(bench, "RESULTS", tmp_path)
    monkeypatch.setattr(bench, "conditions", lambda: NOW)
    rounds = Table(columns=list(CELL), rows=[list(cell) for cell in USUAL_CELLS[lacking:]])
    parts = [NOW | {"of": "tb4"}, NOW | {"of": "demo"}]
    Summary(about="", conditions=parts, rounds=rounds).write(tmp_path / "robots.json")
    assert bench.is_known("robots") is (not lacking)


def test_a_throttled_robot_offers_what_it_did_and_a_share_of_it_passes():
    """So what the throttle drops is missing in the account, as what arpd withholds is; commands pass."""
    before, after = ROBOTS["tb4"].topics, throttled(ROBOTS["tb4"], links()["steady-5"][1]).topics
    assert [topic.rate_hz for topic in before] == [topic.rate_hz for topic in after]
    image = next(topic for topic in after if topic.name == "/image")
    passed = sum(image.passes(number) for number in range(1000))
    assert passed == pytest.approx(1000 * image.share, abs=1)
    assert 0 < passed < 200
    assert all(topic.passes(number) for topic in after if topic.name == "/cmd_vel" for number in range(100))


@pytest.mark.parametrize("path", ["", None], ids=["no git", "no clone"])
def test_conditions_need_no_git(monkeypatch, tmp_path, path):
    """Without git, or in what was unpacked from an archive, they say no commit."""
    monkeypatch.setattr("scripts.bench.harness.REPO", tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    if path is not None:
        monkeypatch.setenv("PATH", path)
    assert (conditions()["commit"], conditions()["tree"], conditions()["is_modified"]) == ("", "", False)


@pytest.mark.parametrize(("line", "word"), [("nosuch", "fuzz"), ("solve --only x", "robots"), ("all --only x", "fuzz")])
def test_wrong_usage_names_what_there_is(monkeypatch, capsys, line, word):
    """A benchmark that does not exist, or has no parts, is refused before anything is measured."""
    monkeypatch.setattr(sys, "argv", ["bench", *line.split()])
    with pytest.raises(SystemExit, match="2"):
        bench.main()
    assert word in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("reader", READERS)
def test_each_reader_has_a_test_that_takes_what_the_fuzzer_draws(reader):
    """A test that gets another name would end the fuzzer after minutes."""
    module, name = READERS[reader]
    assert hasattr(getattr(importlib.import_module(f"tests.unit.{module}"), name), "hypothesis")
