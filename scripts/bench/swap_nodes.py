"""The processes of `swap.py`: one writer, and readers that note arrivals.

Usage: python -m scripts.bench.swap_nodes writer|reader
"""

from __future__ import annotations

import itertools
import queue
import sys
import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile
from std_msgs.msg import String

from arpd import AdaptivePublisher
from scripts.bench.child import answer, commands, number_of, sample_of
from scripts.bench.node import becomes_true, plain_node, raw_readers, taken
from scripts.bench.swap import ADAPTIVE, RECREATE, STILL

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.apply.endpoint.writer_swap import SwapTiming

_READ_DEPTH = 5000
_POLL_S = 0.002
_MATCH_TIMEOUT_S = 30.0
_WARM_S = 0.2
_TIMEOUT_S = 8.0
_SETTLE_S = 0.6  # after the last swap, so that its drain is measured with it


class Adaptive:
    """An AdaptivePublisher whose depth changes by a writer swap."""

    def __init__(self, node: Any, topic: str, depth: int, timing: SwapTiming | None = None) -> None:
        self._publisher = AdaptivePublisher(node, String, topic, depth, swap_timing=timing)
        self.publish: Callable[[bytes], None] = self._publisher.publish
        self.matched = self._publisher.get_subscription_count
        self.destroy = self._publisher.destroy

    def swap(self, depth: int) -> None:
        """Change the depth."""
        self._publisher.retune(replace(self._publisher.plan, depth=depth))

    def ended(self) -> int:
        """Return the number of swaps that have ended."""
        swaps = self._publisher.state().swaps_by_result
        return sum(count for key, count in swaps.items() if key != "undelivered")

    def results(self) -> dict[str, int]:
        state = self._publisher.state()
        return {**state.swaps_by_result, **({"withheld": state.withheld} if state.withheld else {})}


class Still(Adaptive):
    """The baseline: an AdaptivePublisher whose settings stay."""

    def swap(self, depth: int) -> None:
        """Do nothing."""

    def ended(self) -> int:
        return sys.maxsize


class Recreate:
    """A node without arpd: it destroys its publisher and creates another one."""

    def __init__(self, node: Any, topic: str, depth: int) -> None:
        self._node, self._topic, self._swaps = node, topic, 0
        self._publisher = node.create_publisher(String, topic, QoSProfile(depth=depth))

    def publish(self, sample: bytes) -> None:
        self._publisher.publish(sample)

    def matched(self) -> int:
        return int(self._publisher.get_subscription_count())

    def swap(self, depth: int) -> None:
        self._node.destroy_publisher(self._publisher)
        self._publisher = self._node.create_publisher(String, self._topic, QoSProfile(depth=depth))
        self._swaps += 1

    def ended(self) -> int:
        return self._swaps

    def results(self) -> dict[str, int]:
        return {"recreated": self._swaps}

    def destroy(self) -> None:
        self._node.destroy_publisher(self._publisher)


Side = Adaptive | Recreate
WAYS: dict[str, Callable[[Any, str, int], Side]] = {STILL: Still, ADAPTIVE: Adaptive, RECREATE: Recreate}


class Stream:
    """Publishes numbered samples at a fixed rate."""

    def __init__(self, side: Side, rate_hz: float, payload_bytes: int) -> None:
        self._side, self._period_s, self._payload_bytes = side, 1.0 / rate_hz, payload_bytes
        self._due_s = time.monotonic()
        self.sent = 0
        self.longest_publish_s = 0.0

    def run(self, for_s: float) -> None:
        """Publish for a while; late samples follow at once."""
        until_s = self._due_s + for_s
        while self._due_s < until_s:
            time.sleep(max(0.0, self._due_s - time.monotonic()))
            before_s = time.monotonic()
            self._side.publish(sample_of(self.sent, self._payload_bytes))
            self.longest_publish_s = max(self.longest_publish_s, time.monotonic() - before_s)
            self.sent += 1
            self._due_s += self._period_s


