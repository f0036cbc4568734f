"""The results of `soak.py`, as text and for docs/results.md: what grew, and what was lost."""

from __future__ import annotations

from typing import Any

from scripts.bench.record import described

SETTLED = 500
RSS_TARGET_BYTES = 2 * 2**20


def verdict(document: dict[str, Any]) -> list[str]:
    """Return the growth of both processes since the first swaps, and the fate of the samples."""
    lines = []
    settled, last = _ends(document)
    for name, grown in grown_by_process(document).items():
        too_much = grown["rss_bytes"] > RSS_TARGET_BYTES or grown["threads"] > 0 or grown["files"] > 0
        lines.append(
            f"{name}, from swap {settled['swaps']} to {last['swaps']}: RSS {grown['rss_bytes'] / 2**20:+.2f} MiB, "
            f"threads {grown['threads']:+d}, open files {grown['files']:+d}" + (" - too much" if too_much else "")
        )
    topics = len(document["received"])
    behind = sum(document["sent"] - 1 - highest > 0 for highest in document["highest"])
    lines.append(
        f"of {document['sent']} samples on each of {topics} topics: {lost(document)} lost (late ones may hide "
        f"others), {sum(document['late'])} out of order or doubled; {topics - behind} topics received the last sample"
    )
    return lines


def markdown(document: dict[str, Any]) -> str:
    """Return a bullet on thousands of swaps without a pause."""
    settled, last = _ends(document)
    grown = " and ".join(
        f"the {name} grew by {change['rss_bytes'] / 2**20:.1f} MiB, {change['threads']} threads and "
        f"{change['files']} open files"
        for name, change in grown_by_process(document).items()
    )
    gone, late = lost(document), sum(document["late"])
    return (
        f"- {last['swaps']:,} swaps in {last['elapsed_s']:.0f} s on {len(document['received'])} topics "
        f"(`scripts/bench/soak.py`; {described(document)}): {gone or 'none'} of "
        f"{document['sent'] * len(document['received']):,} samples lost, {late or 'none'} doubled or out of order; "
        f"from swap {settled['swaps']} on {grown}."
    )


def _ends(document: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    notes = document["notes"]
    return next((note for note in notes if note["swaps"] >= SETTLED), notes[0]), notes[-1]


def grown_by_process(document: dict[str, Any]) -> dict[str, dict[str, int]]:
    """Return what each process has more than after the first `SETTLED` swaps."""
    settled, last = _ends(document)
    return {name: {key: last[name][key] - settled[name][key] for key in last[name]} for name in ("writer", "reader")}


def lost(document: dict[str, Any]) -> int:
    """Return the number of lost samples over all topics."""
    pairs = zip(document["received"], document["late"], strict=True)
    return sum(document["sent"] - (received - late) for received, late in pairs)
