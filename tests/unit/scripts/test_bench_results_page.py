"""The generated figures: every page is what the benchmarks' documents say, and the maths behind the reports."""

from __future__ import annotations

import argparse
import importlib.util
import re

import pytest

from scripts.bench import results_page
from scripts.bench.record import RESULTS, conditions, described, keep, options_of, target, write
from scripts.bench.suite import BENCHMARKS, chosen


@pytest.mark.parametrize("path", results_page.PAGES, ids=lambda path: path.name)
def test_a_page_is_what_the_results_say(path):
    """`scripts/bench/results_page.py` would change nothing: every report runs over its committed document."""
    page = path.read_text(encoding="utf-8")
    assert results_page.regenerated(page, results_page.PAGES[path], RESULTS) == page


def test_every_pictured_result_is_there_once_its_document_is():
    """Where a benchmark's JSON exists, so does the picture that a page shows of it."""
    text = "".join(path.read_text(encoding="utf-8") for path in results_page.PAGES)
    pictures = re.findall(r"^!\[.*\]\((?:\.\./)?scripts/bench/results/(.+)\)$", text, re.MULTILINE)
    assert pictures
    for picture in pictures:
        name = picture.removesuffix(".png").partition("-")[0]
        if (RESULTS / f"{name}.json").exists():
            assert (RESULTS / picture).exists(), picture


def test_a_block_is_replaced_and_the_rest_stays(tmp_path, monkeypatch):
    """Only the text between the markers changes, once its document is there; tables stay whole, and bullets do not."""
    blocks = {"weights": results_page.Block("weights", ("soak",))}
    row = "| " + "cell " * 60 + "|"
    monkeypatch.setattr("scripts.bench.weights.report", lambda document: f"- {'word ' * document['words']}\n{row}\n")
    before = "above\n<!-- weights:begin -->\ntyped by hand\n<!-- weights:end -->\nbelow\n"
    assert results_page.regenerated(before, blocks, tmp_path) == before
    (tmp_path / "soak.json").write_text('{"words": 60}')
    after = results_page.regenerated(before, blocks, tmp_path)
    assert results_page.regenerated(after, blocks, tmp_path) == after
    above, begin, first, second, third, whole, end, below = after.splitlines()
    assert (above, begin, end, below) == ("above", "<!-- weights:begin -->", "<!-- weights:end -->", "below")
    assert whole == row
    assert max(map(len, (first, second, third))) <= 130
    assert (first[:6], second[:6], third[:6]) == ("- word", "  word", "  word")


@pytest.mark.parametrize(
    "text",
    [
        "no place at all\n",
        "<!-- soak:begin -->\n<!-- soak:end -->\n<!-- soak:begin -->\n<!-- soak:end -->\n",
        "<!-- soak:begin -->\n<!-- soak:end -->\n<!-- other:begin -->\n<!-- other:end -->\n",
        "<!-- soak:begin -->\n<!-- other:end -->\n",
    ],
)
def test_a_marker_that_fits_no_block_is_an_error(text, tmp_path):
    """A block without markers, with two pairs or a wrong end, and a marker without a block are errors."""
    blocks = {"soak": results_page.Block("soak", ("soak",))}
    with pytest.raises(ValueError, match="markers for"):
        results_page.regenerated(text, blocks, tmp_path)


def test_every_block_of_results_has_a_benchmark_that_makes_them():
    """`scripts/bench/all` runs every benchmark that the pages show, and each is a module."""
    made = {each.name for each in BENCHMARKS}
    blocks = [block for page in results_page.PAGES.values() for block in page.values()]
    assert {name for block in blocks for name in block.results} <= made
    assert all(importlib.util.find_spec(f"scripts.bench.{name}") for name in made)


def test_only_takes_names_in_the_benchmarks_own_order():
    """Fuzz runs before reliability, which shows its findings, in any order of names."""
    assert [each.name for each in chosen("reliability, fuzz")] == ["fuzz", "reliability"]
    assert chosen("") == list(BENCHMARKS)
    with pytest.raises(ValueError, match="fuz: no such benchmark"):
        chosen("fuz")


def test_a_quick_run_is_kept_only_where_it_is_asked_for(tmp_path):
    """Short forms must not become published figures."""
    assert target(None, "x.json", is_partial=True) is None
    assert target(None, "x.json", is_partial=False) == RESULTS / "x.json"
    options = options_of(None, "x", quick="short", has_plot=True).parse_args(["--quick"])
    keep({"rate": 1.0}, options, "x", is_partial=options.quick, draw=lambda path: pytest.fail(f"drew {path}"))
    asked = argparse.Namespace(json=tmp_path / "new" / "x.json", plot=tmp_path / "x.png")
    keep({"rate": 1.0}, asked, "x", is_partial=True, draw=lambda path: path.write_text("drawn"))
    assert asked.json.read_text() == '{\n "rate": 1.0\n}\n'
    assert asked.plot.read_text() == "drawn"


def test_a_document_without_numbers_is_refused(tmp_path):
    """JSON has no NaN."""
    with pytest.raises(ValueError, match="JSON compliant"):
        write({"rate": float("nan")}, tmp_path / "x.json")


def test_conditions_are_described_even_where_a_document_has_none():
    """Documents from before conditions were noted stay readable."""
    noted = conditions()
    assert f"{noted['cpu_count']} cores" in described({"conditions": noted})
    assert described({})