def turn(node: Any, orders: queue.SimpleQueue[dict[str, Any] | None], order: dict[str, Any]) -> None:
    """Publish without swaps, then with swaps; the parent reads the byte counters at the start of each phase."""
    side = WAYS[order["way"]](node, order["topic"], order["depth"])
    try:
        becomes_true(lambda: side.matched() >= order["readers"], _MATCH_TIMEOUT_S, poll_s=0.01)
        time.sleep(0.2)
        stream = Stream(side, order["rate_hz"], order["payload_bytes"])
        answer(phase="warm")
        while orders.empty():  # until each reader has received a sample: a matched reader may not know the writer yet
            stream.run(_WARM_S)
        orders.get()
        first = stream.sent
        answer(phase="still")
        cpu = [time.process_time()]
        stream.run(order["still_s"])
        answer(phase="swaps")
        cpu.append(time.process_time())
        stream.longest_publish_s = 0.0
        requests = []
        for k in range(order["swaps"]):
            requests.append(stream.sent)
            side.swap(order["depth"] + 1 - k % 2)
            stream.run(order["spacing_s"])
            give_up_s = time.monotonic() + _TIMEOUT_S
            while side.ended() <= k and time.monotonic() < give_up_s:
                stream.run(0.1)
        stream.run(_SETTLE_S)
        cpu.append(time.process_time())
        answer(
            phase="done",
            first=first,
            end=stream.sent,
            cpu_s=cpu,
            requests=requests,
            results=side.results(),
            longest_publish_s=stream.longest_publish_s,
            matched=side.matched(),
        )
        orders.get()  # the readers have received all samples
    finally:
        side.destroy()
    answer(phase="closed")


def write() -> None:
    """Serve turns until the parent is gone."""
    node = plain_node("bench_writer")
    orders = commands()
    while (order := orders.get()) is not None:
        turn(node, orders, order)


class Log:
    """The arrivals on one topic, in the order in which the application gets them."""

    def __init__(self, node: Any, topic: str) -> None:
        self._node = node
        (self._subscription,) = raw_readers(node, [topic], _READ_DEPTH)
        self.numbers: list[int] = []
        self.sequence: list[int] = []  # number of a sample within its writer; 1 marks a new writer
        self.received_ns: list[int] = []  # noted by DDS on reception, even while this process is busy
        self.cpu_s = time.process_time()

    def take(self) -> None:
        """Note all samples that are there."""
        for sample, about in taken(self._subscription):
            self.numbers.append(number_of(sample))
            self.sequence.append(about["publication_sequence_number"])
            self.received_ns.append(about["received_timestamp"])

    def is_complete(self, first: int, end: int) -> bool:
        return len(self.numbers) >= end - first and len({n for n in self.numbers if first <= n < end}) == end - first

    def report(self, first: int, end: int) -> dict[str, Any]:
        """Return the faults among the samples from ``first`` to ``end``."""
        seen: set[int] = set()
        highest, doubled, reordered = -1, [], []
        times = []
        for number, received_ns in zip(self.numbers, self.received_ns, strict=True):
            if not first <= number < end:
                continue
            times.append(received_ns)
            if number in seen:
                doubled.append(number)
                continue
            seen.add(number)
            if number < highest:
                reordered.append(number)
            highest = max(highest, number)
        lost = [number for number in range(first, end) if number not in seen]
        times.sort()
        gaps = [after - before for before, after in itertools.pairwise(times)]
        switches = [self.numbers[k] for k in range(1, len(self.numbers)) if self.sequence[k] == 1]
        return {
            "received": len(seen),
            "lost": lost,
            "doubled": doubled,
            "reordered": reordered,
            "gap_s": max(gaps, default=0) * 1e-9,
            "switches": switches,
            "cpu_s": time.process_time() - self.cpu_s,
        }

    def close(self) -> None:
        self._node.destroy_subscription(self._subscription)


def read() -> None:
    """Log one topic after the other until the parent is gone."""
    node = plain_node(f"bench_reader_{time.monotonic_ns()}")
    orders = commands()
    while (order := orders.get()) is not None:
        log = Log(node, order["topic"])
        answer(open=True)
        finish: dict[str, Any] | None = None
        while finish is None:
            log.take()
            with suppress(queue.Empty):
                finish = orders.get(timeout=_POLL_S)
                if finish is None:
                    return
                if "peek" in finish:
                    answer(received=len(log.numbers))
                    finish = None
        quiet_s = time.monotonic()
        while not log.is_complete(finish["first"], finish["end"]) and time.monotonic() - quiet_s < finish["tail_s"]:
            before = len(log.numbers)
            log.take()
            if len(log.numbers) > before:
                quiet_s = time.monotonic()
            time.sleep(0.02)
        time.sleep(0.1)  # time for a double to show up
        log.take()
        answer(**log.report(finish["first"], finish["end"]))
        log.close()


if __name__ == "__main__":
    {"writer": write, "reader": read}[sys.argv[1]]()
