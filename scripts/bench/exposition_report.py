"""The results of `exposition.py` for docs/results.md."""

from __future__ import annotations

from typing import Any

from scripts.bench.record import described


def markdown(document: dict[str, Any]) -> str:
    """Return a sentence on the largest number of topics, and one on the ticks under the most scrapers."""
    race = max(document["races"], key=lambda race: race["topics"])
    spent = list(race["median_s"].values())
    ours, theirs = (_range_ms([each[side] for each in spent]) for side in ("arpd", "prometheus_client"))
    ticking = document["ticking"]
    scrapers, found = max(ticking["by_scrapers"].items(), key=lambda item: int(item[0]))
    late = round(found["late_share"] * found["ticks"])
    return (
        f"With {race['topics']:,} topics ({race['samples']:,} series) arpd writes `/metrics` in {ours} ms; "
        f"prometheus_client's own encoder takes {theirs} ms for as many series. {scrapers} scrapers at once each ask a "
        f"daemon with {ticking['topics']:,} topics four times a second: it answers in "
        f"{found['scrape_median_s'] * 1e3:.0f} ms (median), and {late or 'none'} of {found['ticks']:,} ticks began "
        f"late (`scripts/bench/exposition.py`; {described(document)})."
    )


def _range_ms(seconds: list[float]) -> str:
    """Return the range over text and OpenMetrics."""
    return " to ".join(f"{second * 1e3:.0f}" for second in sorted(seconds))
