"""The generated figures: every one comes from a benchmark's document, and each report says what its document says."""

from __future__ import annotations

import importlib.util
import re

import pytest

from scripts.bench import results_page
from scripts.bench.capacity_report import markdown as capacity_text
from scripts.bench.demo_report import markdown as demo_text
from scripts.bench.exposition_report import markdown as exposition_text
from scripts.bench.record import RESULTS, conditions, described, keep, target
from scripts.bench.relay_report import markdown as relay_text
from scripts.bench.reliability_report import markdown as reliability_text
from scripts.bench.soak_report import markdown as soak_text
from scripts.bench.soak_report import verdict as soak_verdict
from scripts.bench.solve_report import PAPER
from scripts.bench.solve_report import markdown as solve_text
from scripts.bench.suite import BENCHMARKS, chosen
from scripts.bench.swap_report import ADAPTIVE, RECREATE, STILL, beyond
from scripts.bench.swap_report import markdown as swap_text

NOTED = {
    "conditions": {
        "date": "2026-01-02T03:04:05+00:00",
        "machine": "x86_64, Linux 6.1",
        "cpu_count": 2,
        "load_average": [0.34, 0.2, 0.1],
    }
}
WHEN = "2026-01-02, x86_64, 2 cores, load average 0.3 before"


@pytest.mark.parametrize("path", results_page.PAGES, ids=lambda path: path.name)
def test_a_page_is_what_the_results_say(path):
    """`scripts/bench/results_page.py --check` finds nothing that differs."""
    page = path.read_text(encoding="utf-8")
    assert results_page.regenerated(page, results_page.PAGES[path], RESULTS) == page


def test_every_pictured_result_is_there_once_its_document_is():
    """A picture that a page shows from the results exists where the benchmark's JSON does."""
    text = "".join(path.read_text(encoding="utf-8") for path in results_page.PAGES)
    pictures = re.findall(r"^!\[.*\]\((?:\.\./)?scripts/bench/results/(.+)\)$", text, re.MULTILINE)
    assert pictures
    for picture in pictures:
        name = picture.removesuffix(".png").partition("-")[0]
        if (RESULTS / f"{name}.json").exists():
            assert (RESULTS / picture).exists(), picture


def test_a_block_is_replaced_and_the_rest_stays(tmp_path, monkeypatch):
    """Only the text between the markers changes, whatever it was before."""
    (tmp_path / "soak.json").write_text('{"swaps": 7}')
    blocks = {"soak": results_page.Block(results=("soak",), report="soak_report")}
    monkeypatch.setattr("scripts.bench.soak_report.markdown", lambda document: f"{document['swaps']} swaps\n")
    before = "above\n<!-- soak:begin -->\ntyped by hand\n<!-- soak:end -->\nbelow\n"
    after = "above\n<!-- soak:begin -->\n7 swaps\n<!-- soak:end -->\nbelow\n"
    assert results_page.regenerated(before, blocks, tmp_path) == after
    assert results_page.regenerated(after, blocks, tmp_path) == after


def test_a_block_without_results_stays_as_it_is(tmp_path):
    """Nothing is invented for a benchmark that has not run."""
    blocks = {"swap": results_page.Block(results=("swap", "soak"), report="swap_report")}
    (tmp_path / "swap.json").write_text("{}")
    text = "<!-- swap:begin -->\nas it was\n<!-- swap:end -->\n"
    assert results_page.regenerated(text, blocks, tmp_path) == text


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
    """A block without a place, with two, with a wrong end, or a place without a block would leave figures to rot."""
    blocks = {"soak": results_page.Block(results=("soak",), report="soak_report")}
    with pytest.raises(results_page.MarkerError):
        results_page.regenerated(text, blocks, tmp_path)


def test_prose_is_broken_and_tables_are_not(tmp_path, monkeypatch):
    """A report need not know how wide a page is."""
    blocks = {"weights": results_page.Block(results=(), report="weights_report")}
    row = "| " + "cell " * 60 + "|"
    monkeypatch.setattr("scripts.bench.weights_report.markdown", lambda: "- " + "word " * 60 + "\n" + row)
    text = results_page.regenerated("<!-- weights:begin -->\n<!-- weights:end -->\n", blocks, tmp_path)
    lines = text.splitlines()
    assert row in lines
    bullet = [line for line in lines if "word" in line]
    assert len(bullet) == 3
    assert max(map(len, bullet)) <= 130
    assert all(line.startswith("  word") for line in bullet[1:])


