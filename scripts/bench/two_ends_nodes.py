"""The nodes of `two_ends.py`, one process on each host: plain rclpy with numbered samples, and readers of them.

The parent speaks to each in lines of JSON (`scripts.bench.child`).
"""

from __future__ import annotations

import heapq
import struct
import sys
import time
from dataclasses import dataclass, field
from typing import Any

from scripts.bench.child import number_of, sample_of, serve
from scripts.bench.node import plain_node, taken
from scripts.bench.reliability_nodes import Arrivals

OWN_PER_WRITER = 10**8  # numbers of one writer of a topic: a sample has writer * OWN_PER_WRITER + number
SET_TOPICS = ("/left/image", "/left/camera_info", "/right/image")
SET_RATE_HZ = 10.0
LATCHED, DEMAND = "/robot_description", "/on_demand"
_IMAGE_BYTES = 10_000
_READER_DEPTH = 2000
_POLL_S = 0.004
VISIT_S = 15.0  # a reader that has nothing by then gives up
_NANOSECONDS = 10**9


@dataclass(frozen=True, kw_only=True, slots=True)
class Stream:
    """One writer of a topic of std_msgs/String.

    Parameters
    ----------
    host : where the writer lives, ``robot`` or ``ceddp``
    writer : tells the writers of one topic apart
    is_paced : whether arpd may thin the topic; the configuration gives the others a rate above their own
    """

    topic: str
    host: str
    rate_hz: float
    payload_bytes: int
    writer: int = 0
    is_paced: bool = True
    is_latched: bool = False

    @property
    def name(self) -> str:
        """Name in tables and documents."""
        return f"{self.topic} {self.host} {self.writer}"


STREAMS = (
    Stream(topic="/imu", host="robot", rate_hz=50.0, payload_bytes=200, is_paced=False),
    Stream(topic="/scan", host="robot", rate_hz=10.0, payload_bytes=2_000),
    Stream(topic="/points", host="robot", rate_hz=10.0, payload_bytes=30_000),
    Stream(topic="/tf", host="robot", rate_hz=20.0, payload_bytes=100, writer=0, is_paced=False),
    Stream(topic="/tf", host="robot", rate_hz=20.0, payload_bytes=100, writer=1, is_paced=False),
    Stream(topic="/tf", host="ceddp", rate_hz=20.0, payload_bytes=100, writer=2, is_paced=False),
    Stream(topic="/cmd_vel", host="ceddp", rate_hz=20.0, payload_bytes=76, is_paced=False),
)
#: Nobody counts these: one is read from time to time, the other one is latched.
OTHERS = (
    Stream(topic=DEMAND, host="robot", rate_hz=20.0, payload_bytes=500),
    Stream(topic=LATCHED, host="robot", rate_hz=0.2, payload_bytes=1_000, writer=0, is_latched=True),
    Stream(topic=LATCHED, host="robot", rate_hz=0.05, payload_bytes=1_000, writer=1, is_latched=True),
)


def number_with(writer: int, number: int) -> int:
    """Return the number that a sample carries."""
    return writer * OWN_PER_WRITER + number


def spans(numbers: set[int]) -> list[list[int]]:
    """Return the numbers as spans, first and last of each."""
    found: list[list[int]] = []
    for number in sorted(numbers):
        if found and number == found[-1][1] + 1:
            found[-1][1] = number
        else:
            found.append([number, number])
    return found


