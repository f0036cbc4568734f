"""Messages from the network: read without decoding, and refused without harm."""

from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.exceptions import InvalidTopicNameException
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64, UInt8MultiArray

from arpd.adapters.ros.announcement import from_status, to_status
from arpd.adapters.ros.bounds import LEAST_DEADLINE_NS
from arpd.adapters.ros.counters import encode_counters, row_of
from arpd.adapters.ros.crossing import Crossing
from arpd.adapters.ros.graph import Graph, GraphReader
from arpd.adapters.ros.listeners import Announcements, CounterMessages
from arpd.adapters.ros.plan_message import PlanAnswer
from arpd.adapters.ros.raw_subscription import Pause, RawSubscription, RefusedMessages, octets, peek
from arpd.adapters.ros.rmw import rmw_of
from arpd.model.observation import MessageKind, MessageRefusal
from arpd.observe.registry import MOST_OF_NODE, Tag
from tests.sample_publishers import publisher

pytestmark = pytest.mark.ros


def serialized(*statuses, frame=""):
    message = DiagnosticArray(status=list(statuses))
    message.header.frame_id = frame
    return serialize_message(message)


ANNOUNCEMENT = serialized(*(to_status(publisher("/n", topic)) for topic in ("/a", "/b")))


class Node:
    """A node that keeps the callback of a subscription, and the messages that wait for it."""

    def __init__(self):
        self.waiting = []
        self.handle = self

    def create_subscription(self, _kind, _topic, callback, _qos, **_options):
        self.callback = lambda data: callback(data, {})
        return self

    def take_message(self, _kind, _raw):
        return (self.waiting.pop(0), None) if self.waiting else None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


class World:
    """Announcements of publishers without a network, and a stopped clock."""

    def __init__(self):
        self.node, self.now_s = Node(), 0.0
        self.refused = RefusedMessages(clock=lambda: self.now_s)
        self.heard = Announcements(
            self.node,
            "/t",
            MessageKind.PUBLISHERS,
            from_status,
            is_reliable=True,
            stale_s=3.5,
            refused=self.refused,
            clock=lambda: self.now_s,
            pause=Pause(),
        )

    def see(self, *nodes):
        self.heard.see(frozenset(nodes), lambda _node, _topic: True)

    def topics(self):
        return [state.topic for state in self.heard.live(self.now_s)]


TEXTS = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9)  # C's strings end at a zero


@given(st.lists(TEXTS, min_size=1, max_size=4), TEXTS)
@settings(max_examples=30, deadline=None)
def test_the_first_name_is_read_without_decoding(names, frame):
    """The first status's name and the number of statuses are read from the bytes, after any header."""
    statuses = [DiagnosticStatus(name=name, level=b"\2", values=[KeyValue(key="k", value="v")]) for name in names]
    assert peek(serialized(*statuses, frame=frame)) == (names[0], len(names))


@given(st.binary(max_size=100))
def test_the_bytes_of_an_array_are_read_without_decoding(data):
    """The content of a UInt8MultiArray is read from its bytes."""
    assert octets(serialize_message(UInt8MultiArray(data=data))) == data


@given(st.binary(max_size=60), st.lists(st.tuples(st.integers(0, 10**4), st.integers(0, 255)), max_size=6), st.data())
@settings(max_examples=50, deadline=None)
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
    world.node.callback(bytes(spoilt))
    world.node.callback(noise)
    assert all(state.node and state.topic for state in world.heard.live(0.0))


def test_a_node_waits_for_the_graph_and_is_heard_then():
    """A message that arrives before the graph shows its node is kept; one of an invented node is refused."""
    world = World()
    world.see()
    world.node.callback(ANNOUNCEMENT)
    world.node.callback(serialized(to_status(publisher("/invented", "/a"))))
    assert (world.topics(), world.heard.pending) == ([], 2)
    world.see("/n")
    assert world.topics() == ["/a", "/b"]
    assert world.refused.counts == {(MessageKind.PUBLISHERS, MessageRefusal.SOURCE): 1}


def test_all_messages_of_a_node_wait_for_the_graph():
    """What a node says in several messages before the graph shows it is heard, up to a bound."""
    world = World()
    for number in range(8):
        world.node.callback(serialized(to_status(publisher("/n", f"/t{number}"))))
    long = to_status(publisher("/n", "/long", refusal="x" * 100_000))
    for _ in range(2):
        world.node.callback(serialized(long))
    world.see("/n")
    assert world.topics() == ["/long", *(f"/t{number}" for number in range(8))]
    assert world.refused.counts == {(MessageKind.PUBLISHERS, MessageRefusal.SOURCE): 1}


