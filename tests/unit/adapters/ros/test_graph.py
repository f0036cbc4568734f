"""Look-ups of the graph: numbers first, and endpoints only where something has changed."""

from collections import Counter
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.adapters.ros.graph import GraphReader
from arpd.adapters.ros.names import PRICE_TOPIC
from arpd.adapters.ros.rmw import rmw_of

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


@pytest.fixture
def node():
    return Graphed()


def test_a_writer_or_reader_that_comes_or_goes_is_seen_at_once(node):
    """A topic with other numbers, or with other nodes in the same number, is read at the next look."""
    graph = GraphReader(node, FASTDDS)
    assert graph.read().crossings["/t3"].remote_readers == 1
    node.readers["/t3"].append(endpoint("/late", host=2, number=9, deadline_ns=50_000_000))
    seen = graph.read().crossings["/t3"]
    assert (seen.remote_readers, seen.tightest_request_ns) == (2, 50_000_000)
    node.readers["/t3"].clear()
    assert graph.read().crossings["/t3"].remote_readers == 0
    node.readers["/t4"] = [endpoint("/other", host=2, deadline_ns=80_000_000)]
    assert graph.read().crossings["/t4"].tightest_request_ns == 80_000_000
