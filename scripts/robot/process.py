"""How the demo's nodes live: told by signals, each ends by writing what it counted.

SIGUSR1 starts publishing, SIGUSR2 stops it and the node stays, SIGTERM writes the result and ends.
"""

from __future__ import annotations

import json
import signal
from typing import TYPE_CHECKING, Any, Protocol

import rclpy
from rclpy.executors import SingleThreadedExecutor

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


class DemoNode(Protocol):
    """A node of the demo."""

    is_publishing: bool

    def result(self) -> dict[str, Any]:
        """Return what it counted."""


def live(make: Callable[[], DemoNode], out: Path) -> None:
    """Run one node until SIGTERM, then write its result."""
    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = make()
    running = True

    def on_signal(signum: int, _frame: Any) -> None:
        nonlocal running
        running = running and signum != signal.SIGTERM
        node.is_publishing = signum == signal.SIGUSR1

    for signum in (signal.SIGUSR1, signal.SIGUSR2, signal.SIGTERM):
        signal.signal(signum, on_signal)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    print("ready", flush=True)
    while running:
        executor.spin_once(timeout_sec=0.1)
    out.write_text(json.dumps(node.result()))
