"""Messages from the network, refused without harm, and without a network."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray, UInt8MultiArray

from arpd.model.observation import MessageKind, MessageRefusal
from arpd.ros import listeners
from arpd.ros.node_snapshot import encode_snapshot
from arpd.ros.nodes import MOST_PUBLISHERS, Nodes
from arpd.ros.price_message import encode_price
from arpd.ros.raw_reader import Sample
from arpd.ros.refused_messages import RefusedMessages
from tests.ros.price import FREE
from tests.sample_publishers import publisher

LOW, OWN, HIGH = (bytes([number]) * 16 for number in (1, 2, 3))


@pytest.fixture(autouse=True)
def _no_readers(monkeypatch):
    """Make no reader: the tests deliver."""
    monkeypatch.setattr(listeners, "RawReader", lambda *_arguments, **_options: None)


class World:
    """A stopped clock, and what is refused."""

    context = None

    def __init__(self):
        self.now_s = 0.0
        self.refused = RefusedMessages(clock=self.clock)

    def clock(self):
        return self.now_s

    def counts(self):
        return {reason: count for (_kind, reason), count in self.refused.counts.items()}


@pytest.fixture
def world():
    return World()


def said(node, *topics):
    return encode_snapshot(node, [publisher(node, topic) for topic in topics])


@pytest.fixture
def tell(world):
    """Deliver a snapshot; return the topics that are live then."""
    heard, nodes = listeners.NodeSnapshots(world, thread=None, refused=world.refused, clock=world.clock), Nodes()
    nodes.see(lambda _node, _topic: True)

    def tell(writer, data):
        heard.take(Sample(serialize_message(UInt8MultiArray(data=data)), writer, 1))
        heard.drain(nodes)
        return {state.topic for state in nodes.live(0.0)}

    return tell


def test_a_flood_of_one_node_costs_no_other(tell, world):
    """Beyond its rate a node is not heard, and another one is."""
    for number in range(1000):
        tell(LOW, said("/loud", f"/t{number}"))
    assert "/quiet" in tell(HIGH, said("/n", "/quiet"))
    assert world.counts()[MessageRefusal.RATE] > 980


def test_nonsense_is_counted_by_reason(tell, world):
    """Neither a message that is too long, nor one that is none, nor too many publishers change anything."""
    before = tell(LOW, said("/n", "/a"))
    full = [f"/t{number}" for number in range(250)]
    for number in range(MOST_PUBLISHERS // 250):
        tell(bytes([10 + number]) * 16, said(f"/n{number}", *full))
    assert world.counts() == {MessageRefusal.QUOTA: 1}
    assert tell(LOW, b"{}") >= before
    assert tell(LOW, bytes(300_000)) >= before
    assert world.counts() == dict.fromkeys([MessageRefusal.QUOTA, MessageRefusal.MALFORMED, MessageRefusal.SIZE], 1)


@pytest.fixture
def daemons(world):
    return listeners.OtherDaemons(world, OWN, tells_hosts=True, thread=None, refused=world.refused, clock=world.clock)


@pytest.fixture
def price(daemons):
    """Deliver a price, or other numbers; return where the active daemon is then."""

    def price(writer, numbers=None):
        numbers = encode_price(FREE) if numbers is None else numbers
        daemons.take(Sample(serialize_message(Float64MultiArray(data=numbers)), writer, 1))
        return daemons.active_daemon()

    return price


def test_only_a_lower_guid_makes_a_daemon_stand_by(price, daemons, world):
    """Its own price and those of higher GUIDs change nothing; the lower one counts until it is silent."""
    assert [price(who) for who in (OWN, HIGH, LOW)] == ["", "", "another host"]
    world.now_s = 3.4
    assert daemons.active_daemon() == "another host"
    world.now_s = 3.6
    assert daemons.active_daemon() == ""


def test_what_is_no_price_makes_no_daemon(price, world):
    """Nonsense is counted, and changes nothing."""
    assert [price(LOW, numbers) for numbers in ([1.0], [1.0] * 1000)] == ["", ""]
    assert world.refused.counts == {
        (MessageKind.PRICES, MessageRefusal.MALFORMED): 1,
        (MessageKind.PRICES, MessageRefusal.SIZE): 1,
    }
