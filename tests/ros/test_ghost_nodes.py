"""Ghost nodes that two threads use at once, and ghost writers that are swapped, on real rclpy."""

import math
import threading
import time

import pytest
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSLivelinessPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from arpd.model.endpoints import WriterQos
from arpd.relay.ends.ghosts import GhostNodes, GhostWriter
from arpd.relay.ends.offers import WriterOffer
from arpd.relay.envelope import Record
from arpd.ros.graph import period_ns

TOPIC = "/ghostly"
MS = 1_000_000


def test_a_ghost_lasts_as_long_as_it_has_an_endpoint(ros, eventually):
    """Two writers of one node share its ghost, which goes with the last of them; without a name the end stands in."""
    end, looker = ros.node("end"), ros.node("looker")
    nodes = GhostNodes(end)

    def made(node):
        return node, node.create_publisher(String, TOPIC, 1)

    first, second = nodes.give("/sensor", made), nodes.give("/sensor", made)
    assert first[0] is second[0] is not end
    first[0].destroy_publisher(first[1])
    nodes.tidy()
    eventually("the ghost shows", lambda: "sensor" in looker.get_node_names())
    second[0].destroy_publisher(second[1])
    nodes.tidy()
    eventually("the ghost is gone", lambda: "sensor" not in looker.get_node_names())
    assert nodes.give("/9 lives", lambda node: node) is end


class Ghost:
    """A ghost writer that is stepped ten times a second, and writes a hundred samples in that time if it is told to."""

    def __init__(self, node, **offer):
        about = WriterOffer(node="", gid="", **offer)
        self.writer = GhostWriter(node, String, TOPIC, about, depth=10, most_held_bytes=1000)
        self.node, self.written, self.is_writing = node, 0, False
        self.is_reachable, self.digits = True, 1
        self.lock = threading.Lock()  # as that of `Incoming`

    def write(self, stopping):
        while not stopping.wait(0.01):
            with self.lock:
                if self.is_writing:
                    self.written += 1
                    sample = serialize_message(String(data=str(self.written).zfill(self.digits)))
                    self.writer.write(Record(b"", self.written, sample))

    def step(self, stopping):
        while not stopping.wait(0.1):
            with self.lock:
                if time.monotonic() >= self.writer.due_s:
                    self.writer.swap()
                self.writer.step(is_reachable=self.is_reachable)

    def plan(self, **planned):
        with self.lock:
            self.writer.follow(self.writer.offer, WriterQos(**planned))

    @property
    def qos(self):
        return self.writer._swap.qos

    @property
    def is_busy(self):
        return self.writer._swap.is_busy

    @property
    def deadlines(self):
        return [period_ns(info.qos_profile.deadline) for info in self.node.get_publishers_info_by_topic(TOPIC)]


@pytest.fixture
def ghost(ros, background):
    def make(**offer):
        ghost = Ghost(ros.node("ghost"), **offer)
        background(ghost.write)
        background(ghost.step)
        return ghost

    return make


@pytest.fixture
def listen(ros):
    def listen(name, **qos):
        received = []
        profile = QoSProfile(depth=1000, **qos)
        reader = ros.node(name).create_subscription(
            String, TOPIC, lambda message: received.append(int(message.data)), profile
        )
        return reader, received

    return listen


def test_a_ghost_of_large_samples_holds_few_of_them(ghost, listen, eventually):
    """Where its depth of them is too much memory, it is swapped for a smaller one, and no sample is lost meanwhile."""
    ghost, (reader, received) = ghost(), listen("reader")
    eventually("the reader finds the ghost", reader.get_publisher_count)
    eventually("the ghost finds the reader", ghost.writer.matched)
    ghost.is_writing = True
    eventually("small samples arrive", lambda: received)
    assert ghost.qos.depth == 10
    ghost.digits = 400
    eventually("the depth is smaller", lambda: ghost.qos.depth == 2)
    eventually("the swap is over", lambda: not ghost.is_busy)
    ghost.is_writing = False
    eventually("the last sample arrives", lambda: received[-1] == ghost.written)
    assert received == list(range(1, ghost.written + 1))


def test_a_ghost_offers_no_longer_deadline_than_its_original_and_its_readers_allow(ghost, listen, eventually):
    """A plan of a longer deadline loses no reader that the ghost serves, and one that it never served has no say."""
    ghost = ghost(deadline_ns=300 * MS)
    listen("demanding", deadline=Duration(nanoseconds=MS))
    ghost.plan(depth=20, deadline_ns=400 * MS)
    eventually("the new depth is in force", lambda: ghost.qos == WriterQos(depth=20, deadline_ns=300 * MS))
    ghost.plan(depth=20, deadline_ns=100 * MS)
    eventually("the plan alone is offered", lambda: ghost.deadlines == [100 * MS])
    _, received = listen("served", deadline=Duration(nanoseconds=150 * MS))
    eventually("the reader matches", lambda: ghost.writer.matched() == 1)
    eventually("the graph shows its request", lambda: len(ghost.writer._requests.names()) == 2)
    ghost.plan(depth=30, deadline_ns=200 * MS)
    eventually("the deadline stays", lambda: ghost.qos == WriterQos(depth=30, deadline_ns=100 * MS))
    ghost.is_writing = True
    eventually("the reader hears it", lambda: received)


def test_a_latched_ghost_is_never_swapped(ghost):
    """A plan does not touch a latched ghost, neither a new one nor one that is there."""
    ghost = ghost(is_latched=True)
    ghost.plan(depth=20, deadline_ns=100 * MS)
    assert ghost.writer.due_s == math.inf
    ghost.plan(depth=0, deadline_ns=0)
    assert ghost.qos == WriterQos(depth=10, deadline_ns=0)


def test_a_ghost_whose_end_is_unreachable_is_not_alive(ros, ghost, eventually):
    """Nobody knows whether an original still lives whose end is silent, so its ghost asserts nothing."""
    far, alive = ros.node("far"), []
    profile = QoSProfile(
        depth=10,
        liveliness=QoSLivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(seconds=1),
    )
    callbacks = SubscriptionEventCallbacks(liveliness=lambda event: alive.append(event.alive_count))
    far.create_subscription(String, TOPIC, lambda _message: None, profile, event_callbacks=callbacks)
    writer = ghost(is_manual=True, is_alive=True, lease_ns=1000 * MS)
    eventually("the ghost lives", lambda: alive and alive[-1] == 1)
    writer.is_reachable = False
    eventually("the ghost lives no more", lambda: alive[-1] == 0)
