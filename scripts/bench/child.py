"""Processes of a benchmark that talk in lines of JSON: the parent sends commands, the child answers."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import queue
import subprocess
import sys
import threading
import time
from typing import TYPE_CHECKING, Any

from arpd.model.errors import ArpdError
from scripts.bench.report import REPO

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from scripts.netns.namespaces import HostName
    from scripts.netns.simlink import SimLink

log = logging.getLogger(__name__)


class ChildError(ArpdError):
    """A child has ended, or does not answer."""


class Child:
    """A Python process on one host of the link.

    Parameters
    ----------
    argv : module and its arguments
    environment : replaces variables of the link's environment
    """

    def __init__(self, link: SimLink, host: HostName, *argv: str, environment: dict[str, str]) -> None:
        self.name = " ".join(argv)
        self.process: subprocess.Popen[str] = link.popen(
            host,
            ["env", *(f"{key}={value}" for key, value in environment.items()), sys.executable, "-u", "-m", *argv],
            env={**os.environ, "PYTHONPATH": str(REPO)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=REPO,
        )
        self._answers: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()

    def send(self, **command: Any) -> None:
        """Send a command."""
        assert self.process.stdin is not None
        try:
            print(json.dumps(command), file=self.process.stdin, flush=True)
        except BrokenPipeError as error:
            raise ChildError(f"{self.name} ended") from error

    def receive(self, timeout_s: float = 60.0) -> dict[str, Any]:
        """Wait for the child's next line."""
        try:
            said = self._answers.get(timeout=timeout_s)
        except queue.Empty as error:
            raise ChildError(f"{self.name} has not answered for {timeout_s:.0f} s") from error
        if said is None:
            raise ChildError(f"{self.name} ended with code {self.process.wait()}")
        return said

    def ask(self, **command: Any) -> dict[str, Any]:
        """Send a command and wait for its answer."""
        self.send(**command)
        return self.receive()

    def end(self) -> None:
        """End the process; kill it if it does not end in 5 s."""
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()
        try:
            self.process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith("{"):
                self._answers.put(json.loads(line))
        self._answers.put(None)


def serve(turn: Callable[[], float], reply: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """Live as a child until the parent is gone.

    Parameters
    ----------
    turn : does what is due; returns how long the next turn may wait for a command (s)
    reply : does what a command says; returns the answer
    """
    orders: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()

    def listen() -> None:
        for line in sys.stdin:
            orders.put(json.loads(line))
        orders.put(None)  # the parent is gone

    threading.Thread(target=listen, daemon=True).start()
    print(json.dumps({"open": True}), flush=True)
    while True:
        wait_s = turn()
        try:
            order = orders.get(timeout=wait_s)
        except queue.Empty:
            continue
        if order is None:
            return
        print(json.dumps(reply(order)), flush=True)


def becomes_true(condition: Callable[[], bool], timeout_s: float, *, poll_s: float = 0.05) -> bool:
    """Wait until a condition holds; return whether it did in time."""
    until_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > until_s:
            return False
        time.sleep(poll_s)
    return True


@contextlib.contextmanager
def spinning(executor: Any) -> Iterator[None]:
    """Spin an executor in a thread of its own, past callbacks that fail; leaving the block ends the thread."""
    stopping = threading.Event()

    def spin() -> None:
        while not stopping.is_set():
            try:
                executor.spin_once(timeout_sec=0.2)  # spin() of EventsExecutor would busy-loop in rclpy 7.1.6
            except Exception:
                if not stopping.is_set():
                    log.exception("a callback failed; the node continues")

    thread = threading.Thread(target=spin, name="spinning", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        executor.wake()
        thread.join(timeout=2.0)
        executor.shutdown(timeout_sec=1.0)