class Counting(World):
    """The same, with the numbers of publishers."""

    def __init__(self):
        super().__init__()
        self.numbers = Node()
        self.counters = CounterMessages(
            self.numbers, self.heard, refused=self.refused, pause=Pause(), clock=lambda: self.now_s
        )
        self.announced = publisher("/n", "/a", published=100)

    def see(self, *nodes):
        super().see(*nodes)
        self.counters.see(frozenset(nodes))

    def announce(self):
        self.node.callback(serialized(to_status(self.announced, Tag(7, 1, 0))))

    def count(self, published, *, node="/n", life=7, rows=1):
        row = row_of(1, 0, told=self.announced, now=replace(self.announced, published=published))
        data = encode_counters(node, [row] * rows, incarnation=life, answer=PlanAnswer(4, 9), lease_s=30.0)
        self.numbers.callback(serialize_message(UInt8MultiArray(data=data)))


def test_numbers_follow_an_announcement():
    """Numbers change the state of an announced publisher, and bring its node's answer to a plan."""
    world = Counting()
    world.see("/n")
    world.count(150)
    assert world.topics() == []
    world.announce()
    world.count(160)
    world.count(170, life=8)
    (state,) = world.heard.live(world.now_s)
    assert (state.published, state.generation, state.lease_s) == (160, 4, 30.0)
    assert world.heard.answer_of("/n") == (4, 9, "")
    world.see()
    assert world.heard.answer_of("/n") == (0, 0, ""), "the graph shows the node no more"


def test_numbers_are_believed_as_announcements_are():
    """Numbers of unknown nodes, too often, of too many publishers, or malformed are refused and counted."""
    world = Counting()
    world.count(150, node="/invented")
    world.count(150)
    world.see("/n")
    world.announce()
    for published in range(200, 300):
        world.count(published)
    (state,) = world.heard.live(world.now_s)
    assert state.published < 250
    world.now_s = 5.0
    world.count(150, rows=MOST_OF_NODE + 1)
    world.numbers.callback(serialize_message(UInt8MultiArray(data=b"\1" * 60)))
    world.numbers.callback(b"\0" * 30_000)
    counts = {reason: count for (_, reason), count in world.refused.counts.items()}
    assert counts.pop(MessageRefusal.RATE) > 80
    assert counts == dict.fromkeys(
        (MessageRefusal.SOURCE, MessageRefusal.QUOTA, MessageRefusal.MALFORMED, MessageRefusal.SIZE), 1
    )


def test_a_repeated_announcement_is_not_decoded_again():
    """The same statuses under another stamp are a sign of life, and new ones are read."""
    world = World()
    world.see("/n")
    decoded = []
    world.heard._decode = lambda status: decoded.append(status) or from_status(status)
    for world.now_s in (0.0, 3.0, 6.0):
        message = DiagnosticArray(status=[to_status(publisher("/n", "/a"))])
        message.header.stamp.sec = int(world.now_s)
        world.node.callback(serialize_message(message))
    assert (len(decoded), world.topics()) == (1, ["/a"])
    world.node.callback(serialized(to_status(publisher("/n", "/a", depth=11))))
    assert [state.depth for state in world.heard.live(6.0)] == [11]


def test_endpoints_whose_nodes_are_not_told_may_be_anybodys():
    """While a participant's nodes are unknown, any node is believed, at one rate for all."""
    world = World()
    world.see("")
    for k in range(100):
        world.node.callback(serialized(to_status(publisher(f"/n{k}", "/a"))))
    assert 1 <= len(world.topics()) < 20
    assert world.refused.counts[MessageKind.PUBLISHERS, MessageRefusal.RATE] > 80


def test_a_node_speaks_for_itself_at_its_own_rate():
    """A node cannot announce another's publishers, too many of them, or too often."""
    world = World()
    world.see("/n", "/m")
    world.node.callback(serialized(to_status(publisher("/n", "/a")), to_status(publisher("/m", "/b"))))
    assert world.topics() == ["/a"]
    world.node.callback(serialized(*[to_status(publisher("/n", "/c"))] * (MOST_OF_NODE + 1)))
    for _ in range(1000):
        world.node.callback(ANNOUNCEMENT)
    world.node.callback(serialized(to_status(publisher("/m", "/b"))))
    assert "/b" in world.topics()
    counts = world.refused.counts
    assert (
        counts[MessageKind.PUBLISHERS, MessageRefusal.MALFORMED]
        == counts[MessageKind.PUBLISHERS, MessageRefusal.QUOTA]
        == 1
    )
    assert counts[MessageKind.PUBLISHERS, MessageRefusal.RATE] > 980


