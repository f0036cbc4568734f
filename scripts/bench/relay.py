"""Compare `arpd relay`, with one end and with two, with a bare rclpy relay of ten lines: CPU per message, and latency.

Usage: .venv/bin/python scripts/bench/relay.py [--quick] [--against TREE] [--json FILE] [--plot FILE]

Needs root, as the simulated link does.

One source on the robot and one sink on the CEDDP, and between them at the same time: `arpd relay` with one end, with
two ends, a bare relay, and nothing. They take short turns with the same messages, in rotating order, so that other load
on the machine slows all of them. Two ends have ROS domains of their own, and a source and a sink that stay on their
hosts. CPU is the scheduler's account of all threads of the relay's processes, divided by the messages that came out; it
contains what the relay spends at rest in that time. Latency is from just before `publish` in the source to reception by
DDS in the sink, less the latency without a relay. Within a host Fast DDS uses shared memory; source and sink have its
defaults, and relays have arpd's profile. Only ratios within one run mean anything; --against compares both relays of
another source tree, which then take turns too.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import count
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.adapters.ros.runtime import TWO_ENDED_PROFILE
from arpd.cli.progress import progress
from scripts.bench.child import Child
from scripts.bench.picture import picture
from scripts.bench.record import REPO, conditions, keep, options_of
from scripts.bench.report import about, paragraphs, table
from scripts.netns.simlink import SimLink

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from scripts.netns.namespaces import HostName

DIRECT = "direct"
BARE, ONE_END, TWO_ENDS = "bare relay", "one end", "two ends"
OTHER_ONE, OTHER_TWO = "other tree, one end", "other tree, two ends"
_PREFIXES = {
    ONE_END: "/ours",
    BARE: "/bare",
    DIRECT: "/none",
    TWO_ENDS: "/both",
    OTHER_ONE: "/other",
    OTHER_TWO: "/others",
}
TARGET = 1.1  # CPU per message of one end over that of the bare relay
_TURN_S = 1.5
_WARM_UP_S = 0.5
_RATE_BYTES_PER_SECOND = 125e6  # 1 Gbit/s
_QUEUE_BYTES = 16_000_000  # the link drops nothing
_OPEN_DOMAIN = 1  # of the nodes that see each other across the link; each relay with two ends takes the next two
# With the discovery range LOCALHOST rmw_fastrtps adds shared memory by itself, so the other sides have it too.
_TRANSPORT = {"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}
_NODES = "scripts.bench.relay_nodes"


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """Payload and number of topics, with a rate over all of them that the slowest side carries."""

    payload_bytes: int
    topics: int
    rate_hz: int


DEFAULT = (
    Cell(payload_bytes=100, topics=1, rate_hz=400),
    Cell(payload_bytes=100, topics=12, rate_hz=400),
    Cell(payload_bytes=100, topics=100, rate_hz=200),
    Cell(payload_bytes=1000, topics=1, rate_hz=400),
    Cell(payload_bytes=1000, topics=12, rate_hz=400),
    Cell(payload_bytes=10_000, topics=1, rate_hz=300),
    Cell(payload_bytes=10_000, topics=12, rate_hz=300),
    Cell(payload_bytes=100_000, topics=1, rate_hz=60),
    Cell(payload_bytes=100_000, topics=12, rate_hz=60),
    Cell(payload_bytes=1_000_000, topics=1, rate_hz=8),
    Cell(payload_bytes=1_000_000, topics=12, rate_hz=8),
)
QUICK = (DEFAULT[1], DEFAULT[6])


@dataclass(slots=True)
class Tally:
    """The figures of one side in one cell, turn by turn."""

    sent: int = 0
    received: int = 0
    cpu_s: list[list[float]] = field(default_factory=list)  # per message, of each process of the relay
    latency_s: list[float] = field(default_factory=list)
    p95_s: list[float] = field(default_factory=list)
    rest: list[float] = field(default_factory=list)  # CPU seconds per second in the turns of the others


def cpu_by_thread(pid: int) -> dict[int, float]:
    """Return the CPU time of every thread of a process, by the scheduler's account (s)."""
    spent = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        try:
            spent[int(task.name)] = int((task / "schedstat").read_text(encoding="utf-8").split()[0]) * 1e-9
        except OSError:
            continue
    return spent


