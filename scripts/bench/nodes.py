"""The processes around arpd: sources, sinks, a service and its caller, in plain rclpy or with AdaptivePublishers.

Usage: python -m scripts.bench.nodes WORLD.json NAME      (`scripts.bench.world.World` writes the file)
       python -m scripts.bench.nodes bare WORLD.json      a relay in ten lines of rclpy
       python -m scripts.bench.nodes crowd FIRST COUNT    so many idle nodes, each with a participant of its own

The parent speaks to each in lines of JSON (`scripts.bench.child`).
"""

from __future__ import annotations

import heapq
import json
import math
import sys
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scripts.bench.child import serve
from scripts.bench.samples import BASE, Template, Topic, class_of, sources_of
from scripts.bench.sides import BARE, Service, Way

if TYPE_CHECKING:
    from collections.abc import Iterator

ROBOT_SINK, BASE_SINK, CALLER = "robot_sink", "base_sink", "caller"  # the other processes have their node's name
CROWD = "/crowd_"
TOPICS_PER_NODE = 2  # of the crowd
_KEPT_DEPTH = 1000  # longer than any outage
_POLL_S, _REST_S = 0.002, 0.05
_LOOK_S = 50e-6  # per topic, so that a thousand empty readers leave most of a core to others
_APART_S = 0.0037  # no two processes of a robot tick together
_MOST_NOTED = 2000  # arrivals of a topic in a run without an end
_LATE_S = 0.1  # a timer that is later, and later than its period, leaves out ticks
_SWAP_DEPTHS = (11, 10)


def plain_node(name: str) -> Any:
    """Start rclpy and return a node."""
    import rclpy

    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    return rclpy.create_node(name)


def taken(subscription: Any, made: Any) -> Iterator[tuple[bytes, dict[str, int]]]:
    """Take all there is, as an executor would, without its cost; yield each serialized sample and its information."""
    handle = subscription.handle
    with handle:
        while (found := handle.take_message(made, True)) is not None:  # noqa: FBT003 - rclpy's own signature
            yield found


def qos_of(topic: Topic, depth: int) -> Any:
    from rclpy.duration import Duration
    from rclpy.qos import QoSDurabilityPolicy, QoSProfile

    if topic.is_latched:
        return QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    qos = QoSProfile(depth=depth)
    if topic.deadline_hz:
        qos.deadline = Duration(nanoseconds=round(1e9 / topic.deadline_hz))
    return qos


def created(node: Any, topic: Topic, way: Way) -> Any:
    """Return a publisher."""
    qos = qos_of(topic, _KEPT_DEPTH if topic.is_kept else topic.depth)
    made = class_of(topic.type_name)
    if not way.is_adaptive:
        return node.create_publisher(made, topic.name, qos)
    from arpd import AdaptivePublisher
    from arpd.model.endpoints import Overflow

    if topic.is_kept:
        return AdaptivePublisher(node, made, topic.name, qos, overflow=Overflow.QUEUE)
    return AdaptivePublisher(node, made, topic.name, qos)


@dataclass(slots=True)
class Source:
    """One publisher, the numbers of the samples that count, and when each sample was published (monotonic s)."""

    topic: Topic
    template: Template
    publisher: Any
    number: int = -1  # of the last tick
    first: int | None = None
    published: int = 0  # of those that count
    sent: list[tuple[int, float]] = field(default_factory=list)


