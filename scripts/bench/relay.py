"""Compare `arpd relay` with a bare rclpy relay of ten lines: CPU per message, and added latency.

Usage: .venv/bin/python scripts/bench/relay.py [--quick] [--against TREE] [--json FILE] [--plot FILE]

Needs root, as the simulated link does.

One source, one sink, and between them at the same time: `arpd relay` unpaced, a bare relay on each executor, and
nothing. They take short turns with the same messages, in rotating order, so that other load on the machine slows all of
them. CPU is the scheduler's account of all threads of the relay's process, divided by the messages that came out.
Latency is from just before `publish` in the source to reception by DDS in the sink, less the latency without a relay.
Fast DDS chooses the transport, as on any one host. Only ratios within one run mean anything; --against compares the
`arpd relay` of another source tree, which then takes turns too.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from scripts.bench.child import Child
from scripts.bench.picture import picture
from scripts.bench.record import REPO, conditions, keep, options_of
from scripts.bench.relay_report import TARGET
from scripts.netns.simlink import SimLink

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

ARPD, SINGLE, EVENTS, DIRECT = SIDES = ("arpd relay", "SingleThreadedExecutor", "EventsExecutor", "direct")
OTHER = "other tree"
PREFIXES = {ARPD: "/ours", SINGLE: "/single", EVENTS: "/events", DIRECT: "/none", OTHER: "/other"}
TURN_S = 1.5
TRANSPORT = {"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}
NODES = "scripts.bench.relay_nodes"


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """Payload and number of topics, with a rate over all of them that the slowest side carries."""

    payload_bytes: int
    topics: int
    rate_hz: int


DEFAULT = (
    Cell(payload_bytes=100, topics=1, rate_hz=600),
    Cell(payload_bytes=100, topics=12, rate_hz=600),
    Cell(payload_bytes=100, topics=100, rate_hz=200),
    Cell(payload_bytes=1000, topics=12, rate_hz=600),
    Cell(payload_bytes=10_000, topics=1, rate_hz=400),
    Cell(payload_bytes=10_000, topics=12, rate_hz=400),
    Cell(payload_bytes=100_000, topics=12, rate_hz=150),
    Cell(payload_bytes=1_000_000, topics=1, rate_hz=30),
    Cell(payload_bytes=1_000_000, topics=12, rate_hz=30),
)
QUICK = (DEFAULT[1], DEFAULT[5])


@dataclass(slots=True)
class Tally:
    """The figures of one side in one cell, turn by turn."""

    sent: int = 0
    received: int = 0
    cpu_s: list[float] = field(default_factory=list)  # per message
    main_thread_cpu_s: list[float] = field(default_factory=list)  # of these, in the thread that spins
    latency_s: list[float] = field(default_factory=list)
    p95_s: list[float] = field(default_factory=list)


def cpu_by_thread(pid: int) -> dict[int, float]:
    """Return the CPU time of every thread of a process, by the scheduler's account (s)."""
    spent = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        try:
            spent[int(task.name)] = int((task / "schedstat").read_text(encoding="utf-8").split()[0]) * 1e-9
        except OSError:
            continue
    return spent


