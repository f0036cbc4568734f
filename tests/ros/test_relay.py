"""The relay with real rclpy: unmodified publishers in, AdaptivePublishers out."""

import time
from contextlib import ExitStack

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64, String

from arpd.adapters.ros import relay as relay_module
from arpd.adapters.ros.relay import Relay, UnknownTypeError, message_class
from arpd.adapters.ros.runtime import best_executor
from arpd.model.settings import Overflow, RelaySettings
from tests.chaos.world import is_gapless
from tests.ros.domain import DOMAIN

pytestmark = pytest.mark.ros

BEST_EFFORT = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


class DeafExecutor:
    """An executor that delivers nothing."""

    def __init__(self, context=None):
        self.add_node = self.remove_node = lambda _node: None
        self.shutdown = lambda: None

    def spin_once(self, timeout_sec):
        time.sleep(timeout_sec)


@pytest.fixture
def lines():
    """Status lines of the relay, oldest first."""
    return []


def shown(lines):
    """Return a function that appends the line of a status."""
    return lambda status: lines.append(status.line)


def test_it_carries_what_an_unmodified_node_publishes(ros, lines, background, eventually):
    """Messages of a plain publisher on /chatter arrive unchanged on /link/chatter."""
    talker = Numbers(ros.node("plain").create_publisher(String, "/chatter", 1000), "plain")
    received = listen(ros.node("far"), "/link/chatter")
    settings = RelaySettings(topics=("/chatter", "/never"), depths={"/chatter": 1000})
    Relay(ros.node("relay"), settings, on_change=shown(lines))
    background(talker.talk)
    eventually(lambda: len(received) > 20)
    assert is_gapless(of(received, "plain"))
    assert lines[-1] == "relaying 1 of 2 topics; not published yet: /never"


def test_it_matches_a_best_effort_source(ros, lines, eventually):
    """A best-effort sensor is relayed too: a reliable reader would not match it."""
    sensor = QoSProfile(depth=5, reliability=QoSReliabilityPolicy.BEST_EFFORT)
    talker = ros.node("sensor").create_publisher(String, "/chatter", sensor)
    Relay(ros.node("relay"), RelaySettings(topics=("/chatter",)), on_change=shown(lines))
    eventually(lambda: talker.get_subscription_count() == 1)


def test_a_type_that_is_not_installed_is_named():
    """A message type that is not installed is refused by name."""
    with pytest.raises(UnknownTypeError, match="no_such_msgs/msg/Thing is not installed"):
        message_class("no_such_msgs/msg/Thing")


def test_the_cheap_executor_is_taken_where_it_delivers(ros):
    """EventsExecutor delivers here, so the relay runs on it."""
    executor = best_executor(context=ros.context)
    assert type(executor).__name__ == "EventsExecutor"
    executor.shutdown()


def test_an_executor_that_delivers_nothing_is_not_trusted(ros, monkeypatch):
    """Where EventsExecutor never delivers, the relay runs on rclpy's default executor."""
    monkeypatch.setattr("rclpy.experimental.EventsExecutor", DeafExecutor)
    executor = best_executor(context=ros.context)
    assert type(executor).__name__ == "SingleThreadedExecutor"
    executor.shutdown()


def test_a_latched_topic_stays_latched(ros, lines, eventually):
    """A late reader of the relayed topic receives the map published before it joined."""
    talker = ros.node("map_server").create_publisher(String, "/map", LATCHED)
    talker.publish(String(data="the map"))
    Relay(ros.node("relay"), RelaySettings(topics=("/map",)), on_change=shown(lines))
    eventually(lambda: lines[-1] == "relaying 1 of 1 topics")
    time.sleep(0.5)
    received = []
    ros.node("late").create_subscription(String, "/link/map", lambda m: received.append(m.data), LATCHED)
    eventually(lambda: received == ["the map"])


@pytest.fixture
def elsewhere(ros):
    """Make a node in its own participant, as in its own process: within one participant a topic has one type."""
    with ExitStack() as stack:

        def node(name, executor=SingleThreadedExecutor, **options):
            context = rclpy.Context()
            rclpy.init(context=context, domain_id=DOMAIN)
            stack.callback(rclpy.try_shutdown, context=context)
            return type(ros)(context, stack).node(name, executor(context=context), **options)

        yield node


