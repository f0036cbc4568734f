"""The verdicts of the benchmark of swaps, from made figures; real swaps need the link."""

from __future__ import annotations

from scripts.bench.swap import ADAPTIVE, RECREATE, STILL, beyond
from scripts.bench.swap_soak import grown_by_process, lost


def tally(**changes):
    return {"expected": 100, "lost": 0, "doubled": 0, "reordered": 0} | changes


def test_scatter_of_the_baseline_is_not_blamed_on_swaps():
    """A longer run loses more, and a few more than the baseline is luck; any loss is too much beside none."""
    ways = {STILL: tally(lost=10), ADAPTIVE: tally(lost=25, expected=200), RECREATE: tally(lost=60)}
    assert beyond(ways, ADAPTIVE) == []
    assert beyond(ways, RECREATE) == ["lost"]
    assert beyond({STILL: tally(), ADAPTIVE: tally(doubled=1)}, ADAPTIVE) == ["doubled"]


def test_a_soak_counts_growth_and_loss():
    """Growth counts from the first five hundred swaps on; late samples do not make up for lost ones."""
    process = {"rss_bytes": 50, "threads": 9, "files": 12}
    notes = [
        {"swaps": swaps, "writer": process | {"rss_bytes": rss_bytes}, "reader": process}
        for swaps, rss_bytes in ((100, 40), (500, 50), (1000, 53))
    ]
    none = dict.fromkeys(process, 0)
    assert grown_by_process({"notes": notes}) == {"writer": none | {"rss_bytes": 3}, "reader": none}
    assert lost({"sent": 200, "received": [200, 199], "late": [0, 1]}) == 2