@dataclass(frozen=True, kw_only=True, slots=True)
class Way:
    """One side as it runs: source, sink, and the processes of its relay, the robot's first."""

    source: Child
    sink: Child
    relay: tuple[Child, ...] = ()

    def cpu(self) -> list[dict[int, float]]:
        """Return the CPU time of the relay's processes, by thread (s)."""
        return [cpu_by_thread(each.process.pid) for each in self.relay]


def spent_s(before: Sequence[Mapping[int, float]], after: Sequence[Mapping[int, float]]) -> list[float]:
    """Return the CPU time that each process took meanwhile; a thread that has ended meanwhile does not count (s)."""
    return [
        sum(cpu_s - then.get(thread, 0.0) for thread, cpu_s in now.items())
        for then, now in zip(before, after, strict=True)
    ]


class Bench:
    """All processes of one cell.

    Parameters
    ----------
    workdir : folder for the relays' configuration
    trees : source trees with the relays to measure, by their sides with one end and with two
    """

    def __init__(self, link: SimLink, cell: Cell, workdir: Path, trees: Mapping[tuple[str, str], Path]) -> None:
        self._link = link
        self._cell = cell
        self._workdir = workdir
        self._stack = ExitStack()
        self._relays: list[Child] = []
        self._domains = count(_OPEN_DOMAIN)
        try:
            self.ways = self._start(trees)
            self._match()
        except BaseException:
            self.end()
            raise

    def end(self) -> None:
        """End every process."""
        for relay in self._relays:
            relay.process.terminate()  # it does not end with its input
        self._stack.close()

    def turn(self, side: str, for_s: float) -> dict[str, Any]:
        """Send messages through one side; return the figures of the turn, and what the others spend at rest."""
        way = self.ways[side]
        way.sink.send(prefix=self._out(side), since_ns=time.time_ns())
        before = {each: way.cpu() for each, way in self.ways.items()}
        began_s = time.monotonic()
        sent = way.source.ask(
            prefix=_PREFIXES[side], rate_hz=self._cell.rate_hz, for_s=for_s, payload_bytes=self._cell.payload_bytes
        )["sent"]
        arrived = way.sink.ask(sent=sent)
        took_s = time.monotonic() - began_s
        spent = {each: spent_s(before[each], way.cpu()) for each, way in self.ways.items()}
        rest = {each: sum(cpu_s) / took_s for each, cpu_s in spent.items() if each != side}
        return {"sent": sent, **arrived, "cpu_s": spent[side], "rest": rest}

    def _start(self, trees: Mapping[tuple[str, str], Path]) -> dict[str, Way]:
        open_domain = {"ROS_DOMAIN_ID": str(next(self._domains))}
        around = self._around(open_domain)
        topics = self._cell.topics
        ways = {DIRECT: around}
        bare = self._child("robot", _NODES, "bare", _PREFIXES[BARE], str(topics), environment=open_domain)
        self._relays.append(bare)
        ways[BARE] = Way(source=around.source, sink=around.sink, relay=(bare,))
        for (one, two), tree in trees.items():
            names = [{"name": f"{_PREFIXES[one]}/t{k}"} for k in range(topics)]
            config = self._config(one, {"prefix": "/out", "topics": names})
            near = self._relay(tree, one, config, open_domain)
            ways[one] = Way(source=around.source, sink=around.sink, relay=(near,))
            ways[two] = self._two_ends(tree, two)
        return ways

    def _two_ends(self, tree: Path, side: str) -> Way:
        domain, link_domain = next(self._domains), next(self._domains)
        config = self._config(
            side,
            {
                "link_domain": link_domain,
                "robot": self._link.robot.address,
                "ceddp": self._link.ceddp.address,
                "to_ceddp": [f"{_PREFIXES[side]}/*"],
                "to_robot": [],
            },
        )
        environment = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        profile = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(tree / TWO_ENDED_PROFILE.relative_to(REPO))}
        near = self._relay(tree, side, config, {**environment, **profile})
        far = self._relay(tree, side, config, {**environment, **profile}, is_far=True)
        around = self._around(environment)
        return Way(source=around.source, sink=around.sink, relay=(near, far))

    def _around(self, environment: dict[str, str]) -> Way:
        plain = {**environment, "FASTRTPS_DEFAULT_PROFILES_FILE": ""}
        return Way(
            source=self._child("robot", _NODES, "source", environment=plain),
            sink=self._child("ceddp", _NODES, "sink", environment=plain),
        )

    def _relay(
        self, tree: Path, side: str, config: Path, environment: dict[str, str], *, is_far: bool = False
    ) -> Child:
        argv = ["arpd.cli", "relay", "--config", str(config), "--node-name", _PREFIXES[side].strip("/")]
        # Without the safe path, `-m` would take the arpd of the working directory.
        own = {"PYTHONPATH": str(tree), "PYTHONSAFEPATH": "1"}
        host: HostName = "ceddp" if is_far else "robot"
        argv += ["--log-level", "warning", *(["--far"] if is_far else [])]
        child = self._child(host, *argv, environment={**environment, **own})
        self._relays.append(child)
        return child

    def _child(self, host: HostName, *argv: str, environment: dict[str, str]) -> Child:
        child = Child(self._link, host, *argv, environment={**_TRANSPORT, **environment})
        self._stack.callback(child.end)
        return child

    def _config(self, side: str, relay: dict[str, Any]) -> Path:
        config = self._workdir / f"{_PREFIXES[side].strip('/')}-{self._cell.payload_bytes}-{self._cell.topics}.yaml"
        config.write_text(json.dumps({"relay": relay}))  # JSON is YAML
        return config

    def _match(self) -> None:
        """Let every source and sink open its endpoints, and wait until each has found its counterpart."""
        pairs: dict[tuple[Child, Child], list[str]] = {}
        for side, way in self.ways.items():
            pairs.setdefault((way.source, way.sink), []).append(side)
        for (source, sink), sides in pairs.items():
            sink.ask(open=[self._out(side) for side in sides], topics=self._cell.topics)
            source.send(open=[_PREFIXES[side] for side in sides], topics=self._cell.topics)
        for (source, sink), sides in pairs.items():
            if not (source.receive()["matched"] and sink.ask(match=True)["matched"]):
                raise SystemExit(f"{self._cell}: not every topic of {', '.join(sides)} was found")

    @staticmethod
    def _out(side: str) -> str:
        """Return the prefix of the topics as the sink reads them."""
        return f"/out{_PREFIXES[side]}" if side in {ONE_END, BARE, OTHER_ONE} else _PREFIXES[side]