class Numbers:
    """A talker that publishes its name and consecutive numbers."""

    def __init__(self, publisher, name, rate_hz=100):
        self.publisher, self.name, self.rate_hz, self.sent = publisher, name, rate_hz, 0

    def talk(self, stopping):
        while not stopping.is_set():
            self.publisher.publish(String(data=f"{self.name} {self.sent}"))
            self.sent += 1
            time.sleep(1 / self.rate_hz)


def of(received, name):
    return [int(number) for talker, number in (text.split() for text in received) if talker == name]


def listen(node, topic):
    received = []
    node.create_subscription(String, topic, lambda m: received.append(m.data), 1000)
    return received


SETTINGS = RelaySettings(topics=("/chatter",), overflow={"/chatter": Overflow.QUEUE}, depths={"/chatter": 1000})


@pytest.mark.parametrize("executor", [SingleThreadedExecutor, EventsExecutor])
def test_a_best_effort_publisher_that_joins_later_is_heard(elsewhere, lines, background, eventually, executor):
    """A best-effort publisher that joins is carried too, and the first one's messages are not lost or doubled."""
    reliable = Numbers(elsewhere("first").create_publisher(String, "/chatter", 1000), "first")
    received = listen(elsewhere("far"), "/link/chatter")
    Relay(elsewhere("relay", executor), SETTINGS, on_change=shown(lines))
    background(reliable.talk)
    eventually(lambda: len(of(received, "first")) > 20)
    weak = Numbers(elsewhere("second").create_publisher(String, "/chatter", BEST_EFFORT), "second")
    background(weak.talk)
    eventually(lambda: len(of(received, "second")) > 20)
    so_far = reliable.sent
    eventually(lambda: of(received, "first")[-1] >= so_far)
    assert is_gapless(of(received, "first"))


def test_a_volatile_publisher_that_joins_a_latched_topic_is_heard(elsewhere, lines, background, eventually):
    """A volatile publisher that joins a latched topic is carried, and the latched one goes on."""
    latched = Numbers(elsewhere("first").create_publisher(String, "/chatter", LATCHED), "first")
    received = listen(elsewhere("far"), "/link/chatter")
    Relay(elsewhere("relay"), SETTINGS, on_change=shown(lines))
    background(latched.talk)
    eventually(lambda: len(of(received, "first")) > 20)
    volatile = Numbers(elsewhere("second").create_publisher(String, "/chatter", 10), "second")
    background(volatile.talk)
    eventually(lambda: len(of(received, "second")) > 20)
    so_far = latched.sent
    eventually(lambda: of(received, "first")[-1] >= so_far)


def test_two_types_on_one_topic_are_refused_and_named(elsewhere, lines, background, eventually):
    """A topic with two types is refused and both are named; when one leaves, the other is carried."""
    words = Numbers(elsewhere("words").create_publisher(String, "/chatter", 10), "words")
    figures = elsewhere("figures")
    stray = figures.create_publisher(Float64, "/chatter", 10)
    relay = elsewhere("relay")
    eventually(lambda: len(relay.get_publishers_info_by_topic("/chatter")) == 2)
    Relay(relay, SETTINGS, on_change=shown(lines))
    eventually(lambda: "refused /chatter" in lines[-1])
    assert "std_msgs/msg/Float64 from /figures, std_msgs/msg/String from /words" in lines[-1]
    figures.destroy_publisher(stray)
    received = listen(elsewhere("far"), "/link/chatter")
    background(words.talk)
    eventually(lambda: len(received) > 5)
    assert lines[-1] == "relaying 1 of 1 topics"


def test_a_stray_publisher_of_another_type_takes_nothing_away(elsewhere, lines, background, eventually):
    """A carried topic goes on when a publisher of another type joins, and that publisher is named."""
    words = Numbers(elsewhere("words").create_publisher(String, "/chatter", 10), "words")
    received = listen(elsewhere("far"), "/link/chatter")
    Relay(elsewhere("relay"), SETTINGS, on_change=shown(lines))
    background(words.talk)
    eventually(lambda: len(received) > 5)
    figures = elsewhere("figures")
    stray = figures.create_publisher(Float64, "/chatter", 10)
    named = "relaying 1 of 1 topics; on /chatter ignored std_msgs/msg/Float64 from /figures"
    eventually(lambda: lines[-1] == named)
    before = len(received)
    eventually(lambda: len(received) > before + 5)
    figures.destroy_publisher(stray)
    eventually(lambda: lines[-1] == "relaying 1 of 1 topics")


