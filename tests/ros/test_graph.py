"""Look-ups of the graph: numbers first, and endpoints only where something has changed."""

from collections import Counter
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from std_msgs.msg import Float64MultiArray, String

from arpd.adapters.ros.graph import GraphReader
from arpd.adapters.ros.names import PRICE_TOPIC
from arpd.adapters.ros.rmw import current_rmw, rmw_of

pytestmark = pytest.mark.ros
FASTDDS = rmw_of("rmw_fastrtps_cpp")
TOPICS = [f"/t{number}" for number in range(40)]


def endpoint(node="/talker", host=1, number=1, deadline_ns=0):
    return SimpleNamespace(
        endpoint_gid=[0, 0, 0, host, number, *[0] * 11],
        node_name=node[1:],
        node_namespace="/",
        qos_profile=SimpleNamespace(deadline=SimpleNamespace(nanoseconds=deadline_ns)),
    )


class Graphed:
    """A node that sees the writers and readers that a test gives it, and counts the look-ups of endpoints."""

    def __init__(self):
        self.writers = {topic: [endpoint()] for topic in TOPICS} | {PRICE_TOPIC: [endpoint("/arpd")]}
        self.readers = {topic: [endpoint("/listener", host=2)] for topic in TOPICS}
        self.read = Counter()

    def get_name(self):
        return "arpd"

    def count_publishers(self, topic):
        return self.get_count_publishers(topic)

    def get_fully_qualified_name(self):
        return "/arpd"

    def get_topic_names_and_types(self):
        return [(topic, []) for topic in TOPICS]

    def get_publishers_info_by_topic(self, topic):
        self.read[topic] += 1
        return self.writers.get(topic, [])

    def get_subscriptions_info_by_topic(self, topic):
        return self.readers.get(topic, [])

    def get_node_names_and_namespaces(self):
        return sorted(
            {(end.node_name, "/") for ends in (self.writers, self.readers) for some in ends.values() for end in some}
        )

    def get_publisher_names_and_types_by_node(self, name, _namespace):
        return [(topic, []) for topic, ends in self.writers.items() if any(end.node_name == name for end in ends)]

    def get_subscriber_names_and_types_by_node(self, name, _namespace):
        return [(topic, []) for topic, ends in self.readers.items() if any(end.node_name == name for end in ends)]

    @property
    def handle(self):
        return self

    def __enter__(self):
        return None

    def __exit__(self, *_):
        return None

    def get_count_publishers(self, topic):
        return len(self.writers.get(topic, []))

    def get_count_subscribers(self, topic):
        return len(self.readers.get(topic, []))

    def reads(self):
        read, self.read = self.read, Counter()
        return {topic: number for topic, number in read.items() if topic in TOPICS}


@pytest.fixture
def node():
    return Graphed()


def test_a_topic_whose_numbers_are_the_same_is_read_at_every_tenth_look(node):
    """Of ten looks one reads a topic, and no look reads them all."""
    graph = GraphReader(node, FASTDDS)
    graph.read()
    assert node.reads() == dict.fromkeys(TOPICS, 1)
    looks = []
    for _ in range(10):
        assert set(graph.read().crossings) == set(TOPICS)
        looks.append(node.reads())
    assert sum(map(Counter, looks), Counter()) == dict.fromkeys(TOPICS, 1)
    assert max(map(len, looks)) < len(TOPICS) / 3


def test_a_writer_or_reader_that_comes_or_goes_is_seen_at_once(node):
    """A topic with other numbers, or with other nodes in the same number, is read at the next look."""
    graph = GraphReader(node, FASTDDS)
    assert graph.read().crossings["/t3"].remote_readers == 1
    node.readers["/t3"].append(endpoint("/late", host=2, number=9, deadline_ns=50_000_000))
    seen = graph.read().crossings["/t3"]
    assert (seen.remote_readers, seen.tightest_request_ns()) == (2, 50_000_000)
    node.readers["/t3"].clear()
    assert graph.read().crossings["/t3"].remote_readers == 0
    node.readers["/t4"] = [endpoint("/other", host=2, deadline_ns=80_000_000)]
    assert graph.read().crossings["/t4"].tightest_request_ns() == 80_000_000


