"""ParameterEvents, plans and parameter services of a node with arpd's parameters, with real rclpy."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rcl_interfaces.msg import ParameterEvent
from rclpy.exceptions import InvalidParameterTypeException, ParameterAlreadyDeclaredException
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import qos_profile_parameter_events
from std_msgs.msg import String

from arpd import AdaptivePublisher, AdaptiveSubscription
from arpd.adapters.ros.own_parameters import OwnParameters
from arpd.adapters.ros.plan_message import PlanAnswer
from arpd.adapters.ros.plan_sender import PlanSender
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


def no_answer(_node):
    return PlanAnswer()


def steps():
    row = TopicPlan(rate_hz=50.0, min_rate_hz=1.0, deadline_ns=10**8, depth=40, **TERMS)
    read = ReaderPlan(depth=9, deadline_ns=0)
    return [
        Transition(node="/talker", generation=3, topics=dict.fromkeys(TOPICS, row), reason="test", lease_s=30.0),
        Transition(node="/talker", generation=3, topics={}, readers={"/read": read}, reason="test", lease_s=30.0),
    ]


def get(node, name):
    return node.get_parameter(name).value


def test_a_plan_is_shown_and_is_no_event(ros, node, events, eventually):
    """A plan comes into force at once, the parameters show it, and nobody receives an event."""
    publishers = [AdaptivePublisher(node, String, topic, 10) for topic in TOPICS]
    AdaptiveSubscription(node, String, "/read", lambda _message: None, 10)
    mark(node, events, eventually, "declared")
    sender = PlanSender(ros.node("daemon"), publishers_answer=no_answer, readers_answer=no_answer)
    sender.apply(steps(), now_s=0.0)
    eventually(lambda: get(node, "qos_overrides./read.subscription.depth") == 9)
    assert all(publisher.plan.depth == 40 for publisher in publishers)
    assert [get(node, name) for name in (DEPTH, "arpd./topic0.publisher.rate", "arpd./topic0.publisher.packets")] == [
        40,
        50.0,
        TERMS["packets"],
    ]
    assert [get(node, f"arpd.{half}") for half in ("generation", "lease", "readers.generation", "readers.lease")] == [
        *(3, 30.0),
        *(3, 30.0),
    ]
    mark(node, events, eventually, "planned")
    assert set(events.names) <= {"begin", "declared", "planned"}, events.names


def test_what_is_set_by_hand_is_an_event(node, events, eventually):
    """A change by hand is an event, as of any parameter."""
    publisher = AdaptivePublisher(node, String, TOPICS[0], 10)
    assert node.set_parameters([Parameter(DEPTH, value=33)])[0].successful
    eventually(lambda: DEPTH in events.names)
    assert publisher.plan.depth == 33


def test_a_wrong_type_is_refused_as_ever(node):
    """A declared parameter keeps its type."""
    AdaptivePublisher(node, String, TOPICS[0], 10)
    assert not node.set_parameters([Parameter(DEPTH, value=3.5)])[0].successful
    assert get(node, DEPTH) == 10


def test_an_override_given_at_the_start_is_in_force(ros):
    """A value on the command line is read by rclpy, and one of another type is refused by it."""
    node = ros.node("started", parameter_overrides=[Parameter(DEPTH, value=33)])
    assert AdaptivePublisher(node, String, TOPICS[0], 10).plan.depth == 33
    node = ros.node("spoilt", parameter_overrides=[Parameter(DEPTH, value="many")])
    with pytest.raises(InvalidParameterTypeException):
        AdaptivePublisher(node, String, TOPICS[0], 10)


def test_a_parameter_of_the_application_is_not_taken(node):
    """A name that arpd cannot declare stays the application's."""
    node.declare_parameter("speed", 1.0)
    with pytest.raises(ParameterAlreadyDeclaredException):
        OwnParameters(node).declare("speed", 2.0, "")
    assert get(node, "speed") == 1.0


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