def test_a_topic_that_returns_with_another_type_is_carried(elsewhere, lines, background, eventually):
    """The status names a topic that is gone; when it returns with another type, that type is carried."""
    node = elsewhere("talker")
    old = node.create_publisher(Float64, "/chatter", 10)
    relay = elsewhere("relay")
    Relay(relay, SETTINGS, on_change=shown(lines))
    eventually(lambda: lines[-1] == "relaying 1 of 1 topics")
    node.destroy_publisher(old)
    eventually(lambda: lines[-1] == "relaying 0 of 1 topics; no longer published: /chatter")
    received = listen(elsewhere("far"), "/link/chatter")
    background(Numbers(elsewhere("words").create_publisher(String, "/chatter", 10), "words").talk)
    eventually(lambda: len(received) > 5)
    assert lines[-1] == "relaying 1 of 1 topics"
    outputs = relay.get_publishers_info_by_topic("/link/chatter")
    assert [info.topic_type for info in outputs] == ["std_msgs/msg/String"]


def test_a_type_that_is_not_installed_stops_no_other_topic(elsewhere, lines, background, eventually, monkeypatch):
    """A topic whose type is missing is refused and named, the others go on, and another type is tried."""

    def missing(name):
        if name == "std_msgs/msg/Float64":
            raise UnknownTypeError(f"{name} is not installed here")
        return message_class(name)

    monkeypatch.setattr(relay_module, "message_class", missing)
    node = elsewhere("talker")
    alien = node.create_publisher(Float64, "/alien", 10)
    received, later = listen(elsewhere("far"), "/link/chatter"), listen(elsewhere("later"), "/link/alien")
    Relay(elsewhere("relay"), RelaySettings(topics=("/alien", "/chatter")), on_change=shown(lines))
    background(Numbers(elsewhere("words").create_publisher(String, "/chatter", 10), "words").talk)
    eventually(lambda: len(received) > 5)
    assert lines[-1] == "relaying 1 of 2 topics; refused /alien: std_msgs/msg/Float64 is not installed here"
    node.destroy_publisher(alien)
    background(Numbers(elsewhere("known").create_publisher(String, "/alien", 10), "known").talk)
    eventually(lambda: len(later) > 5)
    assert lines[-1] == "relaying 2 of 2 topics"


def test_its_own_output_is_no_input(elsewhere, lines):
    """A topic under the prefix, and one that remapping makes its own output, are refused and named."""
    remapped = ["--ros-args", "-r", "/link/chatter:=/chatter"]
    topics = ("/link/scan", "/chatter")
    Relay(elsewhere("relay", cli_args=remapped), RelaySettings(topics=topics), on_change=shown(lines))
    assert lines[-1] == (
        "relaying 0 of 2 topics; refused /chatter: a remapping rule gives its output the same name; remove the rule; "
        "refused /link/scan: it already carries the prefix /link; name the topic without it"
    )


def test_a_node_that_sends_the_output_back_is_named(elsewhere, lines, background, eventually):
    """While a node publishes the relay's output back the topic is refused; when the node leaves, it is carried."""
    far = elsewhere("far")
    back = far.create_publisher(String, "/chatter", 10)
    echo = far.create_subscription(String, "/link/chatter", back.publish, 10)
    background(Numbers(elsewhere("words").create_publisher(String, "/chatter", 10), "words").talk)
    relay = elsewhere("relay")
    eventually(lambda: len(relay.get_publishers_info_by_topic("/chatter")) == 2)
    Relay(relay, SETTINGS, on_change=shown(lines))
    eventually(lambda: "refused /chatter: /far reads /link/chatter and publishes it" in lines[-1])
    far.destroy_subscription(echo)
    far.destroy_publisher(back)
    received = listen(elsewhere("listener"), "/link/chatter")
    eventually(lambda: len(received) > 5)
    assert lines[-1] == "relaying 1 of 1 topics"


