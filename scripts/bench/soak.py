"""Swap QoS thousands of times on the simulated link: what grows, and whether a subscriber is lost.

Usage: .venv/bin/python scripts/bench/soak.py [--quick] [--swaps N] [--seconds S] [--json FILE] [--plot FILE]

Needs root, as the simulated link does.

One node on the robot publishes 12 topics through AdaptivePublishers. A parameter sets a topic's depth as soon as its
last swap has ended. One process on the other host reads all topics. Every hundred swaps the parent notes memory,
threads and open files of both, and compares them with those after the first 500.
"""

from __future__ import annotations

import argparse
import queue
import sys
import threading
import time
from collections import Counter
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from scripts.bench.child import Child, ChildError, answer, commands, number_of, sample_of
from scripts.bench.node import becomes_true, plain_node, raw_readers, taken
from scripts.bench.picture import picture
from scripts.bench.record import conditions, keep, options_of
from scripts.bench.soak_report import verdict
from scripts.netns.simlink import SimLink

if TYPE_CHECKING:
    from collections.abc import Sequence

TOPICS = 12
RATE_HZ = 20.0
DEPTH = 20
PAYLOAD_BYTES = 100
EVERY = 100
COUNT, QUICK_COUNT = 10_000, 300
STUCK_S = 20.0
_POLL_S = 0.005


def topic_name(k: int) -> str:
    return f"/soak/t{k}"


class Writers:
    """The 12 publishers, and the changes of their settings."""

    def __init__(self) -> None:
        from std_msgs.msg import String

        from arpd import AdaptivePublisher
        from arpd.adapters.ros.names import DEPTH as DEPTH_SETTING
        from arpd.adapters.ros.names import parameter_name
        from arpd.apply.endpoint.writer_swap import SwapTiming

        self.node = plain_node("soak_writer")
        # This link loses nothing; 3 s to settle would only make the same swaps last longer.
        timing = SwapTiming(settle_s=0.1)
        self.publishers = [
            AdaptivePublisher(self.node, String, topic_name(k), DEPTH, swap_timing=timing) for k in range(TOPICS)
        ]
        self._names = [parameter_name(topic_name(k), DEPTH_SETTING) for k in range(TOPICS)]
        self._asked = [0] * TOPICS
        self._asked_s = [0.0] * TOPICS
        self.sent = 0
        self.is_publishing = True

    def publish(self) -> None:
        """Publish every topic at its rate while ``is_publishing``."""
        due_s = time.monotonic()
        while self.is_publishing:
            for publisher in self.publishers:
                publisher.publish(sample_of(self.sent, PAYLOAD_BYTES))
            self.sent += 1
            due_s += 1.0 / RATE_HZ
            time.sleep(max(0.0, due_s - time.monotonic()))

    def results(self) -> dict[str, int]:
        total = Counter[str]()
        for publisher in self.publishers:
            total.update(publisher.state(generation=0).swaps_by_result)
        return total

    def ask(self, most: int) -> int:
        """Set the depth of topics whose last swap has ended; return the number of swaps asked for so far."""
        from rclpy.parameter import Parameter

        now_s = time.monotonic()
        for k, publisher in enumerate(self.publishers):
            swaps = publisher.state(generation=0).swaps_by_result
            ended = sum(count for key, count in swaps.items() if key != "undelivered")
            is_stuck = now_s - self._asked_s[k] > STUCK_S
            if (ended >= self._asked[k] or is_stuck) and sum(self._asked) < most:
                self._asked[k] = max(ended, self._asked[k]) + 1
                self._asked_s[k] = now_s
                depth = DEPTH + self._asked[k] % 2
                result = self.node.set_parameters_atomically([Parameter(self._names[k], value=depth)])
                assert result.successful, result.reason
        return sum(self._asked)


def write(most: int) -> None:
    """Swap ``most`` times; report to the parent every hundred."""
    from arpd.adapters.ros.runtime import best_executor, spinning

    writers = Writers()
    orders = commands()
    becomes_true(lambda: all(p.get_subscription_count() >= 1 for p in writers.publishers), 20.0)
    time.sleep(0.5)
    executor = best_executor()
    executor.add_node(writers.node)
    with spinning(executor):
        thread = threading.Thread(target=writers.publish)
        thread.start()
        reported = 0
        is_over = False
        while not is_over:
            is_over = (asked := writers.ask(most)) >= most
            if asked >= reported + EVERY or is_over:
                reported = asked
                answer(swaps=asked, results=writers.results())
            with suppress(queue.Empty):
                orders.get(timeout=_POLL_S)
                is_over = True
        time.sleep(6.0)  # the last old writer drains for 4 s at most
        writers.is_publishing = False
        thread.join()
        answer(done=True, swaps=asked, sent=writers.sent, results=writers.results())
        orders.get()


