"""Shared parts of the benchmarks' ROS nodes: a node without signal handlers, raw samples, waiting."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


def plain_node(name: str) -> Any:
    """Start rclpy and return a node."""
    import rclpy

    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    return rclpy.create_node(name)


def raw_readers(node: Any, topics: list[str], depth: int) -> list[Any]:
    """Return a subscription to std_msgs/String for each topic, whose samples `taken` takes."""
    from rclpy.qos import QoSProfile
    from std_msgs.msg import String

    qos = QoSProfile(depth=depth)
    return [node.create_subscription(String, topic, lambda _sample: None, qos, raw=True) for topic in topics]


def taken(subscription: Any) -> Iterator[tuple[bytes, dict[str, int]]]:
    """Take all there is, as an executor would, without its cost; yield each serialized sample and its information."""
    from std_msgs.msg import String

    handle = subscription.handle
    with handle:
        while (found := handle.take_message(String, True)) is not None:  # noqa: FBT003 - rclpy's own signature
            yield found


def becomes_true(condition: Callable[[], bool], timeout_s: float, *, poll_s: float = 0.05) -> bool:
    """Wait until a condition holds; return whether it did in time."""
    until_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > until_s:
            return False
        time.sleep(poll_s)
    return True
