"""The nodes of a benchmark, but each swap of a topic in TOPICS stops in a state, so that a kill meets it there.

Usage: as of `scripts.bench.nodes`, with three more commands, each answered with the states of the publishers.
"""

import json
import sys
import threading
import time
from collections import defaultdict
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

from arpd.endpoint.writer import RosWriter
from arpd.endpoint.writer_swap import WriterSwap
from arpd.model.endpoints import SwapState
from scripts.bench.child import serve
from scripts.bench.nodes import Process

DRAINING = "draining"  # an old writer is not destroyed yet; the swap itself may be in any state
WHERE = (*(str(state) for state in SwapState if state is not SwapState.IDLE), DRAINING)
TOPICS = {where: f"/chaos/{where}" for where in WHERE}  # one process is killed in all states at once


class Stops:
    """Stops the first swap of each of the topics in its state until all are released; samples go on as it allows.

    A stopped swap takes no step and its clock stops, so that the stop causes no timeout.
    """

    def __init__(self):
        self._lock = threading.Lock()
        self.wanted = {topic: where for where, topic in TOPICS.items()}
        self._stopped = {}  # swap → since when (s)
        self._lag_s = defaultdict(float)
        self._looking = threading.local()

    def install(self):
        move, release, make = WriterSwap._move, WriterSwap._release, RosWriter.__init__

        def release_late(swap, now_s):
            before = swap._since_s
            release(swap, now_s)
            if swap.state is SwapState.PROVING and swap._trial and swap._since_s != before:
                swap._since_s -= self._lag_s[swap]

        def make_hidden(writer, *given, **options):
            make(writer, *given, **options)
            is_acknowledged = writer.is_acknowledged
            writer.is_acknowledged = lambda: not self._is_hidden(writer) and is_acknowledged()

        WriterSwap._move = lambda swap, now_s: self._on_move(swap, now_s, partial(move, swap))
        WriterSwap._release = release_late
        RosWriter.__init__ = make_hidden

    def release(self):
        with self._lock:
            self.wanted = {}
            for swap, since_s in self._stopped.items():
                self._lag_s[swap] += time.monotonic() - since_s
            self._stopped = {}

    def _on_move(self, swap, now_s, move):
        with self._lock:
            if swap in self._stopped:
                return
            now_s -= self._lag_s[swap]
            topic = swap.current.publisher.topic_name
            where = self.wanted.get(topic)
        if where is None:
            move(now_s)
            return
        self._looking.at = (swap, swap.state, where)
        try:
            move(now_s)
        finally:
            self._looking.at = None
        with self._lock:
            if topic in self.wanted and (swap._draining if where == DRAINING else swap.state == where):
                del self.wanted[topic]
                self._stopped[swap] = time.monotonic()

    def _is_hidden(self, writer):
        """Return whether to hide an acknowledgement, so that the swap comes to its stop and passes no other state."""
        if (at := getattr(self._looking, "at", None)) is None:
            return False
        swap, state, where = at
        is_passing = swap.state is not state
        return is_passing or where == "holding" or (where == "doubting" and writer is swap._next)


class Stopping(Process):
    """A process of a benchmark whose publishers tell of themselves."""

    def __init__(self, *arguments):
        self._stops = Stops()
        self._stops.install()
        super().__init__(*arguments)

    def answer(self, order):
        match order:
            case {"do": "swap", **qos}:
                for source in self.talker.sources.values():
                    source.publisher.retune(replace(source.publisher.plan, **qos))
            case {"do": "release"}:
                self._stops.release()
            case {"do": "states"}:
                pass
            case _:
                return super().answer(order)
        return {source.topic.name: self._state(source) for source in self.talker.sources.values()}

    def _state(self, source):
        publisher, state = source.publisher, source.publisher.state()
        told = ("published", "withheld", "queued", "depth", "deadline_ns", "refusal")
        return {
            **{name: getattr(state, name) for name in told},
            "number": source.number,  # of the last sample
            # ``undelivered`` comes beside a swap's own result.
            "ended": sum(many for result, many in state.swaps_by_result.items() if result != "undelivered"),
            "will_stop": publisher.topic_name in self._stops.wanted,
            "readers": publisher.get_subscription_count(),
            "writers": self.talker._node.count_publishers(publisher.topic_name),
        }


if __name__ == "__main__":
    path, name = sys.argv[1:]
    with ExitStack() as stack:
        process = Stopping(json.loads(Path(path).read_text("utf-8")), name, stack)
        serve(process.turn, process.answer)