def read() -> None:
    """Count arrivals on every topic; a sample that is not newer than all before it is out of order or doubled."""
    subscriptions = raw_readers(plain_node("soak_reader"), [topic_name(k) for k in range(TOPICS)], 1000)
    received, highest, late = [0] * TOPICS, [-1] * TOPICS, [0] * TOPICS
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
            answer(
                received=received, highest=highest, late=late, writers=[s.get_publisher_count() for s in subscriptions]
            )


def footprint(pid: int) -> dict[str, int]:
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines())
    return {
        "rss_bytes": int(status["VmRSS"].split()[0]) * 1024,
        "threads": int(status["Threads"]),
        "files": len(list(Path(f"/proc/{pid}/fd").iterdir())),
    }


def soak(swaps: int, seconds: float) -> dict[str, Any]:
    """Run the swaps, and return the notes."""
    notes: list[dict[str, Any]] = []
    with SimLink(f"soak-{time.monotonic_ns() % 10**9}") as link, progress("swapping", total=swaps) as shown:
        reader = Child(link, "ceddp", "scripts.bench.soak", "--role", "reader")
        reader.receive()
        writer = Child(link, "robot", "scripts.bench.soak", "--role", "writer", "--swaps", str(swaps))
        started_s = time.monotonic()
        is_stopped = False
        report: dict[str, Any] = {}
        while "done" not in report:
            report = writer.receive(timeout_s=STUCK_S + 40.0)
            elapsed_s = time.monotonic() - started_s
            note = {
                "elapsed_s": elapsed_s,
                "swaps": report["swaps"],
                "results": report["results"],
                "writer": footprint(writer.process.pid),
                "reader": footprint(reader.process.pid),
                **reader.ask(tell=True),
            }
            notes.append(note)
            shown.reach(report["swaps"], f"{report['swaps']} of {swaps}")
            if len(notes) % 5 == 1 or "done" in report:
                print(row(note), flush=True)
            if elapsed_s > seconds and not is_stopped:
                writer.send(stop=True)
                is_stopped = True
        writer.send(end=True)
        time.sleep(1.0)
        last = reader.ask(tell=True)
        for child in (writer, reader):
            child.end()
    return {"notes": notes, "sent": report["sent"], **last}


def row(note: dict[str, Any]) -> str:
    writer, reader = note["writer"], note["reader"]
    return (
        f"{note['elapsed_s']:>7.0f}{note['swaps']:>8}"
        f"{writer['rss_bytes'] / 2**20:>9.2f}{writer['threads']:>5}{writer['files']:>5}"
        f"{reader['rss_bytes'] / 2**20:>9.2f}{reader['threads']:>5}{reader['files']:>5}"
        f"{min(note['received']):>10}{sum(note['late']):>6}  "
        + " ".join(f"{count} {key}" for key, count in sorted(note["results"].items()))
    )


def draw(notes: Sequence[dict[str, Any]], path: Path) -> None:
    swaps = [note["swaps"] for note in notes]
    with picture(path, figsize=(8, 4)) as (_, axes):
        for name in ("writer", "reader"):
            axes.plot(swaps, [note[name]["rss_bytes"] / 2**20 for note in notes], label=name)
        axes.set(xlabel="swaps", ylabel="resident memory (MiB)")
        axes.grid(visible=True, alpha=0.3)
        axes.legend()


def main() -> None:
    parser = options_of(__doc__, "soak", quick=f"{QUICK_COUNT} swaps, some ten seconds", has_plot=True)
    parser.add_argument("--swaps", type=int, default=COUNT, metavar="N", help="default %(default)s")
    parser.add_argument("--seconds", type=float, default=3600.0, metavar="S", help="stop earlier, after this time")
    parser.add_argument("--role", choices=("writer", "reader"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.role == "writer":
        write(options.swaps)
    elif options.role == "reader":
        read()
    else:
        print(f"{'':>15}{'writer':^19}{'reader':^19}")
        print(f"{'s':>7}{'swaps':>8}" + 2 * f"{'MiB':>9}{'thr':>5}{'fds':>5}" + f"{'received':>10}{'late':>6}  swaps")
        noted = conditions()
        try:
            document = soak(QUICK_COUNT if options.quick else options.swaps, options.seconds)
        except ChildError as error:
            sys.exit(f"soak: {error}")
        print("\n".join(["", *verdict(document)]))
        document = {"conditions": noted, **document}
        keep(document, options, "soak", is_partial=options.quick, draw=partial(draw, document["notes"]))
        if not min(document["received"]):
            sys.exit("soak: nothing arrived on some topic")


if __name__ == "__main__":
    main()
