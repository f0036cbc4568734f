"""Measure a change of QoS: messages lost, doubled and reordered, the longest gap, CPU and bytes.

Usage: .venv/bin/python scripts/bench/swap.py [--quick | --full] [--only TEXT] [--minutes M] [--json FILE]

Needs root, as the simulated link does.

Three ways take turns on every cell, in rotating order: an AdaptivePublisher whose settings stay (the baseline), one
whose DEPTH changes by one, up and down, and a plain publisher that is destroyed and created again. Writer and readers
are processes of their own; the time of an arrival is that of its reception by DDS, so a busy Python does not change it.
All run with arpd's Fast DDS profile (heartbeat of 50 ms), which helps destroy+create too: lost samples are resent
sooner. CPU and bytes of a swap are the difference between the phase with swaps and the still phase of the same turn.
"local" is one host of the simulated link, over UDP. Only ratios within one run mean anything.

Then twelve topics are swapped without a pause for some minutes (swap_soak.py): what grows, and whether a subscriber is
lost.
"""

from __future__ import annotations

import itertools
import sys
import time
from contextlib import closing
from dataclasses import asdict, dataclass, field
from math import sqrt
from pathlib import Path
from statistics import quantiles
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from arpd.model.wire import MTU_BYTES
from scripts.bench.child import Child, ChildError, sent_bytes
from scripts.bench.node import becomes_true
from scripts.bench.record import conditions, keep, options_of
from scripts.bench.report import Column, about, details, milli, paragraphs, scaled, table
from scripts.bench.swap_soak import soak, soak_report
from scripts.netns.simlink import SimLink

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from scripts.netns.namespaces import HostName

STILL, ADAPTIVE, RECREATE = WAYS = ("no swaps", "adaptive", "destroy+create")
EVENTS = ("lost", "doubled", "reordered")
PROMISED_DEPTH = 10  # deep enough to lose nothing
SOAK = "soak"
LINK_BYTES_PER_SECOND = 100e6 / 8
WIRE_OVERHEAD = 180  # bytes of headers around a payload
MOST_DELIVERIES_HZ = 4000  # limit of a writer and its readers on two cores
STILL_S, SPACING_S, REQUESTS, QUICK_REQUESTS = 1.0, 0.5, 6, 1
# An adaptive swap settles for so long. The others go on publishing for as long, because time alone causes some losses:
# IP fragments of large samples fill the kernel's reassembly memory within half a minute, with or without swaps.
SETTLE_S = 3.2
START_S = 20.0  # on a lossy link a reader may discover its writer seconds late, with or without a swap


