"""The processes of a chaos test: arpd as it is, but a swap can be stopped in any state, so that a kill meets it there.

Usage: nodes.py talker NAME TOPIC… | nodes.py listener NAME TOPIC… | nodes.py daemon CONFIG

Each takes commands on stdin and answers on stdout, in lines of JSON (`scripts.bench.child`).
"""

from __future__ import annotations

import sys
import threading
import time
from collections import defaultdict
from contextlib import contextmanager

from arpd.endpoint.writer import RosWriter
from arpd.endpoint.writer_swap import WriterSwap
from arpd.model.endpoints import SwapState
from arpd.ros import rmw
from scripts.bench.child import answer, commands, number_of, sample_of, spinning

RATE_HZ = 20.0
BASELINE_DEPTH = 60
DEPTH = 200  # the requested depth: at this rate the queue holds the samples of 10 s
DRAINING = "draining"  # an old writer is not destroyed yet; the swap itself may be in any state
WHERE = (*(str(state) for state in SwapState if state is not SwapState.IDLE), DRAINING)
TOPICS = {where: f"/chaos/{where}" for where in WHERE}  # one process is killed in all states at once
PAYLOAD_BYTES = 40


class Stops:
    """Stops swaps in given states until they are released; samples go on as the state allows.

    A stopped swap takes no step and its clock stops, so that the stop causes no timeout.
    """

    def __init__(self):
        self._lock = threading.Lock()
        self._wanted = {}  # topic → where
        self._stopped = {}  # swap → since when (s)
        self._lag_s = defaultdict(float)
        self._looking = threading.local()

    def install(self):
        step, wrote, is_acknowledged = WriterSwap.step, WriterSwap.wrote, RosWriter.is_acknowledged
        WriterSwap.step = lambda swap, now_s, **options: self._on_step(
            swap, now_s, lambda lagged_s: step(swap, lagged_s, **options)
        )
        WriterSwap.wrote = lambda swap, now_s: wrote(swap, now_s - self._lag_s[swap])
        RosWriter.is_acknowledged = lambda writer: not self._is_hidden(writer) and is_acknowledged(writer)

    def stop(self, at):
        with self._lock:
            self._wanted = dict(at)

    def release(self):
        with self._lock:
            self._wanted = {}
            for swap, since_s in self._stopped.items():
                self._lag_s[swap] += time.monotonic() - since_s
            self._stopped = {}

    def _on_step(self, swap, now_s, step):
        with self._lock:
            if swap in self._stopped:
                return
            now_s -= self._lag_s[swap]
            topic = swap.current.publisher.topic_name
            where = self._wanted.get(topic)
        if where is None:
            step(now_s)
            return
        self._looking.at = (swap, swap.state, where)
        try:
            step(now_s)
        finally:
            self._looking.at = None
        with self._lock:
            if topic in self._wanted and (swap._draining if where == DRAINING else swap.state == where):
                del self._wanted[topic]
                self._stopped[swap] = time.monotonic()
                answer(stopped=topic)

    def _is_hidden(self, writer):
        """Return whether to hide an acknowledgement, so that the swap comes to its stop and passes no other state."""
        if (at := getattr(self._looking, "at", None)) is None:
            return False
        swap, state, where = at
        is_passing = swap.state is not state
        return is_passing or where == "holding" or (where == "doubting" and writer is swap._next)


def obey(roles):
    """Carry out the parent's commands, ``{"do": name, …}``, until it is gone."""
    orders = commands()
    while (order := orders.get()) is not None:
        answer(answer=roles[order.pop("do")](**order))


@contextmanager
def spun(name):
    from rclpy.executors import SingleThreadedExecutor

    from arpd.ros.runtime import ros_node

    with ros_node(name) as node:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        with spinning(executor):
            yield node


class Talker:
    """Publishes the same numbers on every topic, through AdaptivePublishers."""

    def __init__(self, node, topics):
        from std_msgs.msg import String

        from arpd import AdaptivePublisher
        from arpd.model.endpoints import Overflow

        self._publishers = {
            topic: AdaptivePublisher(node, String, topic, BASELINE_DEPTH, overflow=Overflow.QUEUE) for topic in topics
        }
        self._first = {topic: {} for topic in topics}  # matched readers → first number published to so many
        self._next = 0
        self._lock = threading.Lock()
        self._is_publishing = False
        threading.Thread(target=self._talk, daemon=True).start()

    def publish(self, *, is_on, number=None):
        """Go on or pause; return the number of samples published so far."""
        with self._lock:
            self._is_publishing = is_on
            self._next = self._next if number is None else number
            return self._next

    def matched(self):
        return {topic: publisher.get_subscription_count() for topic, publisher in self._publishers.items()}

    def first(self):
        """Return the first number published on each topic, by the count of readers."""
        return {topic: {str(count): number for count, number in of.items()} for topic, of in self._first.items()}

    def _talk(self):
        due_s = time.monotonic()
        while True:
            with self._lock:
                if self._is_publishing:
                    for topic, publisher in self._publishers.items():
                        self._first[topic].setdefault(publisher.get_subscription_count(), self._next)
                        publisher.publish(sample_of(self._next, PAYLOAD_BYTES))
                    self._next += 1
            due_s = max(due_s + 1 / RATE_HZ, time.monotonic())
            time.sleep(max(0.0, due_s - time.monotonic()))


def talk(name, *topics):
    stops = Stops()
    stops.install()
    with spun(name) as node:
        talker = Talker(node, topics)
        obey(
            {
                "stop": stops.stop,
                "release": stops.release,
                "publish": talker.publish,
                "matched": talker.matched,
                "first": talker.first,
            }
        )


def listen(name, *topics):
    with spun(name) as node:
        from std_msgs.msg import String

        received = {topic: [] for topic in topics}
        for topic, numbers in received.items():
            node.create_subscription(String, topic, lambda s, n=numbers: n.append(number_of(s)), 1000, raw=True)
        obey({"received": lambda: received})


def daemon(config):
    """Run the daemon; on this one host a node in another process counts as across the link."""
    from arpd.cli.main import main

    rmw.Rmw.tells_hosts = False
    main(["run", "--config", config])


if __name__ == "__main__":
    {"talker": talk, "listener": listen, "daemon": daemon}[sys.argv[1]](*sys.argv[2:])