def test_every_block_of_results_has_a_benchmark_that_makes_them():
    """`scripts/bench/all` runs whatever the pages show."""
    made = {each.name for each in BENCHMARKS}
    blocks = [block for page in results_page.PAGES.values() for block in page.values()]
    assert {name for block in blocks for name in block.results} <= made
    assert all(importlib.util.find_spec(f"scripts.bench.{name}") for name in made)


def test_only_takes_names_in_the_benchmarks_own_order():
    """Fuzz runs before reliability, which shows what it found, however they are named."""
    assert [each.name for each in chosen("reliability, fuzz")] == ["fuzz", "reliability"]
    assert chosen("") == list(BENCHMARKS)
    with pytest.raises(ValueError, match="fuz: no such benchmark"):
        chosen("fuz")


def test_a_quick_run_is_kept_only_where_it_is_asked_for(tmp_path):
    """Short forms must not become published figures."""
    assert target(None, "x.json", is_partial=True) is None
    assert target(None, "x.json", is_partial=False) == RESULTS / "x.json"
    assert target(tmp_path, "x.json", is_partial=True) == tmp_path


def test_a_document_without_numbers_is_refused(tmp_path):
    """NaN is nonsense, and JSON has none."""
    with pytest.raises(ValueError, match="JSON compliant"):
        keep({"rate": float("nan")}, tmp_path / "x.json")
    keep({"rate": 1.0}, None)
    keep({"rate": 1.0}, tmp_path / "new" / "x.json")
    assert (tmp_path / "new" / "x.json").read_text() == '{\n "rate": 1.0\n}\n'


def test_conditions_are_told():
    """Date, machine, cores and the load before the start; and of an old document that it has none."""
    assert described(NOTED) == WHEN
    assert "cores" in described({"conditions": conditions()})
    assert described({}) == "machine and load not noted"


def side(**changes):
    fields = {
        "latency_p99_s": 0.1,
        "loss_ratio": 0.0,
        "age_p50_s": 0.01,
        "age_p99_s": 0.2,
        "delivered_bytes": 3_000_000,
    }
    return fields | {"source_rate_hz": 20.0} | changes


def test_the_demo_shows_both_sides():
    """Each cell is without arpd → with it, the largest topic first; what never arrived is said so."""
    small = {"topic": "/b", "without": side(), "with": side(withheld_ratio=0.5, delivered_bytes=1)}
    large = {"topic": "/a", "without": side(latency_p99_s=None, loss_ratio=0.5), "with": side(withheld_ratio=0.25)}
    document = NOTED | {"schedule": "0:20mbit", "verdict": {"text": "Better."}, "topics": [small, large]}
    head, _, _, _, first, second, *_ = demo_text(document).splitlines()
    assert WHEN in head
    assert head.endswith("Better.")
    assert first == "| `/a` | 20 | never → 100 | 50.0 → 0.0 | 0.0 → 25.0 | 10 → 10 | 200 → 200 | 3.00 → 3.00 |"
    assert second.startswith("| `/b` |")


def test_a_re_solve_is_compared_with_the_papers_way():
    """How many times as fast, slower where it is, and how many answers were off."""
    times = {PAPER: 4e-3, "cvxpy, parameters": 8e-3, "OSQP, direct": 1e-4, "exact": 4e-6}
    times |= {"whole program, osqp": 0.2, "whole program, exact": 1e-3}
    race = {"topics": 12, "instances": 50, "median_s": times, "failed_or_wrong": dict.fromkeys(times, 0) | {PAPER: 47}}
    footprint = {"peak_rss_bytes": 2**20, "loads_cvxpy": False}
    text = solve_text(NOTED | {"races": [race, race | {"topics": 1000}], "footprints": {"osqp": footprint}})
    lines = text.splitlines()
    assert lines[0] == "| median ms per re-solve | N = 12 | 1,000 |"
    assert "| 4, 47 of 50 off | 4, 47 of 50 off |" in lines[2]
    assert "| 8 (slower) |" in lines[3]
    assert "| 0.1 (40×) |" in lines[4]
    assert "| 200 |" in lines[6]
    assert "1 MiB with osqp; osqp never import cvxpy" in lines[-1]