def _latched_qos(depth: int) -> Any:
    from rclpy.qos import QoSDurabilityPolicy, QoSProfile

    return QoSProfile(depth=depth, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


class Talker:
    """Publishes on time, and keeps the times."""

    def __init__(self, node: Any, streams: list[Stream], *, has_sets: bool) -> None:
        from std_msgs.msg import String

        self.sent_s: dict[str, list[float]] = {stream.name: [] for stream in streams}
        self.sets_s: list[float] = []
        self._streams = streams
        self._publishers = [
            node.create_publisher(String, stream.topic, _latched_qos(1) if stream.is_latched else 100)
            for stream in streams
        ]
        self._set_publishers = _set_publishers(node) if has_sets else []
        self._due: list[tuple[float, int]] = []

    def is_read(self) -> bool:
        """Return whether every counted writer has a reader."""
        counted = [k for k, stream in enumerate(self._streams) if stream in STREAMS]
        publishers = [*(self._publishers[k] for k in counted), *(each for each, _ in self._set_publishers)]
        return all(publisher.get_subscription_count() for publisher in publishers)

    def begin(self) -> None:
        now_s = time.monotonic()
        self._due = [(now_s + 0.01 * k, k) for k in range(len(self._streams) + bool(self._set_publishers))]
        heapq.heapify(self._due)

    def end(self) -> None:
        self._due = []

    def publish_due(self) -> float:
        """Publish what is due; return the time until the next (s)."""
        while self._due and self._due[0][0] <= time.monotonic():
            due_s, k = heapq.heappop(self._due)
            heapq.heappush(self._due, (due_s + 1.0 / self._publish(k), k))
        return max(0.0, self._due[0][0] - time.monotonic()) if self._due else _POLL_S

    def _publish(self, k: int) -> float:
        """Publish one sample or set; return its rate (Hz)."""
        if k == len(self._streams):
            number = len(self.sets_s)
            self.sets_s.append(time.monotonic())
            for publisher, template in self._set_publishers:
                publisher.publish(stamped(template, number))
            return SET_RATE_HZ
        stream = self._streams[k]
        sent_s = self.sent_s[stream.name]
        sample = sample_of(number_with(stream.writer, len(sent_s)), stream.payload_bytes)
        sent_s.append(time.monotonic())
        self._publishers[k].publish(sample)
        return stream.rate_hz


def _set_publishers(node: Any) -> list[tuple[Any, bytes]]:
    from array import array

    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import CameraInfo, Image

    image = Image(height=100, width=100, step=100, encoding="mono8", data=array("B", bytes(_IMAGE_BYTES)))
    return [
        (
            node.create_publisher(CameraInfo if "info" in topic else Image, topic, 100),
            bytes(serialize_message(CameraInfo() if "info" in topic else image)),
        )
        for topic in SET_TOPICS
    ]


def stamped(sample: bytes, number: int) -> bytes:
    """Return a serialized message with a header whose stamp says the number of its set."""
    stamp = struct.pack("<iI", *divmod(number * _NANOSECONDS // int(SET_RATE_HZ), _NANOSECONDS))
    return sample[:4] + stamp + sample[12:]


def set_number_of(sample: bytes) -> int:
    """Return the number of the set, from the header stamp."""
    seconds, nanoseconds = struct.unpack_from("<iI", sample, 4)
    return int((seconds * _NANOSECONDS + nanoseconds) * int(SET_RATE_HZ) // _NANOSECONDS)


class Listener:
    """Notes what arrives from the other host."""

    def __init__(self, node: Any, streams: list[Stream], *, has_sets: bool) -> None:
        from sensor_msgs.msg import CameraInfo, Image
        from std_msgs.msg import String

        self._arrivals = {stream.name: Arrivals() for stream in streams}
        self._of = {(stream.topic, stream.writer): self._arrivals[stream.name] for stream in streams}
        self._sets = {topic: Arrivals() for topic in SET_TOPICS} if has_sets else {}
        self._readers = {
            topic: node.create_subscription(String, topic, _ignore, _READER_DEPTH, raw=True)
            for topic in dict.fromkeys(stream.topic for stream in streams)
        }
        self._set_readers = {
            topic: node.create_subscription(
                CameraInfo if "info" in topic else Image, topic, _ignore, _READER_DEPTH, raw=True
            )
            for topic in self._sets
        }

    def matched(self) -> bool:
        """Return whether every reader has a writer."""
        return all(reader.get_publisher_count() for reader in (*self._readers.values(), *self._set_readers.values()))

    def take(self) -> None:
        for topic, reader in self._readers.items():
            for sample, _ in taken(reader):
                writer, number = divmod(number_of(sample), OWN_PER_WRITER)
                if (arrivals := self._of.get((topic, writer))) is not None:
                    arrivals.note(number, time.monotonic())
        for topic, reader in self._set_readers.items():
            for sample, _ in taken(reader):
                self._sets[topic].note(set_number_of(sample), time.monotonic())

    def newest(self) -> dict[str, int]:
        """Return the highest number of each stream so far."""
        return {name: arrivals.highest for name, arrivals in self._arrivals.items()}

    def document(self) -> dict[str, Any]:
        return {
            "streams": {name: _document(arrivals) for name, arrivals in self._arrivals.items()},
            "sets": {topic: _document(arrivals) for topic, arrivals in self._sets.items()},
        }


def _document(arrivals: Arrivals) -> dict[str, Any]:
    return {"spans": spans(arrivals.numbers), "doubled": arrivals.doubled, "late": arrivals.late}


def _ignore(_sample: Any) -> None:
    """Do nothing: `taken` takes the samples."""


@dataclass(slots=True)
class Visit:
    """A reader that comes, and goes after its first samples."""

    reader: Any
    at_s: float
    first_s: float | None = None
    first_number: int = -1
    newest: dict[int, list[float]] = field(default_factory=dict)  # by writer: number, time of arrival


class Visitors:
    """Let readers of one topic come and go, one at a time.

    Parameters
    ----------
    every_s : time between two of them
    stays_s : time that each stays after its first sample
    qos : of the readers
    """

    def __init__(self, node: Any, topic: str, qos: Any, *, every_s: float, first_s: float, stays_s: float) -> None:
        self._node, self._topic, self._qos = node, topic, qos
        self._every_s, self._stays_s = every_s, stays_s
        self._next_s = first_s
        self._visit: Visit | None = None
        self.visits: list[dict[str, Any]] = []

    def step(self, now_s: float) -> None:
        from std_msgs.msg import String

        if self._visit is None:
            if now_s >= self._next_s:
                self._next_s = now_s + self._every_s
                reader = self._node.create_subscription(String, self._topic, _ignore, self._qos, raw=True)
                self._visit = Visit(reader, now_s)
            return
        visit = self._visit
        for sample, _ in taken(visit.reader):
            writer, number = divmod(number_of(sample), OWN_PER_WRITER)
            visit.newest.setdefault(writer, [number, now_s])
            if number > visit.newest[writer][0]:
                visit.newest[writer] = [number, now_s]
            if visit.first_s is None:
                visit.first_s, visit.first_number = now_s, number
        until_s = visit.at_s + VISIT_S if visit.first_s is None else visit.first_s + self._stays_s
        if now_s >= until_s:
            self._node.destroy_subscription(visit.reader)
            noted = {"at_s": visit.at_s, "first_s": visit.first_s, "first_number": visit.first_number}
            self.visits.append({**noted, "newest": visit.newest})
            self._visit = None


class Side:
    """Everything on one host: what talks, what listens, and the readers that come and go."""

    def __init__(self, host: str, demand_every_s: float, latched_every_s: float) -> None:
        is_robot = host == "robot"
        self._is_robot = is_robot
        self._every_s = demand_every_s, latched_every_s
        self._node = plain_node(f"nodes_{host}")
        own = [stream for stream in (*STREAMS, *OTHERS) if stream.host == host]
        self.talker = Talker(self._node, own, has_sets=is_robot)
        others = [stream for stream in STREAMS if stream.host != host]
        self._listener = Listener(self._node, others, has_sets=not is_robot)
        self._visitors: list[Visitors] = []
        self._are_visiting = False  # only while the writers publish

    def turn(self) -> float:
        """Publish what is due, and take what has arrived; return the time until the next turn (s)."""
        wait_s = self.talker.publish_due()
        self._listener.take()
        if self._are_visiting:
            for each in self._visitors:
                each.step(time.monotonic())
        return min(wait_s, _POLL_S)

    def answer(self, question: str) -> dict[str, Any]:
        """Do what the parent says, and return the answer."""
        match question:
            case "matched":
                return {"matched": self._listener.matched() and self.talker.is_read()}
            case "begin":
                self.talker.begin()
                if not self._is_robot:
                    self._visitors = self._begun_visitors()
                    self._are_visiting = True
                return {"begun": True}
            case "newest":
                return {"newest": self._listener.newest()}
            case "end":
                self.talker.end()
                self._are_visiting = False
                return {"sent_s": self.talker.sent_s, "sets_s": self.talker.sets_s}
        demand, latched = [each.visits for each in self._visitors] or ([], [])
        return {**self._listener.document(), "demand": demand, "latched": latched}

    def _begun_visitors(self) -> list[Visitors]:
        from rclpy.qos import QoSProfile

        readers = ((DEMAND, QoSProfile(depth=10), 1.0), (LATCHED, _latched_qos(100), 5.0))
        now_s = time.monotonic()
        return [
            Visitors(self._node, topic, qos, every_s=every_s, first_s=now_s + every_s / 2, stays_s=stays_s)
            for (topic, qos, stays_s), every_s in zip(readers, self._every_s, strict=True)
        ]


def live(host: str, demand_every_s: float, latched_every_s: float) -> None:
    """Publish this host's streams and read the other's, as the parent says."""
    side = Side(host, demand_every_s, latched_every_s)
    serve(side.turn, lambda order: side.answer(order["do"]))


if __name__ == "__main__":
    live(sys.argv[1], float(sys.argv[2]), float(sys.argv[3]))
