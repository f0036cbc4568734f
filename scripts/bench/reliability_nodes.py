"""The application of `reliability.py`: numbered samples with AdaptivePublishers, the same without, and one reader.

The parent speaks to each in lines of JSON (`scripts.bench.child`).
"""

from __future__ import annotations

import queue
import sys
import time
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from typing import Any

from scripts.bench.child import answer, commands, number_of, sample_of
from scripts.bench.node import becomes_true, plain_node, raw_readers, taken

KINDS = ("adaptive", "plain")
TOPICS = 4  # of each kind
RATE_HZ = 10.0
DEPTH = 400  # 40 s: longer than any outage, so that a RELIABLE writer can deliver every sample
PAYLOAD_BYTES = 100
_POLL_S = 0.005
_MATCH_S = 30.0


def topic_name(kind: str, k: int) -> str:
    return f"/app/{kind}/t{k}"


def talk(kind: str) -> None:
    """Publish the same numbers on every topic of this kind until the parent says stop."""
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import String

    from arpd import AdaptivePublisher
    from arpd.adapters.ros.runtime import spinning
    from arpd.model.settings import Overflow

    node = plain_node(f"app_{kind}")
    names = [topic_name(kind, k) for k in range(TOPICS)]
    publishers: list[Any]
    if kind == "adaptive":
        publishers = [AdaptivePublisher(node, String, name, DEPTH, overflow=Overflow.QUEUE) for name in names]
    else:
        publishers = [node.create_publisher(String, name, DEPTH) for name in names]
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    orders = commands()
    with spinning(executor) if kind == "adaptive" else nullcontext():
        if not becomes_true(lambda: all(each.get_subscription_count() >= 1 for each in publishers), _MATCH_S):
            sys.exit(f"{kind}: the reader was not matched")
        time.sleep(1.0)  # the reader may see the match later
        answer(matched=True)
        is_over, sent = False, 0
        due_s = time.monotonic()
        while not is_over:
            for publisher in publishers:
                publisher.publish(sample_of(sent, PAYLOAD_BYTES))
            sent += 1
            due_s += 1.0 / RATE_HZ
            with suppress(queue.Empty):
                orders.get(timeout=max(0.0, due_s - time.monotonic()))
                is_over = True
        answer(sent=sent)
        orders.get()


@dataclass(slots=True)
class Arrivals:
    """The arrivals on one topic."""

    numbers: set[int] = field(default_factory=set)
    doubled: int = 0
    late: int = 0  # older than an earlier arrival
    highest: int = -1
    last_s: float = 0.0
    silence_s: float = 0.0

    def note(self, number: int, now_s: float) -> None:
        self.late += number < self.highest and number not in self.numbers
        self.highest = max(self.highest, number)
        self.doubled += number in self.numbers
        self.numbers.add(number)
        if self.last_s:
            self.silence_s = max(self.silence_s, now_s - self.last_s)
        self.last_s = now_s


def read() -> None:
    """Note every number that arrives, and the longest silence of each topic."""
    names = [topic_name(kind, k) for kind in KINDS for k in range(TOPICS)]
    readers = dict(zip(names, raw_readers(plain_node("app_reader"), names, 1000), strict=True))
    arrivals = {name: Arrivals() for name in names}
    orders = commands()
    answer(open=True)
    while True:
        for name, reader in readers.items():
            for sample, _ in taken(reader):
                arrivals[name].note(number_of(sample), time.monotonic())
        with suppress(queue.Empty):
            order = orders.get(timeout=_POLL_S)
            if order is None:
                return
            answer(topics={name: _summary(one, order["sent"][name.split("/")[2]]) for name, one in arrivals.items()})


def _summary(arrivals: Arrivals, sent: int) -> dict[str, Any]:
    missing = sorted(set(range(sent)) - arrivals.numbers)
    return {
        "sent": sent,
        "lost": len(missing),
        "first_lost": missing[:20],
        "doubled": arrivals.doubled,
        "late": arrivals.late,
        "silence_s": arrivals.silence_s,
    }


if __name__ == "__main__":
    if sys.argv[1] == "talker":
        talk(sys.argv[2])
    else:
        read()