def measure(
    cell: Cell, link: SimLink, workdir: Path, trees: Mapping[tuple[str, str], Path], rounds: int
) -> dict[str, Tally]:
    """Return the figures of every side in one cell."""
    bench = Bench(link, cell, workdir, trees)
    sides = list(bench.ways)
    tallies = {side: Tally() for side in sides}
    try:
        for side in sides:
            bench.turn(side, _WARM_UP_S)
        for k in range(rounds):
            first = k % len(sides)
            for side in sides[first:] + sides[:first]:
                found, tally = bench.turn(side, _TURN_S), tallies[side]
                tally.sent += found["sent"]
                tally.received += found["received"]
                for other, share in found["rest"].items():
                    tallies[other].rest.append(share)
                if found["received"]:
                    tally.cpu_s.append([cpu_s / found["received"] for cpu_s in found["cpu_s"]])
                    tally.latency_s.append(found["median_s"])
                    tally.p95_s.append(found["p95_s"])
    finally:
        bench.end()
    return tallies


def cpu_us(cell: dict[str, Any], side: str, *, process: int | None = None) -> float:
    """Return the CPU per message of a side's relay, or of one process of it (us)."""
    turns = cell["sides"][side]["cpu_s"]
    return float(1e6 * median(sum(turn) if process is None else turn[process] for turn in turns))


def added_ms(cell: dict[str, Any], side: str, figure: str = "latency_s") -> float:
    """Return the latency that a side adds to no relay: of medians, or with ``p95_s`` of 95th percentiles (ms)."""
    return float(1e3 * (median(cell["sides"][side][figure]) - median(cell["sides"][DIRECT][figure])))


