"""What arpd costs: by number of topics, on a Raspberry Pi, per relayed message, on a link at rest, under HTTP load."""

from __future__ import annotations

import asyncio
import math
import os
import time
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any

from arpd.sim.result import percentile
from scripts.bench.links import MBIT
from scripts.bench.nodes import TOPICS_PER_NODE
from scripts.bench.report import Figure, Summary, figure, table
from scripts.bench.robots import demo_robot
from scripts.bench.samples import Topic
from scripts.bench.sides import SHARED, SIDES, Robot
from scripts.bench.slow import CORES, MEMORY_BYTES, SlowComputer, boards
from scripts.bench.world import World, world_of
from scripts.netns.namespaces import inside

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from scripts.bench.account import Account

    Client = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]

FAST, SLOW = 20 * MBIT, 5 * MBIT
SPAN_S, QUICK_SPAN_S, _SETTLE_S, _REACT_S = 6.0, 3.0, 6.0, 12.0
#: Number of topics → size (bytes) and rate (Hz) of each; twelve are the demo robot's.
SIZES = {50: (2000, 10.0), 100: (1000, 10.0), 500: (800, 2.0), 1000: (800, 1.0)}
#: Most CPU of `arpd run` while everything is carried, by number of topics (% of a core).
MOST_CPU = {12: 4.0, 100: 6.0, 500: 10.0, 1000: 15.0}
DAEMONS = ("run", "peer", "relay", "relay_far")
REST, CARRIED, PACED = PHASES = ("at rest", "all carried", "paced")


def robot_of(topics: int) -> Robot:
    """Return a robot with so many topics."""
    if topics not in SIZES:
        return demo_robot()
    size, rate_hz = SIZES[topics]
    names = (f"/sensor_{k:04d}/data" for k in range(topics))
    return Robot(topics=tuple(Topic(name=name, size=size, rate_hz=rate_hz, node="sensors") for name in names))


def staged(topics: int, span_s: float, **options: Any) -> dict[str, Any]:
    """Measure a robot at rest, with everything carried, then its reaction to 20 → 5 Mbit/s, and paced."""
    with world_of(robot_of(topics), SIDES["two_ends"], rate=FAST, **options) as world, ExitStack() as stack:
        world.start(stack)
        time.sleep(_SETTLE_S)
        steady = [(0.0, FAST, 0.0)]
        rest = world.follow(steady, time.monotonic(), span_s)
        before = _ticks(world)
        times = world.begin(2 * span_s + _REACT_S)
        carried = world.follow(steady, times["from_s"], span_s)
        reaction = _reaction(world)
        paced = world.follow([(0.0, SLOW, 0.0)], time.monotonic(), span_s)
        ticks, late = (now - then for now, then in zip(_ticks(world), before, strict=True))
        world.link.set_rate(FAST)
        account = world.report(times)
    sent, lost = sum(row["published"] for row in account.topics.values()), sum(map(account.lost, account.topics))
    return {
        "topics": topics,
        **reaction,
        "ticks": ticks,
        "late ticks": late,
        "lost %": 100.0 * lost / max(1, sent),
        "latency p50 ms": _middle(account, "p50_ms"),
        "latency p99 ms": _middle(account, "p99_ms"),
        "spans": {REST: rest, CARRIED: carried, PACED: paced},
    }


def _middle(account: Account, key: str) -> float:
    """Return a latency of the topic in the middle (ms)."""
    return median(math.inf if row[key] is None else row[key] for row in account.topics.values())


def _ticks(world: World) -> tuple[int, int]:
    totals = (world.status() or {"totals": {"ticks": 0, "ticks_late": 0}})["totals"]
    return totals["ticks"], totals["ticks_late"]


def _reaction(world: World) -> dict[str, Any]:
    """Let the link fall, and return when budget and plan follow (s), and how many topics are planned."""
    before = world.status()
    began_s = time.monotonic()
    world.link.set_rate(SLOW)
    found: dict[str, Any] = {"planned": 0, "budget s": None, "plan s": None}
    while before and (spent_s := time.monotonic() - began_s) < _REACT_S and None in found.values():
        if status := world.status():
            found["planned"] = sum(topic["planned"] is not None for topic in status["topics"])
            if found["budget s"] is None and status["allocation"]["budget_bytes_per_second"] <= 1.1 * SLOW:
                found["budget s"] = spent_s
            if found["plan s"] is None and status["plan"]["generation"] > before["plan"]["generation"]:
                found["plan s"] = spent_s
        time.sleep(0.05)
    return found


