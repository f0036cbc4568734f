"""Processes of a benchmark that talk in lines of JSON: the parent sends commands, the child answers."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

from arpd.adapters.ros.runtime import FASTDDS_PROFILE
from scripts.bench.record import REPO
from scripts.netns.namespaces import inside

if TYPE_CHECKING:
    from collections.abc import Callable

    from scripts.netns.namespaces import HostName
    from scripts.netns.simlink import Host, SimLink


class ChildError(Exception):
    """A child has ended, or does not answer."""


class Child:
    """A Python process on one host of the link.

    Parameters
    ----------
    argv : module and its arguments
    environment : replaces variables of the link's environment
    """

    def __init__(self, link: SimLink, host: HostName, *argv: str, environment: dict[str, str] | None = None) -> None:
        extra = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(FASTDDS_PROFILE), **(environment or {})}
        self.name = " ".join(argv)
        self.process: subprocess.Popen[str] = link.popen(
            host,
            ["env", *(f"{key}={value}" for key, value in extra.items()), sys.executable, "-u", "-m", *argv],
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


def commands() -> queue.SimpleQueue[dict[str, Any] | None]:
    """Return the queue of the parent's commands, in the child; None means that the parent is gone."""
    orders: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()

    def listen() -> None:
        for line in sys.stdin:
            orders.put(json.loads(line))
        orders.put(None)

    threading.Thread(target=listen, daemon=True).start()
    return orders


def answer(**fact: Any) -> None:
    """Answer the parent, in the child."""
    print(json.dumps(fact), flush=True)


def serve(turn: Callable[[], float], reply: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """Live as a child until the parent is gone.

    Parameters
    ----------
    turn : does what is due; returns how long the next turn may wait for a command (s)
    reply : does what a command says; returns the answer
    """
    orders = commands()
    answer(open=True)
    while True:
        wait_s = turn()
        try:
            order = orders.get(timeout=wait_s)
        except queue.Empty:
            continue
        if order is None:
            return
        answer(**reply(order))


def footprint(pid: int) -> dict[str, int]:
    """Return a process's resident memory (bytes), and the number of its threads and open files."""
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines())
    return {
        "rss_bytes": int(status["VmRSS"].split()[0]) * 1024,
        "threads": int(status["Threads"]),
        "files": len(list(Path(f"/proc/{pid}/fd").iterdir())),
    }


def sent_bytes(host: Host, interface: str | None = None) -> int:
    """Return the bytes that an interface of a host has sent; by default its end of the link."""
    name = interface or host.interface
    text = inside(host.namespace, lambda: Path("/proc/thread-self/net/dev").read_text(encoding="utf-8"))
    for line in text.splitlines():
        if line.strip().startswith(f"{name}:"):
            return int(line.split(":", 1)[1].split()[8])
    raise ChildError(f"no interface {name} on {host.name}")


def kernel_count(host: Host, protocol: str, name: str) -> int:
    """Return a counter of a host's kernel (/proc/net/snmp, the counters of RFC 1213).

    Parameters
    ----------
    protocol, name : as in /proc/net/snmp, for example ``Udp`` and ``RcvbufErrors``
    """
    # /proc/net is the namespace of the process, not of this thread.
    lines = inside(host.namespace, Path("/proc/thread-self/net/snmp").read_text).splitlines()
    names, values = (line.split() for line in lines if line.startswith(f"{protocol}:"))
    return int(values[names.index(name)])


def sample_of(number: int, payload_bytes: int) -> bytes:
    """Serialize a std_msgs/String of ``payload_bytes`` characters that begins with its number."""
    length = (payload_bytes + 1).to_bytes(4, "little")
    return b"\x00\x01\x00\x00" + length + b"%010d" % number + b"x" * (payload_bytes - 10) + b"\x00"


def number_of(sample: bytes) -> int:
    """Return the number in a sample `sample_of` made."""
    return int(sample[8:18])
