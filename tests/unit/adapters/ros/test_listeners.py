"""Messages from the network: read without decoding, and refused without harm."""

from contextlib import suppress
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message

from arpd.adapters.ros import listeners
from arpd.adapters.ros.announcement import to_status
from arpd.adapters.ros.raw_reader import Sample
from arpd.adapters.ros.refused_messages import RefusedMessages
from arpd.adapters.ros.serialized import octets, peek
from arpd.model.observation import MessageKind, MessageRefusal
from arpd.observe.registry import MOST_OF_NODE
from tests.examples import examples
from tests.sample_publishers import publisher


def serialized(*statuses):
    return serialize_message(DiagnosticArray(status=list(statuses)))


ANNOUNCEMENT = serialized(*(to_status(publisher("/n", topic)) for topic in ("/a", "/b")))


class World:
    """Announcements of publishers without a network, and a stopped clock."""

    def __init__(self):
        self.now_s = 0.0
        self.refused = RefusedMessages(clock=lambda: self.now_s)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(listeners, "RawReader", self.reader)
            self.heard = listeners.Announcements(None, thread=None, refused=self.refused, clock=lambda: self.now_s)

    def reader(self, *_arguments, deliver, **_options):
        self._deliver = deliver
        return SimpleNamespace(flooded_until_s=0.0)

    def hear(self, data):
        self._deliver(Sample(data, b"writer", 0))

    def see(self, *nodes):
        self.heard.see(frozenset(nodes), lambda _node, _topic: True)

    def topics(self):
        return [state.topic for state in self.heard.live(self.now_s)]


@given(st.binary(max_size=60), st.lists(st.tuples(st.integers(0, 10**4), st.integers(0, 255)), max_size=6), st.data())
@examples(50)
def test_any_bytes_are_refused_or_read(noise, spoils, data):
    """Any bytes are refused or read, and nothing is raised."""
    spoilt = bytearray(ANNOUNCEMENT[: data.draw(st.integers(0, len(ANNOUNCEMENT)))])
    for index, value in spoils:
        if spoilt:
            spoilt[index % len(spoilt)] = value
    for read in (peek, octets):
        for each in (noise, bytes(spoilt)):
            with suppress(ValueError):
                read(each)
    world = World()
    world.see("/n", "")
    world.hear(bytes(spoilt))
    world.hear(noise)
    assert all(state.node and state.topic for state in world.heard.live(0.0))


def test_a_node_speaks_for_itself_at_its_own_rate():
    """A node cannot announce another's publishers, too many of them, or too often."""
    world = World()
    world.see("/n", "/m")
    world.hear(serialized(to_status(publisher("/n", "/a")), to_status(publisher("/m", "/b"))))
    assert world.topics() == ["/a"]
    world.hear(serialized(*[to_status(publisher("/n", "/c"))] * (MOST_OF_NODE + 1)))
    for _ in range(1000):
        world.hear(ANNOUNCEMENT)
    world.hear(serialized(to_status(publisher("/m", "/b"))))
    assert "/b" in world.topics()
    counts = world.refused.counts
    assert (
        counts[MessageKind.PUBLISHERS, MessageRefusal.MALFORMED]
        == counts[MessageKind.PUBLISHERS, MessageRefusal.QUOTA]
        == 1
    )
    assert counts[MessageKind.PUBLISHERS, MessageRefusal.RATE] > 980
