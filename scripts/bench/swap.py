"""Measure a change of QoS: messages lost, doubled and reordered, the longest gap, CPU and bytes.

Usage: .venv/bin/python scripts/bench/swap.py [--quick | --full] [--only TEXT] [--json FILE]

Needs root, as the simulated link does.

Three ways take turns on every cell, in rotating order: an AdaptivePublisher whose settings stay (the baseline), one
whose DEPTH changes by one, up and down, and a plain publisher that is destroyed and created again. Writer and readers
are processes of their own; the time of an arrival is that of its reception by DDS, so a busy Python does not change it.
All run with arpd's Fast DDS profile (heartbeat of 50 ms), which helps destroy+create too: lost samples are resent
sooner. CPU and bytes of a swap are the difference between the phase with swaps and the still phase of the same turn.
"local" is one host of the simulated link, over UDP. Only ratios within one run mean anything.
"""

from __future__ import annotations

import itertools
import sys
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from scripts.bench.child import Child, ChildError, sent_bytes
from scripts.bench.node import becomes_true
from scripts.bench.picture import picture
from scripts.bench.record import conditions, keep, options_of
from scripts.bench.swap_report import ADAPTIVE, EVENTS, WAYS, beyond, verdict
from scripts.netns.simlink import SimLink

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from scripts.bench.swap_report import Ways
    from scripts.netns.namespaces import HostName

LINK_BYTES_PER_SECOND = 100e6 / 8
WIRE_OVERHEAD = 180  # bytes of headers around a payload
MOST_DELIVERIES_HZ = 4000  # limit of a writer and its readers on two cores
STILL_S, SPACING_S, REQUESTS = 1.0, 0.5, 6
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
        return [*some(LINK, [(1000, 10)]), *some(LOSS_10, [(100, 10)])]
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

    def __init__(self, link: SimLink, setting: Setting) -> None:
        self._link, self._setting = link, setting
        self._readers: list[Child] = []
        self._turns = itertools.count()
        link.set_loss(setting.loss)
        self._writer = Child(link, "robot", "scripts.bench.swap_nodes", "writer")

    def end(self) -> None:
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
            swaps=REQUESTS,
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


def as_ways(tallies: dict[str, Tally]) -> Ways:
    return {way: asdict(tally) for way, tally in tallies.items()}


def as_cells(measured: list[tuple[Cell, dict[str, Tally]]]) -> list[dict[str, Any]]:
    return [{**asdict(cell), "ways": as_ways(tallies)} for cell, tallies in measured]


def table(measured: list[tuple[Cell, dict[str, Tally]]], skipped: dict[Cell, str]) -> str:
    def events(tally: Tally) -> str:
        return "/".join(str(getattr(tally, event)) for event in EVENTS)

    def results(tally: Tally) -> str:
        short = {"ok": "ok", "reorder_possible": "late", "superseded": "super", "undelivered": "undeliv"}
        return " ".join(f"{count} {short.get(key, key)}" for key, count in sorted(tally.results.items()))

    lines = [
        "lost/doubled/reordered; ! = beyond what the baseline shows; gap: longest between two arrivals",
        "",
        f"{'':>38}{'lost/doubled/reordered':^44}{'gap ms':^21}{'CPU ms/swap':^16}{'kB/swap':^14}",
        f"{'setting':>14}{'rd':>3}{'Hz':>5}{'depth':>6}{'bytes':>6}{'expected':>9}"
        + "".join(f"{way:>15}" for way in WAYS)
        + "".join(f"{way:>7}" for way in ("still", "adapt", "d+c"))
        + "".join(f"{way:>7}" for way in ("adapt", "d+c"))
        + "".join(f"{way:>7}" for way in ("adapt", "d+c"))
        + "  swaps of adaptive",
    ]
    for cell, tallies in measured:
        tested = [tallies[way] for way in WAYS[1:]]
        flags = {way: "!" if beyond(as_ways(tallies), way) else "" for way in WAYS}
        lines.append(
            f"{cell.setting!s:>14}{cell.readers:>3}{cell.rate_hz:>5}{cell.depth:>6}{cell.payload_bytes:>6}"
            f"{tallies[ADAPTIVE].expected:>9}"
            + "".join(f"{events(tallies[way]) + flags[way]:>15}" for way in WAYS)
            + "".join(f"{tallies[way].gap_s * 1e3:>7.0f}" for way in WAYS)
            + "".join(f"{tally.cpu_s / tally.swaps * 1e3:>7.1f}" for tally in tested)
            + "".join(f"{tally.wire_bytes / tally.swaps * 1e-3:>7.1f}" for tally in tested)
            + f"  {results(tallies[ADAPTIVE])}"
        )
    lines += [
        f"skipped: {cell.setting} {cell.rate_hz} Hz {cell.payload_bytes} B: {why}" for cell, why in skipped.items()
    ]
    return "\n".join([*lines, "", *verdict(as_cells(measured))])