def test_of_two_relays_in_a_circle_one_steps_back(elsewhere, lines, background, eventually, monkeypatch):
    """A relay that would carry another's output back to its input refuses in the end, and the other goes on."""
    monkeypatch.setattr(relay_module, "_KEEP_LOOKS", 4)
    received = listen(elsewhere("far"), "/a/chatter")
    background(Numbers(elsewhere("words").create_publisher(String, "/chatter", 10), "words").talk)
    Relay(elsewhere("one"), RelaySettings(topics=("/chatter",), prefix="/a"), on_change=lambda _line: None)
    eventually(lambda: len(received) > 5)
    back = elsewhere("two", cli_args=["--ros-args", "-r", "/b/a/chatter:=/chatter"])
    Relay(back, RelaySettings(topics=("/a/chatter",), prefix="/b"), on_change=shown(lines))
    # Discovery decides which of the two sees the loop first.
    eventually(lambda: "refused /a/chatter: /one reads /chatter and publishes it" in lines[-1], timeout_s=60)
    before = len(received) + 50
    eventually(lambda: len(received) > before + 20)
    numbers = of(received[before:], "words")
    assert numbers == sorted(set(numbers))


def test_a_source_that_never_returns_frees_what_carried_it(elsewhere, lines, eventually, monkeypatch):
    """Some time after the last publisher left, the relay destroys its reader and writer."""
    monkeypatch.setattr(relay_module, "_KEEP_LOOKS", 1)
    node = elsewhere("talker")
    talker = node.create_publisher(String, "/chatter", 10)
    relay = elsewhere("relay")
    Relay(relay, SETTINGS, on_change=shown(lines))
    eventually(lambda: relay.get_publishers_info_by_topic("/link/chatter"))
    node.destroy_publisher(talker)
    eventually(lambda: not relay.get_publishers_info_by_topic("/link/chatter"))
    assert not relay.get_subscriptions_info_by_topic("/chatter")
    assert lines[-1] == "relaying 0 of 1 topics; no longer published: /chatter"


@pytest.fixture
def looks(ros, monkeypatch):
    """Return a relay whose looks the test makes, and the topics whose endpoints it read."""
    node = rclpy.create_node("relay", context=ros.context)  # not spun, so its timer never fires
    whole = []
    ask = node.get_publishers_info_by_topic
    monkeypatch.setattr(node, "get_publishers_info_by_topic", lambda topic: whole.append(topic) or ask(topic))
    yield Relay(node, RelaySettings(topics=("/a", "/b")), on_change=lambda _line: None), whole
    node.destroy_node()


def is_settled(relay):
    """Let the relay look; return whether /a is settled."""
    relay._discover()
    return relay._is_settled("/a")


def look_again(relay):
    """Let the relay look at every topic: it counts the endpoints of a settled one at every second look."""
    for _ in range(2):
        relay._discover()


def test_a_settled_topic_is_only_counted(elsewhere, looks, eventually):
    """Endpoints of a settled topic are read when their numbers change, and at every 60th look."""
    relay, whole = looks
    talker = elsewhere("talker")
    talker.create_publisher(String, "/a", 10)

    eventually(lambda: is_settled(relay))
    whole.clear()
    for _ in range(2 * relay_module._EVERY_LOOK):
        relay._discover()
    assert whole.count("/a") == 2
    assert whole.count("/b") == 2 * relay_module._EVERY_LOOK
    talker.create_publisher(String, "/a", BEST_EFFORT)
    eventually(lambda: not relay._is_settled("/a"))
    look_again(relay)
    assert relay._carried["/a"].route.is_reliable is False


def test_a_source_replaced_between_two_looks_is_heard(elsewhere, looks, eventually):
    """A weaker publisher that replaces another between two looks is heard after two looks."""
    relay, _whole = looks
    talker = elsewhere("talker")
    first = talker.create_publisher(String, "/a", 10)

    eventually(lambda: is_settled(relay))
    talker.create_publisher(String, "/a", BEST_EFFORT)
    eventually(lambda: not relay._is_settled("/a"))
    talker.destroy_publisher(first)
    eventually(lambda: relay._endpoints("/a", relay._carried["/a"])[:2] == (1, 0))
    look_again(relay)
    assert relay._carried["/a"].route.is_reliable is False


def test_a_stronger_source_is_followed_in_the_end(elsewhere, looks, eventually):
    """A stronger publisher that replaces another between two looks is heard, and followed within 60 looks."""
    relay, _whole = looks
    talker = elsewhere("talker")
    first = talker.create_publisher(String, "/a", BEST_EFFORT)

    eventually(lambda: is_settled(relay))
    talker.create_publisher(String, "/a", 10)
    eventually(lambda: not relay._is_settled("/a"))
    talker.destroy_publisher(first)
    eventually(lambda: relay._is_settled("/a"))
    for _ in range(relay_module._EVERY_LOOK):
        relay._discover()
    assert relay._carried["/a"].route.is_reliable is True
