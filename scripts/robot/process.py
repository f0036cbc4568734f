"""The life of the demo's nodes: signals control them, and each writes its counts at the end.

SIGUSR1 starts publishing, SIGUSR2 stops it, SIGTERM writes the result and ends the node.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile

if TYPE_CHECKING:
    from collections.abc import Callable


RCLPY_DEPTH = 10  # what every rclpy tutorial passes; RELIABLE, VOLATILE, KEEP_LAST are rclpy's own defaults


class DemoNode(Protocol):
    """A node of the demo."""

    is_publishing: bool

    def result(self, began_s: float, ended_s: float) -> dict[str, Any]:
        """Return the node's counts between two times (Unix s)."""


def command_line(*positional: str) -> argparse.Namespace:
    """Read a node's command line: the given names, ``out`` as a path."""
    parser = argparse.ArgumentParser()
    for name in positional:
        parser.add_argument(name, type=Path if name == "out" else str)
    return parser.parse_args()


def reading(rate_hz: float) -> QoSProfile:
    """Return the QoS of a reader that loses nothing on its own host while it is busy for a second, and catches up."""
    return QoSProfile(depth=max(RCLPY_DEPTH, math.ceil(2.0 * rate_hz)))


def live(make: Callable[[], DemoNode], out: Path) -> None:
    """Run one node until SIGTERM, then write its result."""
    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = make()
    running = True
    began_s = ended_s = 0.0

    def on_signal(signum: int, _frame: Any) -> None:
        nonlocal running, began_s, ended_s
        running = running and signum != signal.SIGTERM
        if signum == signal.SIGUSR1:
            began_s = time.time()
        elif node.is_publishing:
            ended_s = time.time()
        node.is_publishing = signum == signal.SIGUSR1

    for signum in (signal.SIGUSR1, signal.SIGUSR2, signal.SIGTERM):
        signal.signal(signum, on_signal)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    print("ready", flush=True)
    while running:
        executor.spin_once(timeout_sec=0.1)
    out.write_text(json.dumps(node.result(began_s, ended_s)))