def test_late_ticks_under_scrapers_are_counted():
    """The largest size and the most scrapers are what is told."""
    spent = {"text": {"arpd": 0.1, "prometheus_client": 0.4}, "OpenMetrics": {"arpd": 0.2, "prometheus_client": 0.3}}
    races = [{"topics": 10, "samples": 5, "median_s": spent}, {"topics": 1000, "samples": 5000, "median_s": spent}]
    found = {"ticks": 200, "late_share": 0.01, "scrape_median_s": 0.25}
    ticking = {"topics": 1000, "by_scrapers": {"0": {}, "4": found}}
    text = exposition_text(NOTED | {"races": races, "ticking": ticking})
    assert "With 1,000 topics (5,000 series)" in text
    assert "in 100 to 200 ms, where prometheus_client's own encoder takes 300 to 400 ms" in text
    assert "2 of 200 ticks began late" in text


def tally(**changes):
    fields = {"expected": 100, "lost": 0, "doubled": 0, "reordered": 0, "swaps": 6, "cpu_s": 0.06, "gap_s": 0.02}
    return fields | changes


def cell(adaptive, **changes):
    ways = {STILL: tally(swaps=0), ADAPTIVE: adaptive, RECREATE: tally(lost=1200)}
    fields = {
        "setting": {"place": "link", "loss": 0.02},
        "readers": 1,
        "rate_hz": 100,
        "depth": 10,
        "payload_bytes": 100,
    }
    return fields | {"ways": ways} | changes


def test_a_swap_that_loses_what_the_baseline_does_not_is_named():
    """Numbers of samples stand beside those without swaps; cells of less depth promise nothing."""
    good, bad = cell(tally()), cell(tally(lost=40, gap_s=0.3), payload_bytes=30_000)
    text = swap_text(NOTED | {"cells": [good, bad, cell(tally(lost=9), depth=1)]})
    assert "12 swaps in 2 combinations with DEPTH ≥ 10" in text
    assert "nothing doubled, nothing reordered, and more lost than without swaps in 1 of them" in text
    assert "destroy-then-create lost more in 2, 2,400 samples" in text
    assert (
        "30,000 bytes at 100 Hz, DEPTH 10, 2 % loss, where 40 of 100 samples were lost, without swaps 0 of 100" in text
    )
    assert "above one MTU" in text
    assert "300 ms with loss (without swaps 20 ms)" in text
    assert "Worse:" not in swap_text(NOTED | {"cells": [good]})


def test_scatter_of_the_baseline_is_not_blamed_on_swaps():
    """A longer run loses more, and a few more than the baseline is luck."""
    ways = {STILL: tally(lost=10), ADAPTIVE: tally(lost=25, expected=200), RECREATE: tally(lost=60)}
    assert beyond(ways, ADAPTIVE) == []
    assert beyond(ways, RECREATE) == ["lost"]


def test_a_soak_tells_what_grew_and_what_was_lost():
    """Growth counts from the first five hundred swaps on."""
    footprint = {"rss_bytes": 50 * 2**20, "threads": 9, "files": 12}
    notes = [
        {"swaps": swaps, "elapsed_s": swaps / 50, "writer": footprint | {"rss_bytes": rss * 2**20}, "reader": footprint}
        for swaps, rss in ((100, 40), (500, 50), (1000, 53))
    ]
    document = NOTED | {"notes": notes, "sent": 200, "received": [200, 199], "highest": [199, 198], "late": [0, 1]}
    text = soak_text(document)
    assert "1,000 swaps in 20 s on 2 topics" in text
    assert "2 of 400 samples lost, 1 doubled or out of order; from swap 500 on the writer grew by 3.0 MiB" in text
    writer, reader, samples = soak_verdict(document)
    assert writer.endswith("too much")
    assert not reader.endswith("too much")
    assert "1 topics received the last sample" in samples