class Bench:
    """All processes of one cell, on one host of the link.

    Parameters
    ----------
    workdir : folder for the relays' configuration
    trees : source trees with the relays to measure, by side
    """

    def __init__(self, link: SimLink, cell: Cell, workdir: Path, trees: Mapping[str, Path]) -> None:
        self._cell = cell
        self._prefix = {side: PREFIXES[side] for side in (*SIDES, *trees)}
        self._stack = ExitStack()

        def child(*argv: str, **environment: str) -> Child:
            process = Child(link, "robot", *argv, environment={**TRANSPORT, **environment})
            self._stack.callback(process.end)
            return process

        self._source, self._sink = child(NODES, "source"), child(NODES, "sink")
        self._relays = {
            side: child(NODES, "bare", side, self._prefix[side], str(cell.topics)) for side in (SINGLE, EVENTS)
        }
        for side, tree in trees.items():
            topics = [{"name": f"{self._prefix[side]}/t{k}"} for k in range(cell.topics)]
            config = workdir / f"{self._prefix[side].strip('/')}-{cell.payload_bytes}-{cell.topics}.yaml"
            config.write_text(json.dumps({"relay": {"prefix": "/out", "topics": topics}}))  # JSON is YAML
            argv = ("arpd.cli", "relay", "--config", str(config), "--node-name", PREFIXES[side].strip("/"))
            # Without the safe path, `-m` would take the arpd of the working directory.
            self._relays[side] = child(*argv, "--log-level", "warning", PYTHONPATH=str(tree), PYTHONSAFEPATH="1")
        self._sink.ask(open=[self._out(side) for side in self._prefix], topics=cell.topics)
        matched = self._source.ask(open=list(self._prefix.values()), topics=cell.topics)["matched"]
        matched = self._sink.ask(match=True)["matched"] and matched
        if not matched:
            self.end()
            raise SystemExit(f"{cell}: not every relay found its topics")

    def end(self) -> None:
        for relay in self._relays.values():
            relay.process.terminate()
        self._stack.close()

    def turn(self, side: str, for_s: float) -> dict[str, Any]:
        """Send messages through one side; return the figures of the turn."""
        self._sink.send(prefix=self._out(side))
        before = self._cpu(side)
        sent = self._source.ask(
            prefix=self._prefix[side], rate_hz=self._cell.rate_hz, for_s=for_s, payload_bytes=self._cell.payload_bytes
        )["sent"]
        arrived = self._sink.ask(sent=sent)
        after = self._cpu(side)
        spent = {thread: cpu - before.get(thread, 0.0) for thread, cpu in after.items()}
        main = self._relays[side].process.pid if side in self._relays else 0
        return {"sent": sent, **arrived, "cpu_s": sum(spent.values()), "main_cpu_s": spent.get(main, 0.0)}

    def _cpu(self, side: str) -> dict[int, float]:
        return cpu_by_thread(self._relays[side].process.pid) if side in self._relays else {}

    def _out(self, side: str) -> str:
        return self._prefix[side] if side == DIRECT else f"/out{self._prefix[side]}"


def measure(cell: Cell, link: SimLink, workdir: Path, trees: Mapping[str, Path], rounds: int) -> dict[str, Tally]:
    bench = Bench(link, cell, workdir, trees)
    sides = [*SIDES, *(side for side in trees if side not in SIDES)]
    tallies = {side: Tally() for side in sides}
    try:
        for side in sides:
            bench.turn(side, 0.5)
        for k in range(rounds):
            first = k % len(sides)
            for side in sides[first:] + sides[:first]:
                found, tally = bench.turn(side, TURN_S), tallies[side]
                tally.sent += found["sent"]
                tally.received += found["received"]
                if found["received"]:
                    tally.cpu_s.append(found["cpu_s"] / found["received"])
                    tally.main_thread_cpu_s.append(found["main_cpu_s"] / found["received"])
                    tally.latency_s.append(found["median_s"])
                    tally.p95_s.append(found["p95_s"])
    finally:
        bench.end()
    return tallies


def ratio(tallies: dict[str, Tally], side: str = ARPD) -> float:
    """Return the CPU per message of an `arpd relay` over that of the bare relay on its better executor."""
    return median(tallies[side].cpu_s) / min(median(tallies[side].cpu_s) for side in (SINGLE, EVENTS))


