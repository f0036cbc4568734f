"""Judge the notes of `soak.py`: what grew, what was lost, and the bullet of docs/results.md."""

from __future__ import annotations

from typing import Any

from scripts.bench.record import described

SETTLED = 500
RSS_TARGET_BYTES = 2 * 2**20


def verdict(document: dict[str, Any]) -> list[str]:
    """Say of both processes what grew since the first swaps, and of the samples what became of them."""
    lines = []
    settled, last = _ends(document)
    for name, grown in _grown(document).items():
        too_much = grown["rss_bytes"] > RSS_TARGET_BYTES or grown["threads"] > 0 or grown["files"] > 0
        lines.append(
            f"{name}, from swap {settled['swaps']} to {last['swaps']}: RSS {grown['rss_bytes'] / 2**20:+.2f} MiB, "
            f"threads {grown['threads']:+d}, open files {grown['files']:+d}" + (" - too much" if too_much else "")
        )
    topics = len(document["received"])
    behind = sum(document["sent"] - 1 - highest > 0 for highest in document["highest"])
    lines.append(
        f"of {document['sent']} samples on each of {topics} topics: {_lost(document)} lost (late ones may hide "
        f"others), {sum(document['late'])} out of order or doubled; {topics - behind} topics received the last sample"
    )
    return lines


def markdown(document: dict[str, Any]) -> str:
    """Return a bullet on thousands of swaps on end."""
    settled, last = _ends(document)
    grown = " and ".join(
        f"the {name} grew by {change['rss_bytes'] / 2**20:.1f} MiB, {change['threads']} threads and "
        f"{change['files']} open files"
        for name, change in _grown(document).items()
    )
    lost, late = _lost(document), sum(document["late"])
    return (
        f"- {last['swaps']:,} swaps in {last['elapsed_s']:.0f} s on {len(document['received'])} topics "
        f"(`scripts/bench/soak.py`; {described(document)}): {lost or 'none'} of "
        f"{document['sent'] * len(document['received']):,} samples lost, {late or 'none'} doubled or out of order; "
        f"from swap {settled['swaps']} on {grown}."
    )


def _ends(document: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    notes = document["notes"]
    return next((note for note in notes if note["swaps"] >= SETTLED), notes[0]), notes[-1]


def _grown(document: dict[str, Any]) -> dict[str, dict[str, int]]:
    settled, last = _ends(document)
    return {name: {key: last[name][key] - settled[name][key] for key in last[name]} for name in ("writer", "reader")}


def _lost(document: dict[str, Any]) -> int:
    pairs = zip(document["received"], document["late"], strict=True)
    return sum(document["sent"] - (received - late) for received, late in pairs)
