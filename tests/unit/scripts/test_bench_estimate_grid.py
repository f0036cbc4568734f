"""The grid of scripts/bench/estimate.py."""

from __future__ import annotations

from dataclasses import replace

import pytest

from scripts.bench.estimate_grid import Cell, Judged, sample

CELL = Cell(before_mbit=20.0, change=0.55, load="busy")
BOUND = {"p50": 0.02, "p99": 0.1, "goodput": 1e6}


def judged(**figures):
    return Judged(cell=CELL, arpd=BOUND | figures, bound=BOUND)


def test_a_sample_comes_from_its_seed_and_has_every_choice():
    """A longer sample begins with the shorter one, and every value of every field is somewhere."""
    cells = sample(300)
    assert sample(20) == cells[:20]
    assert sample(20, seed=2) != cells[:20]
    assert {cell.change for cell in cells} == {0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.95, 1.5, 4.0}
    assert {cell.load for cell in cells} == {"light", "demo", "busy"}
    assert {(cell.has_peer, cell.has_map) for cell in cells} == {(a, b) for a in (False, True) for b in (False, True)}
    for name, values in (("upload", 3), ("download_mbit", 3), ("loss", 3), ("queue_bytes", 3), ("aggregate", 3)):
        assert len({getattr(cell, name) for cell in cells}) == values
    assert 0.5 < sum(cell.has_peer for cell in cells) / 300 < 0.7


def test_a_cell_says_what_is_unusual_about_it():
    """What is as usual is left out."""
    assert CELL.text == "20→11, busy"
    odd = replace(CELL, upload=0.15, loss=0.01, queue_bytes=64_000, aggregate=16, has_peer=False)
    assert odd.text == "20→11, busy, upload 15 %, loss 1 %, queue 64 kB, aggregates of 16, no peer"


@pytest.mark.parametrize(
    ("figures", "ratio"),
    [
        ({}, 1.0),
        ({"p50": 0.05}, 2.0),  # (50 + 10) / (20 + 10)
        ({"p99": 0.43}, 4.0),
        ({"goodput": 8e5}, 1.25),
        ({"goodput": 0.0}, 1e6),
        ({"p50": 0.0, "p99": 0.0, "goodput": 2e6}, 0.5),
    ],
)
def test_the_ratio_is_that_of_the_worst_figure(figures, ratio):
    """Queues are compared with 10 ms of grace, and goodput the other way round."""
    assert judged(**figures).ratio == pytest.approx(ratio)
