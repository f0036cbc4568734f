"""The life of the demo's nodes: signals control them, and each writes its counts at the end.

SIGUSR1 starts publishing, SIGUSR2 stops it, SIGTERM writes the result and ends the node.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import time
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile

from scripts.robot.manner import RCLPY_DEPTH

if TYPE_CHECKING:
    from collections.abc import Callable


class DemoNode(Protocol):
    """A node of the demo."""

    is_publishing: bool

    def result(self, began_s: float, ended_s: float) -> dict[str, Any]:
        """Return the node's counts between two times (Unix s)."""


def command_line(*positional: str) -> argparse.Namespace:
    """Read a node's command line: the given names, ``out`` as a path, QoS as ``qos``, ``rate_hz`` (0 = its own)."""
    parser = argparse.ArgumentParser()
    for name in positional:
        parser.add_argument(name, type=Path if name == "out" else str)
    parser.add_argument("--depth", type=int, default=RCLPY_DEPTH)
    parser.add_argument("--deadline-ns", type=int, default=0)
    parser.add_argument("--rate", type=float, default=0.0, dest="rate_hz")
    order = parser.parse_args()
    order.qos = QoSProfile(depth=order.depth)  # RELIABLE, VOLATILE, KEEP_LAST: rclpy's own defaults
    if order.deadline_ns:
        order.qos.deadline = Duration(nanoseconds=order.deadline_ns)
    return order


def reading(qos: QoSProfile, rate_hz: float) -> QoSProfile:
    """Return the QoS of a reader that loses nothing on its own host while it is busy for a second, and catches up.

    Parameters
    ----------
    qos : that of the run, with its depth for writers
    rate_hz : rate of the topic (Hz)
    """
    wanted = copy(qos)
    wanted.depth = max(qos.depth, math.ceil(2.0 * rate_hz))
    return wanted


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