def report(document: dict[str, Any]) -> str:
    cells = document["cells"]
    sides = [side for side in cells[0]["sides"] if side != DIRECT]

    def cost(side: str) -> Callable[[dict[str, Any]], str]:
        return lambda cell: " + ".join(
            f"{cpu_us(cell, side, process=process):.0f}" for process in range(len(cell["sides"][side]["cpu_s"][0]))
        )

    def latency(side: str) -> Callable[[dict[str, Any]], str]:
        return lambda cell: f"{added_ms(cell, side):.2f} ({added_ms(cell, side, 'p95_s'):.2f})"

    def ratio(cell: dict[str, Any]) -> float:
        return cpu_us(cell, ONE_END) / cpu_us(cell, BARE)

    rests = {
        side: median(share for cell in cells for share in cell["sides"][side]["rest"]) for side in (ONE_END, TWO_ENDS)
    }
    return paragraphs(
        about(
            document,
            "CPU in µs per message, of two ends robot + CEDDP; latency in ms beyond that of no relay (p95 in brackets)",
        ),
        f"Target: one end takes at most {TARGET} times the CPU of the bare relay; met in "
        f"{sum(ratio(cell) <= TARGET for cell in cells)} of {len(cells)} rows. At rest, one end takes "
        f"{rests[ONE_END]:.1%} of a core, both {rests[TWO_ENDS]:.1%}.",
        table(
            cells,
            ("bytes", "payload_bytes", "{:,}"),
            ("topics", "topics"),
            ("Hz", "rate_hz"),
            *((f"CPU, {side}", cost(side)) for side in sides),
            ("one end / bare", lambda cell: f"{ratio(cell):.2f}{' ✗' * (ratio(cell) > TARGET)}"),
            *((f"latency, {side}", latency(side)) for side in sides),
            ("lost", lambda cell: sum(each["sent"] - each["received"] for each in cell["sides"].values())),
        ),
        "CPU contains what a relay spends at rest. Relays, the bare one too, write in parts of 1392 bytes, as arpd's "
        "Fast DDS profile says; the source writes in parts of 64 kB.",
    )


def draw(cells: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw the CPU per message of every relay; for two ends, the parts of the robot and of the CEDDP."""
    with picture(path, figsize=(9, 4.5)) as (_, axes):
        for k, side in enumerate((BARE, ONE_END, TWO_ENDS)):
            xs = [number + 0.27 * (k - 1) for number in range(len(cells))]
            total = [cpu_us(cell, side) for cell in cells]
            bars = axes.bar(xs, total, width=0.26, label=side)
            if side == TWO_ENDS:
                near = [cpu_us(cell, side, process=0) for cell in cells]
                color = bars.patches[0].get_facecolor()
                axes.bar(xs, near, width=0.26, color=color, hatch="//", label="of these, the robot's end")
        labels = [f"{c['payload_bytes']} B\n{c['topics']} topics\n{c['rate_hz']} Hz" for c in cells]
        axes.set_xticks(range(len(cells)), labels, fontsize=7)
        axes.set_yscale("log")
        axes.set_ylabel("CPU per message (us)")
        axes.legend()


def main() -> None:
    parser = options_of(__doc__, "relay", quick="two cells, a minute", has_plot=True)
    parser.add_argument("--rounds", type=int, default=4, metavar="N", help="turns of each side per cell (default 4)")
    parser.add_argument("--against", type=Path, metavar="TREE", help="source tree whose relays take turns too")
    options = parser.parse_args()
    trees = {(ONE_END, TWO_ENDS): REPO}
    if options.against:
        trees[OTHER_ONE, OTHER_TWO] = options.against.resolve()
    measured: list[dict[str, Any]] = []
    noted = conditions()
    cells = QUICK if options.quick else DEFAULT
    with (
        SimLink(
            f"relay-{time.monotonic_ns() % 10**9}",
            rate_bytes_per_second=_RATE_BYTES_PER_SECOND,
            queue_bytes=_QUEUE_BYTES,
        ) as link,
        tempfile.TemporaryDirectory() as workdir,
        progress("measuring", total=len(cells)) as shown,
    ):
        for cell in cells:
            shown.step(f"{cell.topics} topics of {cell.payload_bytes} bytes")
            tallies = measure(cell, link, Path(workdir), trees, options.rounds)
            measured.append({**asdict(cell), "sides": {side: asdict(tally) for side, tally in tallies.items()}})
    document = {"conditions": noted, "cells": measured}
    keep(document, options, "relay", is_partial=options.quick, draw=partial(draw, measured))
    print(report(document))


if __name__ == "__main__":
    main()
