"""The soak of `swap.py`: twelve topics are swapped without a pause, and both processes are watched."""

from __future__ import annotations

import queue
import sys
import time
from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from arpd.cli.progress import progress
from scripts.bench.child import Child, answer, commands, footprint, number_of, sample_of
from scripts.bench.node import becomes_true, plain_node, raw_readers, taken
from scripts.bench.report import Target, paragraphs, targets

if TYPE_CHECKING:
    from scripts.netns.simlink import SimLink

TOPICS = [f"/soak/t{k}" for k in range(12)]
RATE_HZ = 20.0
DEPTH = 20
PAYLOAD_BYTES = 100
EVERY = 100  # swaps between two notes
SETTLED = 500  # swaps after which nothing should grow
_RSS_TARGET_MIB = 2.0
_DRAIN_S = 6.0  # the last old writer drains for 4 s at most
_POLL_S = 0.005


def soak(link: SimLink, minutes: float) -> dict[str, Any]:
    """Swap for so long; note memory, threads and open files of writer and reader every hundred swaps."""
    notes: list[dict[str, Any]] = []
    reader = Child(link, "ceddp", "scripts.bench.swap_soak", "reader")
    writer = Child(link, "robot", "scripts.bench.swap_soak", "writer")
    reader.receive()
    writer.send(seconds=60.0 * minutes)
    started_s = time.monotonic()
    report: dict[str, Any] = {}
    with progress("swapping", total=60.0 * minutes) as shown:
        while "done" not in report:
            report = writer.receive(timeout_s=60.0)
            elapsed_s = time.monotonic() - started_s
            shown.reach(min(elapsed_s, 60.0 * minutes), f"{report['swaps']} swaps")
            notes.append(
                {
                    "elapsed_s": elapsed_s,
                    "swaps": report["swaps"],
                    "results": report["results"],
                    "writer": footprint(writer.process.pid),
                    "reader": footprint(reader.process.pid),
                }
            )
    time.sleep(1.0)
    counted = reader.ask(tell=True)
    for child in (writer, reader):
        child.end()
    return {"notes": notes, "sent": report["sent"], **counted}


def soak_report(document: dict[str, Any]) -> str:
    """Return what was lost, and what grew after the first swaps, which should be next to nothing."""
    settled, last = _ends(document)
    judged = [
        Target("samples lost", lost(document), 0),
        Target("samples doubled or out of order", sum(document["late"]), 0),
    ]
    for name, grown in grown_by_process(document).items():
        judged += [
            Target(f"growth of the {name} (MiB)", grown["rss_bytes"] / 2**20, _RSS_TARGET_MIB, "{:.1f}"),
            Target(f"more threads of the {name}", grown["threads"], 0),
            Target(f"more open files of the {name}", grown["files"], 0),
        ]
    return paragraphs(
        f"Without a pause: {last['swaps']:,} swaps in {last['elapsed_s']:.0f} s on {len(document['received'])} topics, "
        f"{document['sent'] * len(document['received']):,} samples; growth from swap {settled['swaps']} on.",
        targets(judged),
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


def write() -> None:
    """Publish all topics at their rate, and swap each as soon as its last swap has ended; answer every EVERY swaps."""
    from arpd.apply.endpoint.writer_swap import SwapTiming
    from scripts.bench.swap_nodes import Adaptive

    node = plain_node("soak_writer")
    # This link loses nothing; 3 s to settle would only make the same swaps last longer.
    timing = SwapTiming(settle_s=0.1)
    sides = [Adaptive(node, topic, DEPTH, timing) for topic in TOPICS]
    orders = commands()
    order = orders.get()
    assert order is not None
    becomes_true(lambda: all(side.matched() for side in sides), 20.0)
    time.sleep(0.5)
    asked, sent, reported = [0] * len(sides), 0, 0
    due_s = time.monotonic()
    until_s = due_s + order["seconds"]

    def results() -> dict[str, int]:
        return sum((Counter(side.results()) for side in sides), Counter())

    while (now_s := time.monotonic()) < until_s + _DRAIN_S:
        if now_s >= due_s:
            for side in sides:
                side.publish(sample_of(sent, PAYLOAD_BYTES))
            sent += 1
            due_s += 1.0 / RATE_HZ
        for k, side in enumerate(sides):
            if now_s < until_s and side.ended() >= asked[k]:
                asked[k] += 1
                side.swap(DEPTH + asked[k] % 2)
        if sum(asked) >= reported + EVERY:
            reported = sum(asked)
            answer(swaps=reported, results=results())
        time.sleep(_POLL_S)
    answer(done=True, swaps=sum(asked), sent=sent, results=results())
    orders.get()


def read() -> None:
    """Count arrivals on every topic; a sample that is not newer than all before it is out of order or doubled."""
    subscriptions = raw_readers(plain_node("soak_reader"), TOPICS, 1000)
    received, highest, late = ([first] * len(TOPICS) for first in (0, -1, 0))
    orders = commands()
    answer(open=True)
    while True:
        for k, subscription in enumerate(subscriptions):
            for sample, _ in taken(subscription):
                number = number_of(sample)
                received[k] += 1
                late[k] += number <= highest[k]
                highest[k] = max(highest[k], number)
        with suppress(queue.Empty):
            if orders.get(timeout=_POLL_S) is None:
                return
            answer(received=received, late=late)


if __name__ == "__main__":
    {"writer": write, "reader": read}[sys.argv[1]]()
