"""The ROS nodes around the link in `discovery.py`: several of the robot in one process, and one on the far side.

Usage: python -m scripts.bench.discovery_nodes robot FIRST COUNT | far
"""

from __future__ import annotations

import sys
from functools import partial
from typing import TYPE_CHECKING, Any

import rclpy
from std_msgs.msg import Float64, String

from scripts.bench.child import answer, commands
from scripts.bench.node import becomes_true, plain_node

if TYPE_CHECKING:
    from collections.abc import Iterator

_STEM = "/bench_node_"
TOPICS_PER_NODE = 2


def robot(first: int, count: int) -> None:
    """Make nodes, each with a context of its own, and hold them until the parent is gone.

    A context is a participant of DDS, as a process with one node has it. Nothing spins them, for nobody calls them.
    """
    kept = list(_nodes(range(first, first + count)))
    answer(nodes=len(kept))
    orders = commands()
    while orders.get() is not None:
        pass


def _nodes(numbers: range) -> Iterator[Any]:
    for number in numbers:
        context = rclpy.Context()
        rclpy.init(context=context, signal_handler_options=rclpy.SignalHandlerOptions.NO)
        node = rclpy.create_node(f"{_STEM.strip('/')}{number}", context=context)
        publishers = [
            node.create_publisher(kind, f"{_STEM}{number}/{name}", 10)
            for name, kind in (("state", String), ("value", Float64))
        ]
        yield node, publishers


def far() -> None:
    """Tell the parent how many topics of the robot's nodes this node knows, once it knows enough, or after a time."""
    node = plain_node("bench_far")
    answer(open=True)

    def known() -> int:
        return sum(name.startswith(_STEM) for name, _ in node.get_topic_names_and_types())

    def has(topics: int) -> bool:
        return known() >= topics

    orders = commands()
    while (order := orders.get()) is not None:
        becomes_true(partial(has, order["topics"]), order["timeout_s"], poll_s=0.2)
        answer(topics=known())


if __name__ == "__main__":
    if sys.argv[1] == "robot":
        robot(int(sys.argv[2]), int(sys.argv[3]))
    else:
        far()
