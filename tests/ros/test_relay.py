"""The relay with real rclpy: unmodified publishers in, AdaptivePublishers out."""

import threading
import time
from contextlib import ExitStack, closing
from functools import partial
from types import SimpleNamespace

import pytest
from std_msgs.msg import Empty, String

from arpd.model.endpoints import Overflow
from arpd.model.settings import RelaySettings, RelayTopic
from arpd.relay.ends.link import LinkThread, LinkTopic
from arpd.relay.ends.offers import WriterOffer
from arpd.relay.ends.prefix import Prefixed
from arpd.relay.ends.topic_readers import Surveyed, TopicReaders
from arpd.relay.ends.types import UnknownTypeError
from arpd.ros.graph import Endpoint
from arpd.ros.raw_reader import Sample
from tests.ros.ends_world import BEST_EFFORT, RELIABLE, Counter, is_whole, latched, listen, numbers


@pytest.fixture
def lines():
    """Status lines of the relay, oldest first."""
    return [""]


@pytest.fixture
def carry(lines):
    """Start a relay in a node."""
    with ExitStack() as stack:

        def start(node, settings):
            relay = stack.enter_context(closing(Prefixed(node, settings, tell=lines.append)))
            stopping = threading.Event()
            looks = threading.Thread(target=look, args=(relay, stopping), daemon=True)
            stack.callback(looks.join)
            stack.callback(stopping.set)
            looks.start()

        yield start


def look(relay, stopping):
    while not stopping.wait(0.5):
        relay.look()


def test_it_carries_what_an_unmodified_node_publishes(elsewhere, lines, carry, talking, eventually):
    """Messages of a plain publisher on /chatter arrive unchanged on /link/chatter."""
    talker = Counter(elsewhere("plain"), String, "/chatter", RELIABLE)
    received = listen(elsewhere("far"), "/link/chatter")
    settings = RelaySettings(topics=(RelayTopic(name="/chatter", depth=1000), RelayTopic(name="/never")))
    carry(elsewhere("relay"), settings)
    talking(talker, rate_hz=20)
    eventually("samples arrive", lambda: len(received) > 20)
    assert is_whole(received, "plain")
    eventually("the other one is named", lambda: lines[-1] == "relaying 1 of 2 topics; not published: /never")


def test_a_late_reader_hears_each_of_many_latched_writers(ros, elsewhere, lines, carry, eventually):
    """A dozen writers publish a static transform once each, and tf2 needs all of them."""
    frames = elsewhere("frames")
    talkers = [frames.create_publisher(String, "/tf_static", latched(1)) for _ in range(12)]
    for number, talker in enumerate(talkers):
        talker.publish(String(data=str(number)))
    carry(ros.node("relay"), RelaySettings(topics=(RelayTopic(name="/tf_static"),)))
    eventually("it is carried", lambda: lines[-1] == "relaying 1 of 1 topics")
    received = listen(ros.node("late"), "/link/tf_static", latched(100))
    eventually("all are heard", lambda: sorted(map(int, received)) == [*range(12)])


@pytest.fixture
def elsewhere(ros):
    """Make a node in its own participant: within one participant a topic has one type."""
    return lambda name, **options: ros.elsewhere().node(name, **options)


SETTINGS = RelaySettings(topics=(RelayTopic(name="/chatter", overflow=Overflow.QUEUE, depth=1000),))


def test_a_best_effort_publisher_that_joins_later_is_heard(elsewhere, carry, talking, eventually):
    """A best-effort publisher that joins is carried too, and the first one's messages are not lost or doubled."""
    reliable = Counter(elsewhere("first"), String, "/chatter", RELIABLE)
    received = listen(elsewhere("far"), "/link/chatter")
    carry(elsewhere("relay"), SETTINGS)
    talking(reliable, rate_hz=20)
    eventually("the first one is heard", lambda: len(numbers(received, "first")) > 20)
    talking(Counter(elsewhere("second"), String, "/chatter", BEST_EFFORT), rate_hz=20)
    eventually("the second one is heard", lambda: len(numbers(received, "second")) > 20)
    so_far = reliable.sent
    eventually("the first one goes on", lambda: numbers(received, "first")[-1] >= so_far)
    assert is_whole(received, "first")


def test_a_stray_type_stops_nothing_and_follows_when_it_is_alone():
    """Two types at first are none; one that is carried stays beside another, which is carried when it is left alone."""
    surveyed, courses = Surveyed(None, "/chatter"), []
    for types in (["String", "Empty"], ["String"], ["String", "Empty"], ["Empty"]):
        surveyed.read([Endpoint(gid=bytes([n] * 16), type_name=kind) for n, kind in enumerate(types)], 0.0)
        courses.append((surveyed.type_name, len(surveyed.writers)))
    assert courses == [("", 0), ("String", 1), ("String", 1), ("Empty", 1)]