def table(measured: Sequence[tuple[Cell, dict[str, Tally]]]) -> str:
    relays = (ARPD, SINGLE, EVENTS)
    lines = [
        f"{'':>24}{'CPU us/message':^36}{'':>14}{'added latency ms, median (p95)':^48}{'lost':^18}",
        f"{'bytes':>9}{'topics':>7}{'Hz':>7} "
        + "".join(f"{name:>12}" for name in ("arpd", "bare single", "bare events"))
        + f"{'ratio':>7}{'main':>7}"
        + "".join(f"{name:>16}" for name in ("arpd", "bare single", "bare events"))
        + "".join(f"{name:>7}" for name in ("arpd", "single", "events")),
    ]
    for cell, tallies in measured:
        without = median(tallies[DIRECT].latency_s)
        without_p95 = median(tallies[DIRECT].p95_s)
        found = ratio(tallies)
        share = median(tallies[ARPD].main_thread_cpu_s) / median(tallies[ARPD].cpu_s)
        lines.append(
            f"{cell.payload_bytes:>9}{cell.topics:>7}{cell.rate_hz:>7} "
            + "".join(f"{median(tallies[side].cpu_s) * 1e6:>12.0f}" for side in relays)
            + f"{found:>6.2f}{'!' if found > TARGET else ' '}{share:>7.0%}"
            + "".join(
                f"{(median(tallies[side].latency_s) - without) * 1e3:>8.2f}"
                f"{f'({(median(tallies[side].p95_s) - without_p95) * 1e3:.2f})':>8}"
                for side in relays
            )
            + "".join(f"{tallies[side].sent - tallies[side].received:>7}" for side in relays)
            + (f"  other tree: ratio {ratio(tallies, OTHER):.2f}" if OTHER in tallies else "")
        )
    missed = sum(ratio(tallies) > TARGET for _cell, tallies in measured)
    lines += [
        "",
        f"ratio: arpd relay over the bare relay on its better executor; ! = above {TARGET}",
        "main: share of arpd's CPU in the thread that spins",
        f"{len(measured) - missed} of {len(measured)} cells within {TARGET}",
    ]
    return "\n".join(lines)


def draw(measured: Sequence[tuple[Cell, dict[str, Tally]]], path: Path) -> None:
    with picture(path, figsize=(9, 4.5)) as (_, axes):
        for k, side in enumerate((ARPD, SINGLE, EVENTS)):
            xs = [row + 0.27 * (k - 1) for row in range(len(measured))]
            axes.bar(xs, [median(t[side].cpu_s) * 1e6 for _, t in measured], width=0.26, label=side)
        labels = [f"{c.payload_bytes} B\n{c.topics} topics\n{c.rate_hz} Hz" for c, _ in measured]
        axes.set_xticks(range(len(measured)), labels, fontsize=8)
        axes.set_yscale("log")
        axes.set_ylabel("CPU per message (us)")
        axes.legend()


def main() -> None:
    parser = options_of(__doc__, "relay", quick="two cells, a minute", has_plot=True)
    parser.add_argument("--rounds", type=int, default=4, metavar="N", help="turns of each side per cell (default 4)")
    parser.add_argument("--against", type=Path, metavar="TREE", help="source tree whose relay takes turns too")
    options = parser.parse_args()
    trees = {ARPD: REPO} | ({OTHER: options.against.resolve()} if options.against else {})
    measured: list[tuple[Cell, dict[str, Tally]]] = []
    noted, started_s = conditions(), time.monotonic()
    cells = QUICK if options.quick else DEFAULT
    with (
        SimLink(f"relay-{time.monotonic_ns() % 10**9}") as link,
        tempfile.TemporaryDirectory() as workdir,
        progress("measuring", total=len(cells)) as shown,
    ):
        for cell in cells:
            shown.step(f"{cell.topics} topics of {cell.payload_bytes} bytes")
            measured.append((cell, measure(cell, link, Path(workdir), trees, options.rounds)))
            print(f"{time.monotonic() - started_s:5.0f} s {table(measured[-1:]).splitlines()[2]}", flush=True)
    print(table(measured))
    found = [
        {**asdict(cell), "sides": {side: asdict(tally) for side, tally in tallies.items()}, "ratio": ratio(tallies)}
        for cell, tallies in measured
    ]
    document = {"conditions": noted, "cells": found}
    keep(document, options, "relay", is_partial=options.quick, draw=partial(draw, measured))


if __name__ == "__main__":
    main()
