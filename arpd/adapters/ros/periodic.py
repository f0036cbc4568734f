"""Work that takes too long for an executor, again and again in a thread of its own."""

from __future__ import annotations

import logging
import threading
import time
from itertools import chain, repeat
from typing import TYPE_CHECKING, Any

from rclpy.impl.implementation_singleton import rclpy_implementation

if TYPE_CHECKING:
    from collections.abc import Callable

log = logging.getLogger(__name__)

_HASTY_ROUNDS = 30  # at the start everything is news

InvalidHandle = rclpy_implementation.InvalidHandle  # what a destroyed node raises


class Rounds:
    """Does all of its work, waits, and does it again, until the node is destroyed or its context ends.

    A thread, and not a timer in a MultiThreadedExecutor: that one asks again and again whether a task that it gave to
    another thread has begun (rclpy 7.1.6, ``Executor._wait_for_ready_callbacks``), and while it asks, it holds the
    interpreter for 5 ms. Measured: a whole core at 200 events a second.

    Parameters
    ----------
    node : rclpy node that the work asks
    work : what to do; where one part fails, the others are done all the same
    every_s : how long to wait between two rounds (s); at first a fifth of that
    """

    def __init__(self, node: Any, *work: Callable[[], None], every_s: float) -> None:
        self._node = node
        self._work = work
        self._every_s = every_s
        threading.Thread(target=self._run, name="arpd-rounds", daemon=True).start()

    def _run(self) -> None:
        for pause_s in chain(repeat(self._every_s / 5, _HASTY_ROUNDS), repeat(self._every_s)):
            if not self._node.context.ok():
                return
            for do in self._work:
                try:
                    do()
                except InvalidHandle:
                    return
                except Exception:
                    log.exception("a part of a round failed; the others go on")
            time.sleep(pause_s)
