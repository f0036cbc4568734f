"""The two kinds of process of the swap benchmark: one writer, and readers that note what arrives.

Usage: python -m scripts.bench.swap_nodes writer|reader
"""

from __future__ import annotations

import itertools
import queue
import sys
import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from arpd import AdaptivePublisher
from scripts.bench.child import commands, number_of, sample_of, say

if TYPE_CHECKING:
    from collections.abc import Callable

STILL, ADAPTIVE, RECREATE = "no swaps", "adaptive", "destroy+create"
_READ_DEPTH = 5000
_POLL_S = 0.002
_MATCH_TIMEOUT_S = 30.0
_WARM_S = 0.2
_SWAP_TIMEOUT_S = 8.0
_SETTLE_S = 0.6  # after the last swap, so that its drain is measured with it


class Side(Protocol):
    """One way to change a publisher's depth."""

    def publish(self, sample: bytes) -> None:
        """Publish a sample."""

    def matched(self) -> int:
        """Count the readers."""

    def swap(self, depth: int) -> None:
        """Change the depth."""

    def ended(self) -> int:
        """Count the swaps that have ended."""

    def results(self) -> dict[str, int]:
        """How its swaps ended."""

    def destroy(self) -> None:
        """Destroy the publisher."""


class Adaptive:
    """An AdaptivePublisher, re-tuned; or never, for the baseline."""

    def __init__(self, node: Any, topic: str, depth: int) -> None:
        self._publisher = AdaptivePublisher(node, String, topic, depth)
        self.publish: Callable[[bytes], None] = self._publisher.publish
        self.matched = self._publisher.get_subscription_count
        self.destroy = self._publisher.destroy

    def swap(self, depth: int) -> None:
        self._publisher.retune(replace(self._publisher.plan, depth=depth))

    def ended(self) -> int:
        swaps = self._publisher.state(generation=0).swaps_by_result
        return sum(count for key, count in swaps.items() if key != "undelivered")

    def results(self) -> dict[str, int]:
        state = self._publisher.state(generation=0)
        return {**state.swaps_by_result, **({"withheld": state.withheld} if state.withheld else {})}


class Still(Adaptive):
    """The baseline: an AdaptivePublisher whose settings stay."""

    def swap(self, depth: int) -> None:
        """Leave it as it is."""

    def ended(self) -> int:
        return sys.maxsize


class Recreate:
    """What a node without arpd does: destroy its publisher, create another one."""

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


WAYS: dict[str, Callable[[Any, str, int], Side]] = {STILL: Still, ADAPTIVE: Adaptive, RECREATE: Recreate}


class Stream:
    """Publishes numbered samples at a fixed rate."""

    def __init__(self, side: Side, rate_hz: float, payload_bytes: int) -> None:
        self._side, self._period_s, self._payload_bytes = side, 1.0 / rate_hz, payload_bytes
        self._due_s = time.monotonic()
        self.sent = 0
        self.longest_publish_s = 0.0

    def run(self, for_s: float) -> None:
        """Publish for a while; what fell behind is caught up."""
        until_s = self._due_s + for_s
        while self._due_s < until_s:
            time.sleep(max(0.0, self._due_s - time.monotonic()))
            before_s = time.monotonic()
            self._side.publish(sample_of(self.sent, self._payload_bytes))
            self.longest_publish_s = max(self.longest_publish_s, time.monotonic() - before_s)
            self.sent += 1
            self._due_s += self._period_s


def turn(node: Any, told: queue.SimpleQueue[dict[str, Any] | None], order: dict[str, Any]) -> None:
    """Publish still, then with swaps; the parent reads the byte counters when it hears of each phase."""
    side = WAYS[order["way"]](node, order["topic"], order["depth"])
    try:
        until_s = time.monotonic() + _MATCH_TIMEOUT_S
        while side.matched() < order["readers"] and time.monotonic() < until_s:
            time.sleep(0.01)
        time.sleep(0.2)
        stream = Stream(side, order["rate_hz"], order["payload_bytes"])
        say(phase="warm")
        while told.empty():  # its own matched readers need not know of it as yet: each must have received something
            stream.run(_WARM_S)
        told.get()
        first = stream.sent
        say(phase="still")
        cpu = [time.process_time()]
        stream.run(order["still_s"])
        say(phase="swaps")
        cpu.append(time.process_time())
        stream.longest_publish_s = 0.0
        requests = []
        for k in range(order["swaps"]):
            requests.append(stream.sent)
            side.swap(order["depth"] + 1 - k % 2)
            stream.run(order["spacing_s"])
            give_up_s = time.monotonic() + _SWAP_TIMEOUT_S
            while side.ended() <= k and time.monotonic() < give_up_s:
                stream.run(0.1)
        stream.run(_SETTLE_S)
        cpu.append(time.process_time())
        say(
            phase="done",
            first=first,
            end=stream.sent,
            cpu_s=cpu,
            requests=requests,
            results=side.results(),
            longest_publish_s=stream.longest_publish_s,
            matched=side.matched(),
        )
        told.get()  # the readers have all there is
    finally:
        side.destroy()
    say(phase="closed")


def write() -> None:
    """Serve turns until the parent is gone."""
    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node("bench_writer")
    told = commands()
    while (order := told.get()) is not None:
        turn(node, told, order)


class Log:
    """What arrived on one topic, in the order the application gets it."""

    def __init__(self, node: Any, topic: str) -> None:
        self._node = node
        self._subscription = node.create_subscription(
            String, topic, lambda _sample: None, QoSProfile(depth=_READ_DEPTH), raw=True
        )
        self.numbers: list[int] = []
        self.sequence: list[int] = []  # of the writer a sample came from; a fall marks a switch
        self.received_ns: list[int] = []  # taken by DDS on reception, whatever this process is busy with
        self.cpu_s = time.process_time()

    def take(self) -> None:
        """Take all there is, as an executor would, without paying for one."""
        handle = self._subscription.handle
        with handle:
            while (taken := handle.take_message(String, True)) is not None:  # noqa: FBT003 - rclpy's own signature
                sample, information = taken
                self.numbers.append(number_of(sample))
                self.sequence.append(information["publication_sequence_number"])
                self.received_ns.append(information["received_timestamp"])

    def is_complete(self, first: int, end: int) -> bool:
        return len(self.numbers) >= end - first and len({n for n in self.numbers if first <= n < end}) == end - first

    def report(self, first: int, end: int) -> dict[str, Any]:
        """Count what went wrong among the samples from ``first`` to ``end``."""
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
    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node(f"bench_reader_{time.monotonic_ns()}")
    told = commands()
    while (order := told.get()) is not None:
        log = Log(node, order["topic"])
        say(open=True)
        finish: dict[str, Any] | None = None
        while finish is None:
            log.take()
            with suppress(queue.Empty):
                finish = told.get(timeout=_POLL_S)
                if finish is None:
                    return
                if "peek" in finish:
                    say(received=len(log.numbers))
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
        say(**log.report(finish["first"], finish["end"]))
        log.close()


if __name__ == "__main__":
    {"writer": write, "reader": read}[sys.argv[1]]()