def test_waiting_messages_are_taken_together_and_many_are_a_flood():
    """Every waiting message is taken, one that is too long is refused, and 500 at once are a flood."""
    node, taken, long = Node(), [], []
    subscription = RawSubscription(
        node,
        Float64,
        "/t",
        None,
        most_bytes=8,
        take=lambda data, _info: taken.append(data),
        refuse=lambda: long.append(1),
        clock=lambda: 0.0,
    )
    node.waiting = [b"1", b"2" * 9, b"3"]
    node.callback(b"0")
    assert (taken, long, subscription.is_flooded) == ([b"0", b"1", b"3"], [1], False)
    node.waiting = [b"x"] * 500
    node.callback(b"x")
    assert subscription.is_flooded
    assert (len(taken), node.waiting) == (504, [])


class Handle:
    """A handle of a node that counts one of everything."""

    get_count_publishers = get_count_subscribers = staticmethod(lambda _topic: 1)

    def __enter__(self):
        return None

    def __exit__(self, *_):
        return None


def test_one_impossible_topic_hides_no_other():
    """A name or QoS of another DDS that ROS cannot express leaves the rest of the graph readable."""

    def info(topic):
        if topic == "/odd":
            raise InvalidTopicNameException(topic, "unexpected", 0)
        if topic == "/worse":
            raise UnicodeDecodeError("utf-8", b"\xff", 0, 1, "of a node")
        return []

    names = ["/good", "/odd", "/worse", "/no name", "/" + "x" * 300]
    node = SimpleNamespace(
        get_name=lambda: "arpd",
        get_fully_qualified_name=lambda: "/arpd",
        get_topic_names_and_types=lambda: [(name, []) for name in names],
        get_node_names_and_namespaces=list,
        count_publishers=lambda _topic: 1,
        handle=Handle(),
        get_publishers_info_by_topic=info,
        get_subscriptions_info_by_topic=info,
    )
    assert set(GraphReader(node, rmw_of("rmw_fastrtps_cpp")).read().crossings) == {"/good"}


def test_the_graph_confirms_the_nodes_it_shows():
    """A node is confirmed on a topic that it writes or reads if it can announce; an impossible request is ignored."""
    crossing = Crossing(
        direction="sensing",
        remote_readers=1,
        requests=(("/reader", 1), ("/slow", 5 * LEAST_DEADLINE_NS)),
        writers=frozenset({"/writer"}),
    )
    graph = Graph(
        crossings={"/t": crossing},
        announcers=frozenset({"/writer", "/other"}),
        reader_announcers=frozenset({"/reader", ""}),
        peers=0,
    )
    assert graph.shows_writer("/writer", "/t")
    assert not graph.shows_writer("/other", "/t")
    assert not graph.shows_writer("/writer", "/u")
    assert graph.shows_reader("/slow", "/t")
    assert not graph.shows_reader("/writer", "/t")
    assert crossing.tightest_request_ns() == 5 * LEAST_DEADLINE_NS
    assert crossing.requests_of("/reader") == ()


def test_an_endpoint_without_a_name_is_nobodys_that_has_one():
    """An endpoint whose node is unknown may be that of any node that the graph does not name, and of no other."""
    crossing = Crossing(direction="sensing", remote_readers=1, requests=(("", 0),), writers=frozenset({""}))
    graph = Graph(
        crossings={"/t": crossing},
        announcers=frozenset({"/other"}),
        reader_announcers=frozenset({"/other", ""}),
        peers=0,
    )
    assert not graph.shows_writer("/nameless", "/t"), "every node that announces publishers has a name"
    assert graph.shows_reader("/nameless", "/t")
    assert not graph.shows_reader("/other", "/t"), "the graph names its endpoints, and this is none of them"


def test_in_a_flood_subscriptions_rest_most_of_the_time():
    """The shared pause takes most of the time, for any number of subscriptions."""
    now_s, slept = [0.0], []

    def sleep(seconds):
        slept.append(seconds)
        now_s[0] += seconds

    pause = Pause(lambda: now_s[0], sleep=sleep)
    for _ in range(1000):
        now_s[0] += 0.001
        pause.take()
    assert 0.7 < sum(slept) / now_s[0] < 0.9