@dataclass(frozen=True, kw_only=True, slots=True)
class Setting:
    """The readers' host: the writer's own (local), or the other end of a link with a loss."""

    place: str
    loss: float = 0.0

    def __str__(self) -> str:
        return self.place + (f" {self.loss:.0%} loss" if self.loss else "")


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """One combination."""

    setting: Setting
    readers: int
    rate_hz: int
    depth: int
    payload_bytes: int

    def why_not(self) -> str:
        """Return why this cell cannot measure swaps; empty if it can."""
        crossing = self.rate_hz * (self.payload_bytes + WIRE_OVERHEAD) * self.readers
        if self.setting.place == "link" and crossing > 0.7 * LINK_BYTES_PER_SECOND:
            return f"{crossing * 8e-6:.0f} Mbit/s do not fit the link"
        if self.rate_hz * self.readers * max(1, self.payload_bytes // 10_000) > MOST_DELIVERIES_HZ:
            return "more than two cores carry"
        return ""


LOCAL, LINK = Setting(place="local"), Setting(place="link")
LOSS_2, LOSS_10 = Setting(place="link", loss=0.02), Setting(place="link", loss=0.1)


def cells(which: str) -> list[Cell]:
    """Return the whole matrix, or a selection."""

    def some(
        setting: Setting, combinations: Iterable[tuple[int, int]], payloads: Sequence[int] = (100,), readers: int = 1
    ) -> list[Cell]:
        return [
            Cell(setting=setting, readers=readers, rate_hz=rate, depth=depth, payload_bytes=payload)
            for (rate, depth), payload in itertools.product(combinations, payloads)
        ]

    if which == "quick":
        return some(LINK, [(100, 10)])
    rates, depths = (10, 100, 1000), (1, 10, 100, 5000)
    whole = list(itertools.product(rates, depths))
    if which == "full":
        return [
            cell
            for setting in (LOCAL, LINK, LOSS_2, LOSS_10)
            for readers in (1, 3, 10)
            for cell in some(setting, whole, (10, 100, 1000, 30_000), readers)
        ]
    return [
        *some(LOCAL, whole),
        *some(LOCAL, [(100, 10)], (10, 1000, 30_000)),
        *some(LINK, [(10, 10), (100, 1), (100, 10), (1000, 10), (1000, 100), (1000, 5000)]),
        *some(LINK, [(10, 10), (100, 10)], (30_000,)),
        *some(LINK, [(100, 10), (1000, 100)], readers=3),
        *some(LINK, [(100, 10)], readers=10),
        *some(LOSS_2, [(10, 10), (100, 10), (1000, 100), (1000, 5000)]),
        *some(LOSS_2, [(10, 10)], (30_000,)),
        *some(LOSS_2, [(100, 100)], readers=3),
        *some(LOSS_10, [(10, 10), (100, 10), (100, 100), (1000, 100), (1000, 5000)]),
        *some(LOSS_10, [(100, 100)], readers=3),
    ]


@dataclass(slots=True)
class Tally:
    """The figures of one way in one cell, over all rounds and readers."""

    expected: int = 0
    lost: int = 0
    doubled: int = 0
    reordered: int = 0
    swaps: int = 0
    gap_s: float = 0.0
    longest_publish_s: float = 0.0
    cpu_s: float = 0.0  # above the still phase
    wire_bytes: float = 0.0  # above the still phase
    results: dict[str, int] = field(default_factory=dict)
    evidence: list[dict[str, Any]] = field(default_factory=list)

    def add(self, done: dict[str, Any], reports: list[dict[str, Any]], sent: list[int], phases_s: list[float]) -> None:
        """Add a turn."""
        self.expected += (done["end"] - done["first"]) * len(reports)
        for event in EVENTS:
            setattr(self, event, getattr(self, event) + sum(len(report[event]) for report in reports))
        self.swaps += len(done["requests"])
        self.gap_s = max(self.gap_s, *(report["gap_s"] for report in reports))
        self.longest_publish_s = max(self.longest_publish_s, done["longest_publish_s"])
        # Both phases publish at the same rate, so the still one gives the cost of the messages themselves.
        longer = phases_s[1] / phases_s[0]
        before, between, after = done["cpu_s"]
        self.cpu_s += (after - between) - (between - before) * longer
        self.wire_bytes += (sent[2] - sent[1]) - (sent[1] - sent[0]) * longer
        for key, count in done["results"].items():
            self.results[key] = self.results.get(key, 0) + count
        for reader, report in enumerate(reports):
            if any(report[event] for event in EVENTS):
                found = {event: report[event][:40] for event in EVENTS if report[event]}
                self.evidence.append(
                    {
                        "reader": reader,
                        "first": done["first"],
                        "requested_at": done["requests"],
                        "switched_at": report["switches"],
                        **found,
                    }
                )


class Bench:
    """The writer and the readers of one setting."""

    def __init__(self, link: SimLink, setting: Setting, requests: int) -> None:
        self._link, self._setting, self._requests = link, setting, requests
        self._readers: list[Child] = []
        self._turns = itertools.count()
        link.set_loss(setting.loss)
        self._writer = Child(link, "robot", "scripts.bench.swap_nodes", "writer")

    def close(self) -> None:
        for child in (self._writer, *self._readers):
            child.end()

    def turn(self, cell: Cell, way: str, tally: Tally) -> None:
        """Let one way publish and swap, and add the figures of the turn."""
        host: HostName = "robot" if cell.setting.place == "local" else "ceddp"
        while len(self._readers) < cell.readers:
            self._readers.append(Child(self._link, host, "scripts.bench.swap_nodes", "reader"))
        readers = self._readers[: cell.readers]
        topic = f"/bench/t{next(self._turns)}"
        for reader in readers:
            reader.ask(topic=topic)
        self._writer.send(
            way=way,
            topic=topic,
            readers=cell.readers,
            rate_hz=cell.rate_hz,
            depth=cell.depth,
            payload_bytes=cell.payload_bytes,
            still_s=max(STILL_S, 10 / cell.rate_hz),
            swaps=self._requests,
            spacing_s=SPACING_S if way == ADAPTIVE else SPACING_S + SETTLE_S,
        )
        self._writer.receive()
        becomes_true(lambda: all(reader.ask(peek=True)["received"] for reader in readers), START_S, poll_s=0.2)
        self._writer.send(go=True)
        sent, at_s = [], []
        done: dict[str, Any] = {}
        while done.get("phase") != "done":
            done = self._writer.receive(timeout_s=90.0)
            sent.append(self._sent_bytes())
            at_s.append(time.monotonic())
        tail_s = 3.0 if cell.setting.loss else 1.0
        for reader in readers:
            reader.send(first=done["first"], end=done["end"], tail_s=tail_s)
        reports = [reader.receive() for reader in readers]
        self._writer.ask(close=True)
        tally.add(done, reports, sent, [at_s[1] - at_s[0], at_s[2] - at_s[1]])

    def _sent_bytes(self) -> int:
        if self._setting.place == "local":
            return sent_bytes(self._link.robot, "lo")
        return sum(map(sent_bytes, self._link.hosts))


def measure(cell: Cell, bench: Bench, rounds: int, turn: int) -> dict[str, Tally]:
    tallies = {way: Tally() for way in WAYS}
    for k in range(rounds):
        first = (turn + k) % len(WAYS)
        for way in WAYS[first:] + WAYS[:first]:
            bench.turn(cell, way, tallies[way])
    return tallies


def beyond(ways: Mapping[str, Mapping[str, Any]], way: str) -> list[str]:
    """Return the events that a way shows more often than the baseline, beyond the scatter of the baseline's own."""
    found = []
    longer = ways[way]["expected"] / max(1, ways[STILL]["expected"])  # a phase with slow swaps has more samples
    for event in EVENTS:
        ours, still = ways[way][event], ways[STILL][event] * longer
        if ours > still + (3 * sqrt(ours + still) if still else 0):
            found.append(event)
    return found


def report(document: dict[str, Any]) -> str:
    """Return each way over all combinations, the soak, and every combination."""
    cells, soaked = document["cells"], document.get("soak")
    deep = [cell for cell in cells if cell["depth"] >= PROMISED_DEPTH]
    often = [cell for cell in cells if cell["rate_hz"] >= 100]
    slow = [cell for cell in cells if cell["rate_hz"] <= 100 and cell["payload_bytes"] <= MTU_BYTES]
    losses = sorted({f"{100 * cell['setting']['loss']:g}" for cell in cells}, key=float)

    def total(key: str) -> Column:
        return (key, lambda way: sum(cell["ways"][way][key] for cell in deep), "{:,}")

    def gap(head: str, among: Sequence[dict[str, Any]]) -> Column:
        return (head, lambda way: max((cell["ways"][way]["gap_s"] for cell in among), default=None), milli)

    def spent(way: str) -> str | None:
        spent_ms = [1e3 * of["cpu_s"] / of["swaps"] for of in (cell["ways"][way] for cell in slow) if of["swaps"]]
        low, _, high = quantiles(spent_ms, n=4) if len(spent_ms) > 1 and way != STILL else (0.0, 0.0, 0.0)
        return f"{round(low)} to {round(high)}" if high else None

    parts = [soak_report(soaked)] if soaked else []
    if cells:
        what = (
            f"{len(deep)} combinations with DEPTH ≥ {PROMISED_DEPTH}, on one host and over a link with "
            f"{', '.join(losses)} % loss, {_range(cells, 'rate_hz')} Hz, {_range(cells, 'readers')} readers; gaps "
            "between two samples at 100 Hz and more; CPU at up to 100 Hz, the middle half of the combinations"
        )
        over_all = table(
            WAYS,
            ("", str),
            ("swaps", lambda way: None if way == STILL else sum(cell["ways"][way]["swaps"] for cell in deep)),
            *map(total, ("expected", *EVENTS)),
            ("combinations worse", lambda way: sum(bool(beyond(cell["ways"], way)) for cell in deep)),
            gap("longest gap ms", [cell for cell in often if not cell["setting"]["loss"]]),
            gap("with loss ms", [cell for cell in often if cell["setting"]["loss"]]),
            ("CPU ms per swap", spent),
        )
        legend = (
            "Lost/doubled/reordered of the samples expected by an adaptive publisher's readers; ! = beyond what the "
            "scatter of the run without swaps explains."
        )
        parts = [about(document, what), over_all, *parts, details("All combinations", legend, table(cells, *_CELL))]
    return paragraphs(*parts)


def _events(way: str) -> Column:
    def shown(cell: dict[str, Any]) -> str:
        events = "/".join(str(cell["ways"][way][event]) for event in EVENTS)
        return events + ("!" if beyond(cell["ways"], way) else "")

    return (way, shown)


def _of_way(head: str, way: str, key: str, form: Any, *, per_swap: bool = False) -> Column:
    def value(cell: dict[str, Any]) -> float:
        tally = cell["ways"][way]
        return float(tally[key] / tally["swaps"] if per_swap else tally[key])

    return (f"{head}, {way}", value, form)


_CELL: tuple[Column, ...] = (
    ("setting", lambda cell: str(Setting(**cell["setting"]))),
    ("readers", "readers"),
    ("Hz", "rate_hz"),
    ("depth", "depth"),
    ("bytes", "payload_bytes"),
    _of_way("expected", ADAPTIVE, "expected", "{:.0f}"),
    *map(_events, WAYS),
    *(_of_way("gap ms", way, "gap_s", milli) for way in WAYS),
    *(_of_way("CPU ms/swap", way, "cpu_s", scaled(1e3, ".1f"), per_swap=True) for way in WAYS[1:]),
    *(_of_way("kB/swap", way, "wire_bytes", scaled(1e-3, ".1f"), per_swap=True) for way in WAYS[1:]),
    ("swaps", lambda cell: " ".join(f"{n} {key}" for key, n in sorted(cell["ways"][ADAPTIVE]["results"].items()))),
)


def _range(cells: Sequence[dict[str, Any]], key: str) -> str:
    values = sorted({cell[key] for cell in cells})
    return " to ".join(dict.fromkeys(map(str, (values[0], values[-1])))) if values else ""


def main() -> None:
    parser = options_of(__doc__, "swap", quick="one cell and a soak of six seconds")
    parser.add_argument("--full", action="store_true", help="every cell, hours")
    parser.add_argument("--rounds", type=int, default=1, metavar="N", help="turns of each way per cell (default 1)")
    parser.add_argument("--minutes", type=float, default=3.0, metavar="M", help="length of the soak (default 3)")
    parser.add_argument(
        "--only", default="", metavar="TEXT", help="cells whose setting contains this: local, link, loss; or soak"
    )
    options = parser.parse_args()
    if options.quick and options.full:
        parser.error("--quick and --full exclude each other")
    which = "quick" if options.quick else "full" if options.full else "default"
    wanted = [cell for cell in cells(which) if options.only in str(cell.setting)]
    skipped = {cell: why for cell in wanted if (why := cell.why_not())}
    possible = [cell for cell in wanted if cell not in skipped]
    document: dict[str, Any] = {
        "conditions": conditions(),
        "cells": [],
        "skipped": [{**asdict(cell), "why": why} for cell, why in skipped.items()],
    }
    failed: list[str] = []
    run_id = f"swap-{time.monotonic_ns() % 10**9}"
    with SimLink(run_id, rate_bytes_per_second=LINK_BYTES_PER_SECOND, queue_bytes=1_000_000) as link:
        for cell, tallies in measured(possible, link, options.rounds, QUICK_REQUESTS if options.quick else REQUESTS):
            document["cells"].append({**asdict(cell), "ways": {way: asdict(tally) for way, tally in tallies.items()}})
        if options.only in ("", SOAK):
            link.set_loss(0.0)
            try:
                document["soak"] = soak(link, 0.1 if options.quick else options.minutes)
            except ChildError as error:
                failed.append(f"soak: {error}")
    is_partial = options.quick or bool(options.only)
    keep(document, options, "swap", is_partial=is_partial)
    print(report(document))
    if len(document["cells"]) < len(possible):
        failed.append("not every cell could be measured")
    if failed:
        sys.exit(f"swap: {'; '.join(failed)}")


def measured(
    wanted: Sequence[Cell], link: SimLink, rounds: int, requests: int
) -> Iterator[tuple[Cell, dict[str, Tally]]]:
    """Yield every cell as it is measured; after a child has failed, the rest of its setting is left out."""
    turn, started_s = 0, time.monotonic()
    with progress("measuring", total=len(wanted)) as shown:
        for setting, group in itertools.groupby(wanted, key=lambda cell: cell.setting):
            with closing(Bench(link, setting, requests)) as bench:
                for cell in group:
                    shown.step(f"{cell.setting}: {cell.readers} readers, {cell.rate_hz} Hz, depth {cell.depth}")
                    try:
                        tallies = measure(cell, bench, rounds, turn)
                    except ChildError as error:
                        print(f"{cell}: {error}", file=sys.stderr)
                        break
                    turn += 1
                    lost = ", ".join(f"{tally.lost} {way}" for way, tally in tallies.items())
                    print(f"{time.monotonic() - started_s:5.0f} s  {cell}: lost {lost}", flush=True)
                    yield cell, tallies


if __name__ == "__main__":
    main()