def test_a_writer_is_known_for_half_a_minute_after_it_left():
    """However long it was there; it is offered for a second. One without a node is offered after two, and stays."""
    surveyed = Surveyed(None, "/chatter")
    first, second = (Endpoint(gid=bytes([n] * 16)) for n in (1, 2))
    nameless = Endpoint(gid=bytes(16), is_named=False)

    def offered_at(now_s, *writers):
        surveyed.read(writers, now_s)
        return [
            writer
            for writer in (first, second, nameless)
            if writer.gid.hex() in {each.gid for each in surveyed.writers}
        ]

    assert offered_at(0.0, first) == [first]
    assert offered_at(100.0, second) == [first, second]
    assert offered_at(101.0, second) == [second]
    assert first.gid in surveyed.known
    assert (offered_at(131.0, second, nameless), surveyed.is_waiting) == ([second], True)
    assert first.gid not in surveyed.known
    assert (offered_at(133.0, second, nameless), surveyed.is_waiting) == ([second, nameless], False)
    assert offered_at(134.0, nameless) == [second, nameless]


class View:
    """A graph that a test changes: what it shows, and what was read of it."""

    now, read, ours = (), (), frozenset()

    def look(self):
        return 1

    def writers_now(self, _topic):
        self.read = self.now

    def writers(self, _topic):
        return self.read


def test_a_writer_that_leaves_at_once_is_told_of():
    """A script publishes and ends before the graph is read again: its sample makes it known, and offered for 1 s."""
    kind = {"type_name": "std_msgs/msg/String", "type_hash": "RIHS01_1"}
    view = View()
    view.now = (Endpoint(gid=bytes(16), **kind),)
    surveyed = Surveyed(view, "/stop")
    assert surveyed.writer(bytes(16))
    view.now = view.read = ()
    for has_changed in (True, False):
        surveyed.look(has_changed=has_changed)
        assert [writer.gid for writer in surveyed.writers] == [bytes(16).hex()]
        assert {name: getattr(surveyed, name) for name in kind} == kind  # else the other end would refuse the topic
    surveyed.read((), time.monotonic() + 2.0)
    assert not surveyed.writers


def test_a_writer_that_no_look_finds_is_offered_by_what_heard_it():
    """It left before its sample was taken; one of this process, or one that waits for its name, is not taken for it."""
    view = View()
    view.ours, waiting = frozenset({bytes(12)}), Endpoint(gid=bytes([2] * 16), is_named=False)
    view.now = view.read = (waiting,)
    surveyed = Surveyed(view, "/stop")
    surveyed.look(has_changed=True)
    for gid in (bytes([1] * 16), bytes(16), waiting.gid):
        assert surveyed.writer(gid) is None
        surveyed.adopt(gid, (True, False, 0))
    assert [(each.gid, each.node, each.kind) for each in surveyed.writers] == [("01" * 16, "", (True, False, 0))]


def test_a_sample_of_a_writer_that_no_look_finds_is_delivered_once():
    """By the reader that asks for most; a best-effort reader hears a reliable writer, too."""
    heard = []
    readers = TopicReaders(
        None,
        Surveyed(View(), "/stop"),
        String,
        thread=None,
        deliver=lambda writer, _sample: heard.append(writer.kind),
        on_missed=None,
        depth=None,
        is_kept=False,
    )
    for kind in ((False, False, 0), (True, False, 0)):
        readers._held.append((kind, SimpleNamespace(writer=bytes(16), sequence=1), time.monotonic() - 1.0))
    for _look in range(3):
        readers.follow(())
    assert heard == [(True, False, 0)]


def test_of_new_writers_the_second_waits_until_the_first_is_known():
    """Of two goals, each published once by a script that ends, the first may be known later; an old writer passes."""
    heard, view, kind = [], View(), (True, False, 0)
    gone, new, old = (bytes([n] * 16) for n in (1, 2, 3))
    view.now = tuple(Endpoint(gid=gid, type_name="std_msgs/msg/String") for gid in (old, new))
    readers = TopicReaders(
        None,
        Surveyed(view, "/goal"),
        String,
        thread=None,
        deliver=lambda writer, _sample: heard.append(bytes.fromhex(writer.gid)),
        on_missed=None,
        depth=None,
        is_kept=False,
    )

    def come(*gids):
        readers._held.extend((kind, SimpleNamespace(writer=gid, sequence=1), time.monotonic()) for gid in gids)
        readers.follow(())

    come(old)
    come(gone, new, old)
    assert heard == [old, old]
    readers._held.appendleft((kind, SimpleNamespace(writer=gone, sequence=1), time.monotonic() - 1.0))
    readers.follow(())
    readers.follow(())
    assert heard == [old, old, gone, gone, new]


@pytest.fixture
def link_topic(ros, stack):
    """Return a function that makes a topic of the link by its name."""
    node = ros.node("end")
    thread = LinkThread(1, node, "/arpd/relay/robot")
    stack.callback(thread.stop)

    def make(name):
        topic = LinkTopic(node, name, is_latched=False, thread=thread, settings=RelaySettings(), on_drop=None)
        stack.callback(topic.destroy)
        return topic

    return make