def test_a_relay_above_its_target_is_named():
    """The range of the others, and those beyond."""
    cells = [
        {"ratio": ratio, "topics": topics, "payload_bytes": 100} for ratio, topics in ((0.9, 1), (1.1, 12), (1.3, 100))
    ]
    text = relay_text(NOTED | {"cells": cells})
    assert "costs 0.90 to 1.10 times" in text
    assert "in 2 of 3 combinations" in text
    assert "and 1.30 times with 100 topics of 100 bytes" in text
    assert " and " not in relay_text(NOTED | {"cells": cells[:1]}).partition("executor")[2].replace("payload and", "")


def test_the_estimate_is_told_beside_its_targets():
    """Simulated and real, which targets are missed and by whom, and what throughput alone comes to."""
    metrics = {"goodput": 1.0, "utilisation": 0.9, "queue peak": 0.5}
    never = metrics | {"queue peak": None, "utilisation": 0.1}
    estimate = NOTED | {
        "seeds": 5,
        "scenarios": {"fall": {"arpd": [metrics], "average": [never], "maximum": [metrics], "oracle": [metrics]}},
        "targets": [
            {"target": "queue peak, 20→5: <= 0.6 s", "median": 0.5, "worst": 0.7, "met": False},
            {"target": "steady error, p90: <= 10 %", "median": 0.2, "worst": 0.3, "met": False},
            {"target": "outage, recovery to 80 %: <= 5 s", "median": 1.0, "worst": None, "met": False},
            {"target": "levels per minute, noisy: <= 1", "median": 0.0, "worst": 0.0, "met": True},
        ],
    }
    runs = [
        {"scenario": "20→5", "side": side, "with_arpd": arpd, "round": k, "figures": {"peak_queue_s": queue}}
        for side, arpd, k, queue in (
            ("real", True, 1, 0.2),
            ("real", True, 2, 0.4),
            ("real", False, 1, 9),
            ("virtual", True, 1, 8),
        )
    ]
    text = capacity_text(estimate, NOTED | {"runs": runs})
    assert "2 runs each" in text
    assert "| queue peak, 20→5 | ≤ 0.6 s | 0.50 s (0.70) | 0.30 s (0.40) |" in text
    assert "| steady error, p90 | ≤ 10 % | 20.0 % (30.0) | – |" in text
    assert "| outage, recovery to 80 % | ≤ 5 s | 1.00 s (never) | – |" in text
    assert "1 of 4 targets are met" in text
    assert "The worst seed misses: queue peak, 20→5; outage, recovery to 80 %." in text
    assert "The median, too, misses: steady error, p90." in text
    assert "the average of the throughput 10 % of the oracle's goodput with queues without end" in text


def test_a_bad_hour_is_told_with_what_fuzzing_found():
    """Messages of both kinds, recoveries that came and those that did not, and crashes."""
    lost = {"sent": 100, "lost": 2, "doubled": 0, "late": 1, "silence_s": 3.0}
    notes = [{"at_s": t, "pid": 7, "rss_bytes": 2**20, "threads": 3, "files": 4} for t in (0.0, 20.0, 40.0, 60.0)]
    recovery = {"kind": "calm kill", "whole_s": 2.0, "answered_s": 1.0, "planned_s": 1.5}
    life = {"ticks": 50, "ticks_late": 1, "ticks_failed": 0, "reloads": {"ok": 3, "failed": 1}}
    document = NOTED | {
        "minutes": 1.5,
        "load_average": [1.0, 1.0, 2.2],
        "events": {"rate": 4},
        "topics": {"/app/adaptive/t0": lost, "/app/plain/t0": lost | {"lost": 9}},
        "recoveries": [recovery, recovery | {"whole_s": None}],
        "lives": [life],
        "footprints": {"run": notes},
        "log": {"run": {"WARNING x": 3}},
    }
    found = {
        "executions": 2_000_000,
        "crashes": {"a": {}},
        "slowest_s": 0.02,
        "peak_rss_bytes": 2**21,
        "rss_at_start_bytes": 0,
    }
    text = reliability_text(document, {"targets": {"trace": found}})
    assert "4 changes of capacity" in text
    assert f"({WHEN}; 2.2 at the end)" in text
    assert "| 2 of 100 lost, 0 doubled, 1 out of order |" in text
    assert "median 2.0 s, longest 2.0 s; within 5 s: 1 of 2; 1 not before the next event" in text
    assert "2.0 million inputs, 1 crashes; slowest 20 ms (trace)" in text
    assert "fuzzing" not in reliability_text(document)