def _reactions(run: dict[str, Any], what: str) -> list[Figure]:
    return [
        figure(f"{what}: budget after 20 → 5 Mbit/s", run["budget s"], "s", most=0.5),
        figure(f"{what}: planned", run["planned"], "topics", least=run["topics"]),
        figure(f"{what}: late ticks", 100.0 * run["late ticks"] / max(1, run["ticks"]), "%", most=1.0),
    ]


def play_topics(*, is_quick: bool, rounds: int = 1) -> Summary:
    """Measure 12 to 1,000 topics."""
    span_s = QUICK_SPAN_S if is_quick else SPAN_S * rounds
    runs = [staged(topics, span_s) for topics in ((12,) if is_quick else (12, 100, 500, 1000))]
    figures, rows = [], []
    for run in runs:
        spans, what = run.pop("spans"), f"{run['topics']} topics"
        for phase in PHASES:
            span = spans[phase]
            mbit = span["to_base_mbit"] + span["to_robot_mbit"]
            cpu = {f"{name} %": 100.0 * span["cpu_s"].get(name, 0.0) / span_s for name in DAEMONS}
            mib = {f"{name} MiB": round(span["max_rss_bytes"].get(name, 0) / 2**20) for name in DAEMONS}
            rows.append({"topics": run["topics"], "": phase, **cpu, **mib, "link Mbit/s": mbit})
        rest, carried, _ = rows[-3:]
        figures += [
            figure(f"{what}: CPU of run, all carried", carried["run %"], "%", most=MOST_CPU[run["topics"]]),
            *([figure(f"{what}: memory of run", carried["run MiB"], "MiB", most=100)] if run["topics"] == 12 else []),
            figure(f"{what}: of the link at rest", 100.0 * rest["link Mbit/s"] * MBIT / FAST, "%", most=1.0),
            *_reactions(run, what),
        ]
    return Summary(
        about="The relay has two ends. CPU in percent of one core, memory in MiB, the link's Mbit/s both ways; it "
        "has 20, in *paced* 5 Mbit/s. Then, after 20 → 5 Mbit/s: topics planned, and when budget and plan follow; then "
        "ticks and samples of the whole run, latency of the topic in the middle.",
        figures=figures,
        tables=[table("", rows), table("", runs)],
    )


def play_pi(*, is_quick: bool, rounds: int = 1) -> Summary:
    """Measure the robot's side on a Raspberry Pi's share of this machine."""
    known, runs, figures = boards(), [], []
    span_s = QUICK_SPAN_S if is_quick else SPAN_S * rounds
    for topics in (12,) if is_quick else (12, 50, 100) if rounds > 1 else (12, 50):
        for board in known[:1] if is_quick else known:
            with SlowComputer(board, f"arpd-pi-{os.getpid()}") as slow:
                run = {"topics": topics, "board": board.name, **staged(topics, span_s, slow=slow.place)}
            spent = run.pop("spans")[CARRIED]["cpu_s"]
            cores = span_s * board.share
            runs.append(run | {f"{name} CPU %": 100.0 * spent[name] / cores for name in ("run", "relay")})
            figures += _reactions(run, f"{topics} topics, {board.name}")
    shares = ", ".join(f"{board.name} {board.share:.2f}" for board in known)
    return Summary(
        about="Each thread of the robot's side has a quota that makes a core of this machine as slow as one of the "
        f"board ({shares}), all threads have {CORES} such cores and {MEMORY_BYTES / 2**20:.0f} MiB. CPU while all is "
        "carried, of one core of the board. Latency from the source to the base, of the topic in "
        "the middle, half of the time at 5 Mbit/s.",
        figures=figures,
        tables=[table("", runs)],
    )


#: Payload (bytes), number of topics, and a rate over all of them that the slowest side carries (Hz).
RELAYED = ((100, 12, 400), (10_000, 12, 300), (1_000_000, 1, 8), (100, 1, 400), (100, 100, 200), (100_000, 12, 60))
_GIGABIT = 1000 * MBIT