def test_samples_that_a_busy_computer_lost_are_offered_and_withheld(link_topic):
    """Their writer's numbers tell; else a topic of 100 Hz of which 3 are read would count as one of 3 Hz."""
    view, kind = View(), (True, False, 0)
    view.now = (Endpoint(gid=bytes(16), type_name="std_msgs/msg/String"),)
    topic = link_topic("/imu")
    readers = TopicReaders(
        None,
        Surveyed(view, "/imu"),
        String,
        thread=None,
        deliver=partial(topic.send, "/imu"),
        on_missed=topic.miss,
        depth=None,
        is_kept=False,
    )
    for number in (50, 51, 149, 150):
        readers._held.append((kind, Sample(b"0000", bytes(16), number), time.monotonic()))
        readers.follow(())
    state = topic.state()
    assert (state.offered, state.withheld_by_cause["blocked"]) == (101, 97)
    assert state.published + state.queued + state.withheld == state.offered


def test_a_sample_that_is_too_large_to_cross_is_named(link_topic, caplog):
    """The log of the end that has it says so, and it counts as withheld."""
    topic = link_topic("/cloud")
    for number in (1, 2):
        topic.send("/cloud", WriterOffer(node="", gid="00"), Sample(bytes(2**26 + 2**22), bytes(16), number))
    assert caplog.text.count("/cloud has samples of 68 MiB, and none above 64 MiB crosses") == 1
    assert topic.state().withheld_by_cause["failed"] == 2


def test_circles_are_refused_and_named(elsewhere, lines, carry, talking, eventually):
    """A topic is carried no more once a node publishes it that reads what is republished; the others go on."""
    talking(Counter(elsewhere("plain"), String, "/chatter", 10), rate_hz=20)
    elsewhere("other").create_publisher(String, "/other", 10)
    carry(elsewhere("relay"), RelaySettings(topics=(RelayTopic(name="/chatter"), RelayTopic(name="/other"))))
    received = listen(elsewhere("far"), "/link/chatter")
    eventually("it is carried", lambda: received and lines[-1] == "relaying 2 of 2 topics")
    back = elsewhere("back")
    publisher = back.create_publisher(String, "/chatter", 10)
    back.create_subscription(String, "/link/chatter", publisher.publish, 10)
    loop = "/back reads /link/chatter and publishes it, so messages would loop"
    eventually("the circle is named", lambda: lines[-1] == f"relaying 1 of 2 topics; refused /chatter: {loop}")
    eventually("nothing is republished", lambda: back.count_publishers("/link/chatter") == 0)


def test_an_output_that_is_an_input_is_refused(elsewhere, lines, carry, eventually):
    """A remapping rule by which a topic would be republished under a name that is carried makes a circle."""
    for topic in ("/chatter", "/other"):
        elsewhere("talker").create_publisher(String, topic, 10)
    relay = elsewhere("relay", cli_args=["--ros-args", "-r", "/link/chatter:=/other"])
    carry(relay, RelaySettings(topics=(RelayTopic(name="/chatter"), RelayTopic(name="/other"))))
    words = "relaying 1 of 2 topics; refused /chatter: its output /other is carried too"
    eventually("the rule is named", lambda: lines[-1].startswith(words))


def test_mixed_and_missing_types_are_named(elsewhere, lines, carry, monkeypatch, caplog, eventually):  # noqa: PLR0917 - fixtures
    """Of two types at once none is carried, and none that is missing; a stray one beside one that flows is ignored."""

    def found(type_name):
        if type_name != "std_msgs/msg/String":
            raise UnknownTypeError(f"{type_name} is not installed here")
        return String

    monkeypatch.setattr("arpd.relay.ends.prefix.message_class", found)
    first, second = elsewhere("first"), elsewhere("second")
    first.create_publisher(Empty, "/missing", 10)
    first.create_publisher(String, "/mixed", 10)
    second.create_publisher(Empty, "/mixed", 10)
    first.create_publisher(String, "/chatter", 10)
    node = elsewhere("relay")
    topics = "/mixed", "/chatter", "/missing"
    eventually("all are seen", lambda: [node.count_publishers(topic) for topic in topics] == [2, 1, 1])
    carry(node, RelaySettings(topics=tuple(RelayTopic(name=topic) for topic in topics)))
    words = "refused /missing: std_msgs/msg/Empty is not installed here; also /mixed"
    eventually("both are named", lambda: lines[-1] == f"relaying 1 of 3 topics; {words}")
    assert "cannot relay /mixed: it has more than one type: std_msgs/msg/Empty, std_msgs/msg/String;" in caplog.text
    second.create_publisher(Empty, "/chatter", 10)
    eventually("the stray is named", lambda: lines[-1].endswith("; ignored on /chatter: std_msgs/msg/Empty"))