def test_topics_in_question_are_always_read(node):
    """A reader that another one replaces keeps the numbers, so topics where one is expected are read."""
    graph = GraphReader(node, FASTDDS)
    graph.read()
    node.readers["/t5"] = [endpoint("/listener", host=2, deadline_ns=80_000_000)]
    for _ in range(3):
        assert graph.read(always={"/t5"}).crossings["/t5"].tightest_request_ns() == 80_000_000


def test_a_node_without_a_name_is_read_until_it_has_one(node):
    """The name of a node comes later than its writer, with the same numbers."""
    node.writers["/t5"] = [endpoint("/_NODE_NAME_UNKNOWN_")]
    graph = GraphReader(node, FASTDDS)
    assert graph.read().crossings["/t5"].writers == {""}
    node.writers["/t5"] = [endpoint("/named")]
    assert graph.read().crossings["/t5"].writers == {"/named"}


def test_the_robot_is_known_as_soon_as_the_daemon_has_a_writer(node):
    """Directions depend on the robot's host, so they are found again when it is known."""
    prices = node.writers.pop(PRICE_TOPIC)
    graph = GraphReader(node, FASTDDS)
    assert graph.read().crossings["/t1"].direction == "local"
    node.writers[PRICE_TOPIC] = prices
    assert graph.read().crossings["/t1"].direction == "sensing"


def test_processes_across_the_link_are_counted_once(node):
    """Every node writes /rosout or /parameter_events; several nodes of a process count once, the robot's do not."""
    node.writers["/rosout"] = [endpoint("/a", host=2), endpoint("/b", host=2), endpoint("/c", host=2, number=2)]
    node.writers["/parameter_events"] = [endpoint("/d"), endpoint("/e", host=3)]
    assert GraphReader(node, FASTDDS).read().remote_participants == 3


def test_a_real_graph_is_followed(ros, eventually):
    """Writers and readers that come and go show in a real graph, and no process is across the link."""
    node = ros.node("arpd")
    node.create_publisher(Float64MultiArray, PRICE_TOPIC, 1)
    graph = GraphReader(node, current_rmw())
    talker = ros.node("talker").create_publisher(String, "/x", 10)
    eventually(lambda: "/x" in (seen := graph.read().crossings) and seen["/x"].writers == {"/talker"})
    ros.node("listener").create_subscription(String, "/x", lambda _m: None, 10)
    eventually(lambda: graph.read().crossings["/x"].readers == {"/listener"})
    assert graph.read().remote_participants == 0
    talker.destroy()
    eventually(lambda: graph.read().crossings["/x"].writers == frozenset())


def test_a_graph_of_many_topics_is_counted_and_read_in_parts(node, monkeypatch):
    """No look counts or reads more than a part of 1,000 topics; a node that comes is seen at once all the same."""
    topics = [f"/many{number}" for number in range(1000)]
    monkeypatch.setattr(node, "get_topic_names_and_types", lambda: [(topic, []) for topic in topics])
    node.writers |= {topic: [endpoint()] for topic in topics}
    counted = Counter()
    count = node.get_count_publishers
    monkeypatch.setattr(node, "get_count_publishers", lambda topic: counted.update([topic]) or count(topic))
    graph = GraphReader(node, FASTDDS)
    graph.read()
    counted.clear()
    node.read.clear()
    graph.read()
    assert 0 < len(counted) < 300
    assert len(node.read) < 40
    node.readers["/many7"] = [endpoint("/late", host=2)]
    assert graph.read().crossings["/many7"].remote_readers == 1
    node.writers["/many8"].append(endpoint(number=9, deadline_ns=50_000_000))
    seen = [graph.read().crossings["/many8"].offers_ns for _ in range(10)]
    assert seen[-1] == (0, 50_000_000)