def _relayed(size: int, topics: int, rate_hz: float, side: str, seconds: float) -> tuple[float, str, float, int]:
    """Return CPU per message (us), of two ends also in words, latency (ms), and samples lost."""
    about: dict[str, Any] = {"size": size, "rate_hz": rate_hz / topics, "node": "source"}
    robot = Robot(topics=tuple(Topic(name=f"/relayed_{k}", **about) for k in range(topics)))
    # With the discovery range LOCALHOST rmw_fastrtps adds shared memory by itself, so the other sides have it too.
    memory = {**SHARED, **SIDES[side].transports}
    way = replace(SIDES[side], transports=memory, is_governed=False, warm_up_s=3.0)
    with world_of(robot, way, rate=_GIGABIT, queue_bytes=16_000_000) as world:
        account, spent = world.play([(0.0, _GIGABIT, 0.0)], seconds)
    published, delivered = (sum(row[key] for row in account.topics.values()) for key in ("published", "delivered"))
    near, far = (1e6 * spent["cpu_s"].get(name, 0.0) / max(1, delivered) for name in ("relay", "relay_far"))
    return near + far, f"{near:,.0f} + {far:,.0f}", _middle(account, "p50_ms"), published - delivered


def play_relay(*, is_quick: bool, rounds: int = 1) -> Summary:
    """Send the same messages without a relay, through ten lines of rclpy, and through arpd's."""
    rows, figures = [], []
    for size, topics, rate_hz in RELAYED[: 1 if is_quick else 3 * rounds]:
        sides = ("plain", "bare", "one_end", "two_ends")
        plain, bare, one, two = (_relayed(size, topics, rate_hz, side, 3.0 if is_quick else 6.0) for side in sides)
        cpu = {"CPU, bare relay": bare[0], "one end": one[0], "two ends": two[1]}
        added = {
            f"latency, {name}": found[2] - plain[2]
            for name, found in (("bare relay", bare), ("one end", one), ("two ends", two))
        }
        lost = plain[3] + bare[3] + one[3] + two[3]
        rows.append({"bytes": size, "topics": topics, "Hz": rate_hz, **cpu, **added, "lost": lost})
        what = f"{size:,} B, {topics} topics: CPU of one end over that of a bare relay"
        figures.append(figure(what, one[0] / max(1e-9, bare[0]), "×", most=1.1))
    return Summary(
        about="CPU in µs per message, of two ends robot + base; latency in ms (p50) beyond that of no relay. The link "
        "carries 1 Gbit/s. CPU contains what a relay spends at rest.",
        figures=figures,
        tables=[table("", rows)],
    )


_PER_PROCESS = 25  # nodes of the crowd share a process to save memory


def _rested(nodes: int, side: str, *, is_quick: bool) -> dict[str, Any]:
    with world_of(Robot(topics=()), SIDES[side], rate=FAST) as world, ExitStack() as stack:
        world.start(stack)
        time.sleep(5.0 if world.daemons else 0.0)
        far = world.child(stack, "base", "crowd", "1000", "0")
        far.receive()
        began_s, before = time.monotonic(), _sent(world)
        firsts = range(0, nodes, _PER_PROCESS)
        for child in [world.child(stack, "robot", "crowd", str(k), str(min(_PER_PROCESS, nodes - k))) for k in firsts]:
            child.receive(240.0)
        while (
            known := far.ask(do="topics")["topics"]
        ) < TOPICS_PER_NODE * nodes and time.monotonic() - began_s < 240.0:
            time.sleep(0.2)
        known_s = time.monotonic() - began_s
        time.sleep(10.0 if is_quick else 25.0)
        joined, since_s = _sent(world), time.monotonic()
        time.sleep(6.0 if is_quick else 15.0)
        after, spent_s = _sent(world), time.monotonic() - since_s
        return {
            "nodes": nodes,
            "side": side.replace("_", " "),
            "packets/s": (after[1] - joined[1]) / spent_s,
            "kB/s": (after[0] - joined[0]) / spent_s / 1e3,
            "MB until at rest": (joined[0] - before[0]) / 1e6,
            "topics known": known,
            "after s": known_s,
        }


def _sent(world: World) -> tuple[int, int]:
    """Return the bytes and the packets that both ends of the link have sent."""
    counted = world.link.counters().values()
    return sum(each.tx_bytes for each in counted), sum(each.tx_packets for each in counted)


