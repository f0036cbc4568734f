"""ParameterEvents and parameter services of a node with arpd's parameters, with real rclpy."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rcl_interfaces.msg import ParameterEvent
from rclpy.exceptions import ParameterAlreadyDeclaredException
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import qos_profile_parameter_events
from std_msgs.msg import String

from arpd import AdaptivePublisher, AdaptiveSubscription
from arpd.adapters.ros.own_parameters import OwnParameters
from arpd.adapters.ros.parameters import ParameterApplier
from arpd.model.plan import ReaderPlan, TopicPlan, Transition
from tests.ros.price import TERMS

pytestmark = pytest.mark.ros
TOPICS = [f"/topic{number}" for number in range(20)]
DEPTH = "qos_overrides./topic0.publisher.depth"


class Events:
    """The ParameterEvents of one node, by the names of their parameters."""

    def __init__(self, node, of):
        self._of = of
        self.names = []
        node.create_subscription(ParameterEvent, "/parameter_events", self._take, qos_profile_parameter_events)

    def _take(self, event):
        if event.node == self._of:
            self.names += [each.name for each in (*event.new_parameters, *event.changed_parameters)]


@pytest.fixture
def node(ros):
    return ros.node("talker")


@pytest.fixture
def events(ros, node, eventually):
    events = Events(ros.node("listener"), "/talker")
    eventually(lambda: node.count_subscribers("/parameter_events") and node.count_publishers("/parameter_events"))
    mark(node, events, eventually, "begin")
    return events


def mark(node, events, eventually, name):
    """Declare a parameter of the application, and wait for its event: earlier ones have then arrived."""

    def is_heard():
        node.declare_parameter(name, 1) if not node.has_parameter(name) else node.set_parameters(
            [Parameter(name, value=2)]
        )
        return name in events.names

    eventually(is_heard)


def steps():
    row = TopicPlan(rate_hz=50.0, min_rate_hz=1.0, deadline_ns=10**8, depth=40, **TERMS)
    read = ReaderPlan(depth=9, deadline_ns=0)
    return [
        Transition(node="/talker", generation=3, topics=dict.fromkeys(TOPICS, row), reason="test", lease_s=30.0),
        Transition(node="/talker", generation=3, topics={}, readers={"/read": read}, reason="test", lease_s=30.0),
    ]


def test_a_plan_is_no_event_and_the_applications_parameters_are(ros, node, events, eventually):
    """Neither arpd's parameters nor a plan for them cause an event; a parameter of the application does."""
    publishers = [AdaptivePublisher(node, String, topic, 10) for topic in TOPICS]
    AdaptiveSubscription(node, String, "/read", lambda _message: None, 10)
    mark(node, events, eventually, "declared")
    applier = ParameterApplier(ros.node("daemon"))
    eventually(lambda: applier.apply(steps(), now_s=0.0) or applier.results.get("ok") == 2)
    assert all(publisher.plan.depth == 40 for publisher in publishers)
    mark(node, events, eventually, "planned")
    assert set(events.names) <= {"begin", "declared", "planned"}, events.names


def test_of_a_call_for_both_only_the_applications_part_is_an_event(node, events, eventually):
    """An atomic call with parameters of both sets all, and its event has those of the application."""
    publisher = AdaptivePublisher(node, String, TOPICS[0], 10)
    node.declare_parameter("speed", 1.0)
    assert node.set_parameters_atomically([Parameter(DEPTH, value=33), Parameter("speed", value=2.0)]).successful
    eventually(lambda: events.names.count("speed") == 2)
    assert publisher.plan.depth == 33
    assert DEPTH not in events.names


def test_a_parameter_that_the_application_declared_keeps_its_events(node, events, eventually):
    """A name that arpd cannot declare stays the application's."""
    node.declare_parameter("speed", 1.0)
    with pytest.raises(ParameterAlreadyDeclaredException):
        OwnParameters.of(node).declare("speed", 2.0, "")
    node.set_parameters([Parameter("speed", value=3.0)])
    eventually(lambda: events.names.count("speed") == 2)


def test_the_parameter_services_know_them_as_ever(ros, node, eventually):
    """`ros2 param list`, `get`, `describe` and `set` work for arpd's parameters."""
    publisher = AdaptivePublisher(node, String, TOPICS[0], 10)
    client = AsyncParameterClient(ros.node("tool"), "/talker")
    assert client.wait_for_services(timeout_sec=10)

    def answer(future):
        eventually(future.done)
        return future.result()

    assert DEPTH in answer(client.list_parameters()).result.names
    assert [value.integer_value for value in answer(client.get_parameters([DEPTH])).values] == [10]
    assert "KEEP_LAST" in answer(client.describe_parameters([DEPTH])).descriptors[0].description
    assert answer(client.set_parameters([Parameter(DEPTH, value=12)])).results[0].successful
    assert publisher.plan.depth == 12