class Talker:
    """Publishes on time, as timers of one executor do: late after a write that blocked, and then not twice."""

    def __init__(self, node: Any, numbered: list[tuple[int, Topic]], way: Way) -> None:
        self._node, self._way = node, way
        self._nodes = [node]
        self.sources = {
            number: Source(
                topic=topic, template=Template(topic, number), publisher=created(self._place(topic), topic, way)
            )
            for number, topic in numbered
        }
        self._due: list[tuple[float, int]] = []
        self._from_s = self._until_s = math.inf
        self._swaps, self._swap_s = 0, math.inf

    def _place(self, topic: Topic) -> Any:
        """Return the node, for each publisher of a topic with several another one."""
        from rclpy import create_node

        if topic.publishers > 1:
            self._nodes.append(create_node(f"{topic.node}_{len(self._nodes)}"))
        return self._nodes[-1] if topic.publishers > 1 else self._node

    def is_read(self) -> bool:
        return all(source.publisher.get_subscription_count() for source in self.sources.values())

    def begin(self, begin_s: float, from_s: float, until_s: float) -> None:
        """Publish from one time to another, and count from a time between (monotonic s)."""
        self._from_s, self._until_s = from_s, until_s
        begin_s += _APART_S * min(self.sources, default=0)
        count = len(self.sources)
        apart = [
            (k / count / source.topic.rate_hz if count > 20 else 0.0) for k, source in enumerate(self.sources.values())
        ]
        self._due = [(begin_s + late_s, number) for late_s, number in zip(apart, self.sources, strict=True)]
        heapq.heapify(self._due)
        self._swap_s = from_s if self._way.swap else math.inf

    def publish_due(self) -> float:
        """Publish what is due; return the time until the next (s)."""
        now_s = time.monotonic()
        if self._swap_s <= now_s < self._until_s - self._way.swap_every_s:
            self._swap_s += self._way.swap_every_s
            self._swap()
        while self._due and self._due[0][0] <= now_s:
            due_s, number = heapq.heappop(self._due)
            if due_s >= self._until_s:
                continue
            source = self.sources[number]
            period_s = source.topic.period_s
            ticks = 1 if now_s - due_s <= max(period_s, _LATE_S) else 1 + math.floor((now_s - due_s) / period_s)
            source.number += source.topic.burst * (ticks - 1)
            due_s += (ticks - 1) * period_s
            heapq.heappush(self._due, (due_s + period_s, number))
            for _ in range(source.topic.burst):
                self._publish(source, due_s, now_s)
        return max(0.0, self._due[0][0] - time.monotonic()) if self._due else _REST_S

    def _publish(self, source: Source, due_s: float, now_s: float) -> None:
        source.number += 1
        if not source.topic.passes(source.number):
            return
        if due_s >= self._from_s:
            source.first = source.number if source.first is None else source.first
            source.published += 1
        if self._until_s < math.inf:
            source.sent.append((source.number, now_s))
        source.publisher.publish(source.template.sample(source.number))

    def _swap(self) -> None:
        """Give every publisher another DEPTH."""
        depth = _SWAP_DEPTHS[self._swaps % 2]
        self._swaps += 1
        for source in self.sources.values():
            if self._way.swap == "retune":
                source.publisher.retune(replace(source.publisher.plan, depth=source.topic.depth - 10 + depth))
            else:
                self._node.destroy_publisher(source.publisher)
                topic = replace(source.topic, depth=source.topic.depth - 10 + depth)
                source.publisher = created(self._node, topic, self._way)

    def document(self) -> dict[str, Any]:
        noted = {
            number: {"first": each.first, "published": each.published, "sent": each.sent}
            for number, each in self.sources.items()
        }
        return {"sources": noted, "swaps": self._swaps * len(self.sources)}