def draw(measured: list[tuple[Cell, dict[str, Tally]]], path: Path) -> None:
    """Draw messages lost, doubled and reordered per swap, one row per cell that shows any."""
    shown = [pair for pair in measured if any(t.lost or t.reordered or t.doubled for t in pair[1].values())]
    labels = [f"{c.setting}, {c.readers} rd, {c.rate_hz} Hz, depth {c.depth}, {c.payload_bytes} B" for c, _ in shown]
    with picture(path, figsize=(9, 1.5 + 0.34 * max(1, len(shown)))) as (_, axes):
        for k, way in enumerate(WAYS):
            values = [(t[way].lost + t[way].doubled + t[way].reordered) / max(1, t[way].swaps) for _, t in shown]
            axes.barh([row + 0.27 * (k - 1) for row in range(len(shown))], values, height=0.26, label=way)
        axes.set_yticks(range(len(shown)), labels)
        axes.invert_yaxis()
        axes.set_xscale("symlog", linthresh=0.1)
        axes.set_xlabel("messages lost, doubled or reordered per swap, or in its time")
        axes.set_title(f"{len(measured) - len(shown)} of {len(measured)} cells without any are not shown", fontsize=9)
        axes.legend()


def main() -> None:
    parser = options_of(__doc__, "swap", quick="two cells, a minute", has_plot=True)
    parser.add_argument("--full", action="store_true", help="every cell, hours")
    parser.add_argument("--rounds", type=int, default=1, metavar="N", help="turns of each way per cell (default 1)")
    parser.add_argument(
        "--only", default="", metavar="TEXT", help="cells whose setting contains this: local, link, loss"
    )
    options = parser.parse_args()
    if options.quick and options.full:
        parser.error("--quick and --full exclude each other")
    which = "quick" if options.quick else "full" if options.full else "default"
    wanted = [cell for cell in cells(which) if options.only in str(cell.setting)]
    skipped = {cell: why for cell in wanted if (why := cell.why_not())}
    measured: list[tuple[Cell, dict[str, Tally]]] = []
    noted, started_s = conditions(), time.monotonic()
    with (
        SimLink(
            f"swap-{time.monotonic_ns() % 10**9}", rate_bytes_per_second=LINK_BYTES_PER_SECOND, queue_bytes=1_000_000
        ) as link,
        progress("measuring", total=len(wanted) - len(skipped)) as shown,
    ):
        for setting, group in itertools.groupby((c for c in wanted if c not in skipped), key=lambda c: c.setting):
            with ExitStack() as stack:
                bench = Bench(link, setting)
                stack.callback(bench.end)
                for cell in group:
                    shown.step(f"{cell.setting}: {cell.readers} readers, {cell.rate_hz} Hz, depth {cell.depth}")
                    try:
                        tallies = measure(cell, bench, options.rounds, len(measured))
                    except ChildError as error:
                        print(f"{cell}: {error}", file=sys.stderr)
                        break
                    measured.append((cell, tallies))
                    print(f"{time.monotonic() - started_s:5.0f} s", table([(cell, tallies)], {}).splitlines()[4])
    print(table(measured, skipped))
    document = {
        "conditions": noted,
        "cells": as_cells(measured),
        "skipped": [{**asdict(cell), "why": why} for cell, why in skipped.items()],
    }
    is_partial = options.quick or bool(options.only)
    keep(document, options, "swap", is_partial=is_partial, draw=partial(draw, measured))
    if len(measured) < len(wanted) - len(skipped):
        sys.exit("swap: not every cell could be measured")


if __name__ == "__main__":
    main()
