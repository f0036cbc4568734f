"""The processes around a relay in `relay.py`: the source, the sink, and the bare relay.

Usage: python -m scripts.bench.relay_nodes source|sink|bare [PREFIX TOPICS]
"""

from __future__ import annotations

import queue
import sys
import time
from contextlib import suppress
from statistics import median
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from scripts.bench.child import answer, commands
from scripts.bench.node import becomes_true, plain_node, raw_readers, taken

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

OUT = "/out"
_DEPTH = 10  # of a relay's writers, as in `arpd relay` before the first plan
_RECEIVE_DEPTH = 100  # of a relay's readers, as in `arpd relay`
_SINK_DEPTH = 1000
_MATCH_TIMEOUT_S = 40.0
_SILENT_S = 5.0  # a machine that is busy with other work may hold samples up for a second
_DIGITS = 20


def topic_names(prefix: str, topics: int) -> list[str]:
    return [f"{prefix}/t{k}" for k in range(topics)]


def bare(prefix: str, topics: int) -> None:
    """Relay as ten lines of rclpy do, on the executor with the lowest cost per message."""
    node = plain_node("bare")
    for topic in topic_names(prefix, topics):
        publisher = node.create_publisher(String, OUT + topic, QoSProfile(depth=_DEPTH))
        node.create_subscription(String, topic, publisher.publish, QoSProfile(depth=_RECEIVE_DEPTH), raw=True)
    executor = EventsExecutor()
    executor.add_node(node)
    while rclpy.ok():
        executor.spin_once(timeout_sec=0.2)


def source() -> None:
    """Publish on the topics of one prefix in turn, at the rate and for the time of the order."""
    node = plain_node("bench_source")
    publishers: dict[str, list[Any]] = {}
    orders = commands()
    while (order := orders.get()) is not None:
        if "open" in order:
            publishers = {
                prefix: [
                    node.create_publisher(String, topic, QoSProfile(depth=100))
                    for topic in topic_names(prefix, order["topics"])
                ]
                for prefix in order["open"]
            }
            everyone = [publisher for group in publishers.values() for publisher in group]
            answer(matched=_all_matched([publisher.get_subscription_count for publisher in everyone]))
        else:
            answer(sent=_publish(publishers[order["prefix"]], order["rate_hz"], order["for_s"], order["payload_bytes"]))


def _publish(publishers: list[Any], rate_hz: float, for_s: float, payload_bytes: int) -> int:
    length = (payload_bytes + 1).to_bytes(4, "little")
    head, tail = b"\x00\x01\x00\x00" + length, b"x" * (payload_bytes - _DIGITS) + b"\x00"
    due_s, until_s, sent = time.monotonic(), time.monotonic() + for_s, 0
    while due_s < until_s:
        time.sleep(max(0.0, due_s - time.monotonic()))
        publishers[sent % len(publishers)].publish(head + b"%020d" % time.time_ns() + tail)
        sent += 1
        due_s += 1.0 / rate_hz
    return sent


def sink() -> None:
    """Take what one side relayed, and report its age at reception by DDS."""
    node = plain_node("bench_sink")
    groups: dict[str, list[Any]] = {}
    orders = commands()
    while (order := orders.get()) is not None:
        if "open" in order:
            groups = {
                prefix: raw_readers(node, topic_names(prefix, order["topics"]), _SINK_DEPTH) for prefix in order["open"]
            }
            answer(open=True)
        elif "match" in order:
            everyone = [subscription for group in groups.values() for subscription in group]
            answer(matched=_all_matched([subscription.get_publisher_count for subscription in everyone]))
        else:
            _listen(groups[order["prefix"]], orders, since_ns=order["since_ns"])


def _listen(subscriptions: list[Any], orders: queue.SimpleQueue[dict[str, Any] | None], *, since_ns: int) -> None:
    """Take until the parent says how many were sent; then until they are there, or nothing comes for a while.

    Parameters
    ----------
    since_ns : samples that left before come late from an earlier turn, and do not count (Unix time, ns)
    """
    ages_ns: list[int] = []
    expected: int | None = None
    last_s = time.monotonic()
    while expected is None or (len(ages_ns) < expected and time.monotonic() - last_s < _SILENT_S):
        before = len(ages_ns)
        for subscription in subscriptions:
            for sample, about in taken(subscription):
                if (sent_ns := int(sample[8 : 8 + _DIGITS])) >= since_ns:
                    ages_ns.append(about["received_timestamp"] - sent_ns)
        if len(ages_ns) > before:
            last_s = time.monotonic()
        with suppress(queue.Empty):
            order = orders.get(timeout=0.005)
            expected = order["sent"] if order else 0
            last_s = time.monotonic()
    ages_ns.sort()
    answer(
        received=len(ages_ns),
        median_s=median(ages_ns) * 1e-9 if ages_ns else None,
        p95_s=ages_ns[int(0.95 * len(ages_ns))] * 1e-9 if ages_ns else None,
    )


def _all_matched(counts: Sequence[Callable[[], int]]) -> bool:
    return becomes_true(lambda: all(count() >= 1 for count in counts), _MATCH_TIMEOUT_S)


if __name__ == "__main__":
    if sys.argv[1] == "bare":
        bare(sys.argv[2], int(sys.argv[3]))
    else:
        {"source": source, "sink": sink}[sys.argv[1]]()
