"""A process of `robots.py`: some of a robot's publishers, readers or the caller of its service, in plain rclpy.

The parent speaks to each in lines of JSON (`scripts.bench.child`).
"""

from __future__ import annotations

import heapq
import math
import sys
import time
from array import array
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from scripts.bench.child import serve
from scripts.bench.node import plain_node, taken
from scripts.bench.robots_sets import (
    BASE,
    CALLED,
    MAP_BYTES,
    MAP_SERVER,
    MAP_SERVICE,
    Template,
    Topic,
    class_of,
    sources_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable

ROBOT_SINK, BASE_SINK, CALLER = "robot_sink", "base_sink", "caller"  # the other processes have their node's name
CALL_EVERY_S = 10.0
_DEPTH = 10  # what every rclpy tutorial passes
_POLL_S, _REST_S = 0.002, 0.05
_APART_S = 0.0037  # no two processes of a robot tick together
_LATE_S = 0.1  # a timer that is later, and later than its period, leaves out ticks


def _qos(topic: Topic, depth: int) -> Any:
    from rclpy.qos import QoSDurabilityPolicy, QoSProfile

    if topic.is_latched:
        return QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    return QoSProfile(depth=depth)


@dataclass(slots=True)
class Source:
    """One publisher, and the numbers of the samples that count."""

    topic: Topic
    template: Template
    publisher: Any
    number: int = -1  # of the last tick
    first: int | None = None
    published: int = 0  # of those that count


class Talker:
    """Publishes on time, as timers of one executor do: late after a write that blocked, and then not twice."""

    def __init__(self, numbered: list[tuple[int, Topic]], create: Callable[[Topic], Any]) -> None:
        self.sources = {
            number: Source(topic=topic, template=Template(topic, number), publisher=create(topic))
            for number, topic in numbered
        }
        self._due: list[tuple[float, int]] = []
        self._from_s = self._until_s = math.inf

    def is_read(self) -> bool:
        return all(source.publisher.get_subscription_count() for source in self.sources.values())

    def begin(self, begin_s: float, from_s: float, until_s: float) -> None:
        """Publish from one time to another, and count from a time between (monotonic s)."""
        self._from_s, self._until_s = from_s, until_s
        begin_s += _APART_S * min(self.sources, default=0)
        self._due = [(begin_s, number) for number in self.sources]

    def publish_due(self) -> float:
        """Publish what is due; return the time until the next (s)."""
        now_s = time.monotonic()
        while self._due and self._due[0][0] <= now_s:
            due_s, number = heapq.heappop(self._due)
            if due_s >= self._until_s:
                continue
            source = self.sources[number]
            period_s = 1.0 / source.topic.rate_hz
            ticks = 1 if now_s - due_s <= max(period_s, _LATE_S) else 1 + math.floor((now_s - due_s) / period_s)
            source.number += ticks
            due_s += (ticks - 1) * period_s
            heapq.heappush(self._due, (due_s + period_s, number))
            if due_s >= self._from_s:
                source.first = source.number if source.first is None else source.first
                source.published += 1
            source.publisher.publish(source.template.sample(source.number))
        return max(0.0, self._due[0][0] - time.monotonic()) if self._due else _REST_S

    def document(self) -> dict[str, Any]:
        noted = {number: {"first": each.first, "published": each.published} for number, each in self.sources.items()}
        return {"sources": noted}


class Listener:
    """Notes what arrives: source, number, times of publishing and arrival (ns), whether it is whole."""

    def __init__(self, node: Any, read: dict[str, list[int]], sources: list[Topic]) -> None:
        self._templates = {number: Template(sources[number]) for numbers in read.values() for number in numbers}
        self._first = {name: self._templates[numbers[0]] for name, numbers in read.items()}
        self.arrivals: dict[str, list[tuple[int, int, int, int, bool]]] = {name: [] for name in read}
        self._readers = {}
        for name, numbers in read.items():
            topic = sources[numbers[0]]
            depth = max(_DEPTH, math.ceil(2.0 * topic.rate_hz * len(numbers))) if topic.group != "large" else _DEPTH
            message = class_of(topic.type_name)
            self._readers[name] = node.create_subscription(
                message, name, lambda _sample: None, _qos(topic, depth), raw=True
            )

    def unmatched(self) -> list[str]:
        return [name for name, reader in self._readers.items() if not reader.get_publisher_count()]

    def take(self) -> None:
        for name, reader in self._readers.items():
            for sample, _ in taken(reader):
                now_ns = time.monotonic_ns()
                source, number, sent_ns = self._first[name].read(sample)
                template = self._templates.get(source)
                is_whole = template is not None and template.is_whole(sample, number)
                self.arrivals[name].append((source, number, sent_ns, now_ns, is_whole))


class MapCaller:
    """Calls for the map, and notes when each call began and how long it took (s)."""

    def __init__(self, node: Any) -> None:
        from nav_msgs.srv import GetMap

        self._request = GetMap.Request
        self._client = node.create_client(GetMap, MAP_SERVICE)
        self._next_s = self._until_s = math.inf
        self.calls: list[dict[str, float | None]] = []

    def is_ready(self) -> bool:
        return bool(self._client.service_is_ready())

    def begin(self, from_s: float, until_s: float) -> None:
        self._next_s, self._until_s = from_s + 1.0, until_s

    def step(self) -> None:
        """Call when it is time, one call after the other."""
        now_s = time.monotonic()
        is_waiting = bool(self.calls) and self.calls[-1]["took_s"] is None
        if now_s < self._next_s or now_s >= self._until_s or is_waiting:
            return
        self._next_s += CALL_EVERY_S
        noted: dict[str, float | None] = {"begun_s": now_s, "took_s": None, "bytes": None}
        self.calls.append(noted)

        def note(future: Any) -> None:
            noted["took_s"] = time.monotonic() - now_s
            noted["bytes"] = len(future.result().map.data)

        self._client.call_async(self._request()).add_done_callback(note)


def _serve_map(node: Any) -> None:
    from nav_msgs.srv import GetMap

    answered = GetMap.Response()
    answered.map.data = array("b", bytes(MAP_BYTES))
    node.create_service(GetMap, MAP_SERVICE, lambda _request, _response: answered)


class Process:
    """What one process does."""

    def __init__(self, robot: str, name: str, *, is_adaptive: bool, stack: ExitStack) -> None:
        from rclpy.executors import SingleThreadedExecutor

        from arpd.adapters.ros.runtime import spinning

        self._node, self._is_adaptive = plain_node(name), is_adaptive
        self._nodes = [self._node]
        sources = sources_of(robot)
        self.talker = Talker([(k, topic) for k, topic in enumerate(sources) if topic.node == name], self._create)
        read: dict[str, list[int]] = {}
        for k, topic in enumerate(sources):
            if name == (ROBOT_SINK if topic.node == BASE else BASE_SINK):
                read.setdefault(topic.name, []).append(k)
        self.listener = Listener(self._node, read, sources)
        self.caller = MapCaller(self._node) if name == CALLER else None
        self._poll_s = _POLL_S if read else _REST_S
        if robot in CALLED and name == MAP_SERVER:
            _serve_map(self._node)
        # An executor in a process of readers would take their samples.
        if (is_adaptive and not read) or name in {CALLER, MAP_SERVER}:
            executor = SingleThreadedExecutor()
            for node in self._nodes:
                executor.add_node(node)
            stack.enter_context(spinning(executor))

    def _create(self, topic: Topic) -> Any:
        """Return a publisher, each of a topic in a node of its own."""
        from rclpy import create_node

        node = self._node
        if topic.publishers > 1:
            node = create_node(f"{topic.node}_{len(self._nodes)}")
            self._nodes.append(node)
        create = node.create_publisher
        if self._is_adaptive:
            from arpd import AdaptivePublisher

            create = partial(AdaptivePublisher, node)
        return create(class_of(topic.type_name), topic.name, _qos(topic, _DEPTH))

    def turn(self) -> float:
        """Publish what is due, take what has arrived, call when it is time; return the time until the next turn (s)."""
        wait_s = self.talker.publish_due()
        self.listener.take()
        if self.caller is not None:
            self.caller.step()
        return min(wait_s, self._poll_s)

    def answer(self, order: dict[str, Any]) -> dict[str, Any]:
        """Do what the parent says, and return the answer."""
        match order["do"]:
            case "matched":
                unmatched = self.listener.unmatched()
                if self.caller is not None and not self.caller.is_ready():
                    unmatched.append(MAP_SERVICE)
                return {"unmatched": unmatched, "is_read": self.talker.is_read()}
            case "begin":
                self.talker.begin(order["begin_s"], order["from_s"], order["until_s"])
                if self.caller is not None:
                    self.caller.begin(order["from_s"], order["until_s"])
                return {"begun": True}
        calls = [] if self.caller is None else self.caller.calls
        return {**self.talker.document(), "arrivals": self.listener.arrivals, "calls": calls}


def live(robot: str, name: str, *, is_adaptive: bool) -> None:
    """Publish and read as the parent says, until it is gone."""
    with ExitStack() as stack:
        process = Process(robot, name, is_adaptive=is_adaptive, stack=stack)
        serve(process.turn, process.answer)


if __name__ == "__main__":
    live(sys.argv[1], sys.argv[2], is_adaptive=sys.argv[3].startswith("adaptive"))