def play_rest(*, is_quick: bool, rounds: int = 1) -> Summary:
    """Measure a link on which nobody publishes, by number of the robot's nodes."""
    sizes = (10, 50, 100)[: 1 if is_quick else 2 if rounds == 1 else 3]
    rows = [_rested(nodes, side, is_quick=is_quick) for nodes in sizes for side in ("plain", "two_ends")]
    shares = {row["nodes"]: 100.0 * row["kB/s"] * 1e3 / FAST for row in rows if row["side"] == "two ends"}
    return Summary(
        about="Both directions together, with Ethernet headers, on a link of 20 Mbit/s where nobody publishes, "
        "25 s after the far host's node knows all topics.",
        figures=[
            figure(f"{n} nodes: of the link at rest with two ends", share, "%", most=1.0) for n, share in shares.items()
        ],
        tables=[table("", rows)],
    )


async def _scrape(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    writer.write(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\nAccept-Encoding: gzip\r\nConnection: close\r\n\r\n")
    if not (await reader.read()).startswith(b"HTTP/1.1 200"):
        raise OSError("no metrics")


async def _idle(reader: asyncio.StreamReader, _writer: asyncio.StreamWriter) -> None:
    await reader.read()


#: Client, how many, and how long after the end of its connection each returns (s).
LOADS: dict[str, tuple[Client, int, float]] = {
    "one scraper": (_idle, 0, 0.0),
    "four more scrapers": (_scrape, 4, 0.5),
    "1,000 idle connections": (_idle, 1000, 5.0),
}
_BESIDE = ("127.0.0.2", 0)  # the server closes connections of the address that has most, not the scraper's


async def _connect(client: Client, source: tuple[str, int] | None = None) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", 9464, local_addr=source)
    try:
        await client(reader, writer)
    finally:
        writer.close()


async def _loaded(client: Client, clients: int, again_s: float, for_s: float) -> tuple[list[float], int]:
    """Scrape four times a second beside clients that return when their connection has ended."""

    async def again_and_again() -> None:
        while True:
            with suppress(OSError):
                await _connect(client, _BESIDE)
            await asyncio.sleep(again_s)

    beside = [asyncio.create_task(again_and_again()) for _ in range(clients)]
    spent_ms, failed, end_s = list[float](), 0, time.monotonic() + for_s
    while (began_s := time.monotonic()) < end_s:
        try:
            async with asyncio.timeout(10.0):
                await _connect(_scrape)
            spent_ms.append(1e3 * (time.monotonic() - began_s))
        except OSError:
            failed += 1
        await asyncio.sleep(max(0.0, began_s + 0.25 - time.monotonic()))
    for task in beside:
        task.cancel()
    return spent_ms, failed


def play_http(*, is_quick: bool, rounds: int = 1) -> Summary:
    """Load the HTTP server of a daemon with many topics, and count its late ticks."""
    topics, for_s = (12, 4.0) if is_quick else (500, 15.0 * rounds)
    rows, figures = [], []
    with world_of(robot_of(topics), SIDES["two_ends"], rate=FAST) as world, ExitStack() as stack:
        world.start(stack)
        world.begin(30.0 + for_s * len(LOADS))
        time.sleep(_SETTLE_S + SIDES["two_ends"].warm_up_s)
        for name, load in LOADS.items():
            before = _ticks(world)
            spent_ms, failed = inside(world.link.robot.namespace, partial(asyncio.run, _loaded(*load, for_s)))
            ticks, late = (now - then for now, then in zip(_ticks(world), before, strict=True))
            counted = {"load": name, "ticks": ticks, "late": late, "scrapes": len(spent_ms), "failed": failed}
            p50, p99 = percentile(spent_ms, 0.5), percentile(spent_ms, 0.99)
            rows.append({**counted, "ms, median": p50, "p99": p99})
            figures += [
                figure(f"{name}: late ticks", late, most=0),
                figure(f"{name}: `/metrics`, p99", p99, "ms", most=1000.0),
                figure(f"{name}: scrapes that failed", failed, most=0),
            ]
    return Summary(
        about=f"`arpd run` with {topics} topics. One scraper asks for /metrics four times a second beside "
        "each load, which comes from another address; idle clients return 5 s after they were closed.",
        figures=figures,
        tables=[table("", rows)],
    )