class Listener:
    """Notes what arrives: source, number, times of publishing and arrival (ns), whether it is whole.

    Parameters
    ----------
    read : numbers of the sources of each topic that this process reads
    echo : a topic on which samples are sent back; None = there is none
    """

    def __init__(
        self, node: Any, read: dict[str, list[int]], sources: list[Topic], way: Way, echo: Topic | None
    ) -> None:
        self._templates = {number: Template(sources[number]) for numbers in read.values() for number in numbers}
        self._first = {name: self._templates[numbers[0]] for name, numbers in read.items()}
        self.arrivals: dict[str, list[tuple[int, int, int, int, bool]]] = {name: [] for name in read}
        self.writers = dict.fromkeys(read, 0)
        self.is_endless = False
        self._echo = None if echo is None else (echo.answers, Template(echo), created(node, echo, way))
        self._readers = {}
        for name, numbers in read.items():
            topic = sources[numbers[0]]
            fast = math.ceil(2.0 * topic.rate_hz * len(numbers))
            depth = max(_KEPT_DEPTH if topic.is_kept else 10, fast if topic.group != "large" else 10)
            prefix = "" if topic.node == BASE else way.prefix
            made = class_of(topic.type_name)
            reader = node.create_subscription(made, prefix + name, lambda _sample: None, qos_of(topic, depth), raw=True)
            self._readers[name] = reader, made, topic.answers

    def unmatched(self) -> list[str]:
        return [name for name, (reader, *_) in self._readers.items() if not reader.get_publisher_count()]

    def take(self) -> None:
        for name, (reader, made, answers) in self._readers.items():
            for sample, about in taken(reader, made):
                now_ns = time.monotonic_ns()
                source, number, sent_ns = self._first[name].read(sample)
                template = self._templates.get(source)
                is_whole = answers > 0 or (template is not None and template.is_whole(sample, number))
                self.arrivals[name].append((source, number, sent_ns, now_ns, is_whole))
                self.writers[name] += about["publication_sequence_number"] == 1
                if self.is_endless and len(self.arrivals[name]) > _MOST_NOTED:
                    del self.arrivals[name][: _MOST_NOTED // 2]
                if self._echo is not None and number % self._echo[0] == source:
                    self._echo[2].publish(self._echo[1].tagged(source, number, sent_ns))


class Caller:
    """Calls one after the other, and notes when each began, its answers, and how long the first one took (s)."""

    def __init__(self, node: Any, service: Service) -> None:
        from test_msgs.srv import BasicTypes

        self._service, self._request = service, BasicTypes.Request
        self._client = node.create_client(BasicTypes, service.name)
        self._next_s = self._until_s = math.inf
        self.calls: list[dict[str, Any]] = []

    def is_ready(self) -> bool:
        return bool(self._client.service_is_ready())

    def begin(self, from_s: float, until_s: float) -> None:
        self._next_s, self._until_s = from_s + 1.0, until_s

    def step(self) -> None:
        now_s = time.monotonic()
        last = self.calls[-1] if self.calls else None
        if last and not last["answers"] and now_s - last["begun_s"] > self._service.fails_s:
            last["has_failed"] = True
        is_waiting = last is not None and not last["answers"] and not last["has_failed"]
        if now_s < self._next_s or now_s >= self._until_s or is_waiting:
            return
        self._next_s = max(self._next_s + self._service.every_s, now_s)
        noted: dict[str, Any] = {"begun_s": now_s, "took_s": None, "answers": 0, "has_failed": False, "is_wrong": False}
        number = len(self.calls)
        self.calls.append(noted)

        def note(future: Any) -> None:
            found = future.result()
            noted["took_s"] = noted["took_s"] or time.monotonic() - now_s
            noted["answers"] += 1
            noted["is_wrong"] |= found.int64_value != number or len(found.string_value) != self._service.answer_bytes

        self._client.call_async(self._request(int64_value=number)).add_done_callback(note)


def _serve_calls(node: Any, service: Service) -> Counter[int]:
    """Serve calls; return how often each ran."""
    from test_msgs.srv import BasicTypes

    ran: Counter[int] = Counter()
    text = "x" * service.answer_bytes

    def reply(request: Any, response: Any) -> Any:
        ran[request.int64_value] += 1
        response.int64_value, response.string_value = request.int64_value, text
        return response

    node.create_service(BasicTypes, service.name, reply)
    return ran


class Process:
    """What one process does."""

    def __init__(self, world: dict[str, Any], name: str, stack: ExitStack) -> None:
        topics = [Topic(**each) for each in world["topics"]]
        service = Service(**world["service"]) if world["service"] else None
        way, sources = Way(**world["way"]), sources_of(topics)
        node = plain_node(name)
        numbered = [(k, topic) for k, topic in enumerate(sources) if topic.node == name and not topic.answers]
        self.talker = Talker(node, numbered, way)
        read: dict[str, list[int]] = {}
        for k, topic in enumerate(sources):
            if name == (ROBOT_SINK if topic.node == BASE else BASE_SINK):
                read.setdefault(topic.name, []).append(k)
        echo = next((topic for topic in topics if topic.answers and name == BASE_SINK), None)
        self.listener = Listener(node, read, sources, way, echo)
        self.caller = Caller(node, service) if service and name == CALLER else None
        self.ran: Counter[int] = _serve_calls(node, service) if service and name == service.node else Counter()
        self._poll_s = max(_POLL_S, _LOOK_S * len(read)) if read else _REST_S
        if service and name in {CALLER, service.node}:
            # Only where nothing is read: an executor would take the samples.
            from rclpy.executors import SingleThreadedExecutor

            from scripts.bench.child import spinning

            executor = SingleThreadedExecutor()
            executor.add_node(node)
            stack.enter_context(spinning(executor))

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
                    unmatched.append("the service")
                return {"unmatched": unmatched, "is_read": self.talker.is_read()}
            case "begin":
                self.talker.begin(order["begin_s"], order["from_s"], order["until_s"])
                self.listener.is_endless = math.isinf(order["until_s"])
                if self.caller is not None:
                    self.caller.begin(order["from_s"], order["until_s"])
                return {"begun": True}
        calls = [] if self.caller is None else self.caller.calls
        arrived = {"arrivals": self.listener.arrivals, "writers": self.listener.writers}
        return {**self.talker.document(), **arrived, "calls": calls, "ran": self.ran}


def bare(world: dict[str, Any]) -> None:
    """Relay as ten lines of rclpy do, on the executor with the lowest cost per message."""
    import rclpy
    from rclpy.experimental import EventsExecutor

    node = plain_node("bare")
    for topic in (Topic(**each) for each in world["topics"]):
        made = class_of(topic.type_name)
        publisher = node.create_publisher(made, BARE + topic.name, 10)
        node.create_subscription(made, topic.name, publisher.publish, 100, raw=True)
    executor = EventsExecutor()
    executor.add_node(node)
    while rclpy.ok():
        executor.spin_once(timeout_sec=0.2)


def crowd(first: int, count: int) -> None:
    """Hold nodes, each with a participant of its own as a process has it; say how many of their topics are known."""
    import rclpy
    from std_msgs.msg import Float64, String

    kept = []
    for number in range(first, first + max(1, count)):
        context = rclpy.Context()
        rclpy.init(context=context, signal_handler_options=rclpy.SignalHandlerOptions.NO)
        node = rclpy.create_node(f"{CROWD.strip('/')}{number}", context=context)
        kinds = (("state", String), ("value", Float64)) if count else ()
        kept.append((node, [node.create_publisher(kind, f"{CROWD}{number}/{name}", 10) for name, kind in kinds]))

    def known(_order: dict[str, Any]) -> dict[str, Any]:
        return {"topics": sum(name.startswith(CROWD) for name, _ in kept[0][0].get_topic_names_and_types())}

    serve(lambda: 60.0, known)


def main() -> None:
    match sys.argv[1:]:
        case ["bare", path]:
            bare(json.loads(Path(path).read_text("utf-8")))
        case ["crowd", first, count]:
            crowd(int(first), int(count))
        case [path, name]:
            with ExitStack() as stack:
                process = Process(json.loads(Path(path).read_text("utf-8")), name, stack)
                serve(process.turn, process.answer)


if __name__ == "__main__":
    main()
