"""The results of `relay.py`, as text and for docs/results.md."""

from __future__ import annotations

from itertools import chain
from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.record import described

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

TARGET = 1.1
DIRECT = "direct"
RELAYS = BARE, ONE_END, TWO_ENDS = ("bare relay", "one end", "two ends")
_CAPTION = (
    "CPU is in µs per message, *robot+CEDDP* that of each of the two ends; latency is the median (95th percentile) in "
    "ms beyond that of the same messages without a relay. CPU contains what a relay spends at rest. Relays, the bare "
    "one too, write in parts of 1392 bytes, as arpd's Fast DDS profile says; the source writes in parts of 64 kB."
)
_SHORT_BYTES = 100_000  # a latency of larger payloads is mostly their time on the link


def cpu_us(cell: dict[str, Any], side: str, *, process: int | None = None) -> float:
    """Return the CPU per message of a side's relay, or of one process of it (us)."""
    turns = cell["sides"][side]["cpu_s"]
    return float(1e6 * median(sum(turn) if process is None else turn[process] for turn in turns))


def ratio(cell: dict[str, Any], side: str = ONE_END, *, to: str = BARE) -> float:
    """Return the CPU per message of a side over that of another."""
    return cpu_us(cell, side) / cpu_us(cell, to)


def added_ms(cell: dict[str, Any], side: str, figure: str = "latency_s") -> float:
    """Return the latency that a side adds to no relay: of medians, or with ``p95_s`` of 95th percentiles (ms)."""
    return float(1e3 * (median(cell["sides"][side][figure]) - median(cell["sides"][DIRECT][figure])))


def lost(cell: dict[str, Any], side: str) -> int:
    """Return the messages that did not come out."""
    return int(cell["sides"][side]["sent"] - cell["sides"][side]["received"])


def row(cell: dict[str, Any]) -> str:
    """Return a cell as a line of `table`."""
    found = ratio(cell)
    parts = [
        "".join(f"{cell[name]:>{width}}" for name, width in (("payload_bytes", 8), ("topics", 7), ("rate_hz", 5))),
        "".join(f"{cpu_us(cell, side):>10.0f}" for side in RELAYS),
        f"{_by_end(cell):>13}",
        f"{found:>6.2f}{'!' if found > TARGET else ' '}{ratio(cell, TWO_ENDS, to=ONE_END):>6.2f}",
        "".join(f"{_latency(cell, side):>17}" for side in RELAYS),
        "".join(f"{lost(cell, side):>5}" for side in (DIRECT, *RELAYS)),
        *(
            f"  {side}: {cpu_us(cell, side):.0f} us, {_latency(cell, side)} ms"
            for side in cell["sides"]
            if side not in {DIRECT, *RELAYS}
        ),
    ]
    return "".join(parts)


def table(cells: Sequence[dict[str, Any]]) -> str:
    """Return the cells as text."""
    heads = [
        f"{'':>20}{'CPU us/message':^43}{'ratio':^13}{'added latency ms, median (p95)':^51}{'lost':^20}",
        f"{'bytes':>8}{'topics':>7}{'Hz':>5}"
        + "".join(f"{name:>10}" for name in ("bare", "one end", "two ends"))
        + f"{'robot+CEDDP':>13}{'1/b':>6} {'2/1':>6}"
        + "".join(f"{name:>17}" for name in ("bare", "one end", "two ends"))
        + "".join(f"{name:>5}" for name in ("none", "bare", "one", "two")),
    ]
    missed = sum(ratio(cell) > TARGET for cell in cells)
    return "\n".join(
        [
            *heads,
            *map(row, cells),
            "",
            f"1/b: one end over the bare relay, ! = above {TARGET}; 2/1: two ends over one end",
            *(
                f"{side} at rest: {median(_rests(cells, side)):.1%} of a core (worst {max(_rests(cells, side)):.1%})"
                for side in (ONE_END, TWO_ENDS)
            ),
            f"{len(cells) - missed} of {len(cells)} cells within {TARGET}",
        ]
    )


def markdown(document: dict[str, Any]) -> str:
    """Return bullets with the ranges, and a table of every cell."""
    cells = document["cells"]
    short = [cell for cell in cells if cell["payload_bytes"] <= _SHORT_BYTES]
    second = [added_ms(cell, TWO_ENDS) - added_ms(cell, ONE_END) for cell in short]
    ends = sorted(ratio(cell, TWO_ENDS, to=ONE_END) for cell in cells)
    gone = sum(lost(cell, TWO_ENDS) for cell in cells)
    sent = sum(cell["sides"][TWO_ENDS]["sent"] for cell in cells)
    two_ends = (
        f"- Both ends together cost {ends[0]:.2f} to {ends[-1]:.2f} times the CPU per message of one end, in two "
        f"processes on two hosts. Up to {_SHORT_BYTES:,} bytes the second hop adds {min(second):.2f} to "
        f"{max(second):.2f} ms to the median latency. Of {sent:,} messages {gone or 'none'} got lost. At rest, "
        f"both ends together take {median(_rests(cells, TWO_ENDS)):.1%} of a core (median of the cells)."
    )
    columns = ("bare relay", "one end", "two ends")
    head = ["bytes", "topics", "Hz", *(f"CPU µs, {name}" for name in columns), "robot+CEDDP"]
    head += [f"added ms, {name}" for name in columns]
    return "\n".join(
        [
            f"{_one_end(cells)} (`scripts/bench/relay.py`; {described(document)}).",
            two_ends,
            "",
            f"| {' | '.join(head)} |",
            f"|{'---:|' * len(head)}",
            *map(_markdown_row, cells),
            "",
            _CAPTION,
        ]
    )


def _one_end(cells: Sequence[dict[str, Any]]) -> str:
    """Return a bullet with the range of the ratios, and every cell above the target."""
    cells = sorted(cells, key=ratio)
    above = [cell for cell in cells if ratio(cell) > TARGET]
    within = [ratio(cell) for cell in cells if ratio(cell) <= TARGET]
    text = "- With one end the relay costs "
    if within:
        text += (
            f"{within[0]:.2f} to {within[-1]:.2f} times the CPU per message of a ten-line relay on EventsExecutor"
            f" in {len(within)} of {len(cells)} combinations of payload and topics"
        )
    if above:
        text += (" and " if within else "") + "; ".join(
            f"{ratio(cell):.2f} times with {cell['topics']} topic{'s' * (cell['topics'] != 1)} of "
            f"{cell['payload_bytes']:,} bytes"
            for cell in above
        )
    return text


def _markdown_row(cell: dict[str, Any]) -> str:
    figures = [
        *(f"{cell[name]:,}" for name in ("payload_bytes", "topics", "rate_hz")),
        *(f"{cpu_us(cell, side):.0f}" for side in RELAYS),
        _by_end(cell),
        *(_latency(cell, side) for side in RELAYS),
    ]
    return f"| {' | '.join(figures)} |"


def _by_end(cell: dict[str, Any]) -> str:
    """Return the CPU per message of the robot's end, and that of the CEDDP's (us)."""
    return "+".join(f"{cpu_us(cell, TWO_ENDS, process=process):.0f}" for process in (0, 1))


def _latency(cell: dict[str, Any], side: str) -> str:
    """Return the latency that a side adds, and in parentheses the 95th percentile (ms)."""
    return f"{added_ms(cell, side):.2f} ({added_ms(cell, side, 'p95_s'):.2f})"


def _rests(cells: Iterable[dict[str, Any]], side: str) -> list[float]:
    return list(chain.from_iterable(cell["sides"][side]["rest"] for cell in cells))
