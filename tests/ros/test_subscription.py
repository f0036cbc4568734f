"""AdaptiveSubscription with real rclpy and Fast DDS on this host."""

import time
from dataclasses import replace
from itertools import pairwise

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from arpd import AdaptiveSubscription
from arpd.adapters.ros.rmw import rmw_of
from tests.chaos.world import is_gapless
from tests.ros.setter import Setter

pytestmark = pytest.mark.ros
TOPIC = "/heard"
DEPTH = f"qos_overrides.{TOPIC}.subscription.depth"
DEADLINE = f"qos_overrides.{TOPIC}.subscription.deadline"
EXECUTORS = [SingleThreadedExecutor, MultiThreadedExecutor, EventsExecutor]


class Talker:
    """Writes consecutive numbers."""

    def __init__(self, node, qos=5000):
        self.publisher, self.sent = node.create_publisher(String, TOPIC, qos), 0

    def at(self, rate_hz):
        def work(stopping):
            while not stopping.is_set():
                self.say()
                time.sleep(1 / rate_hz)

        return work

    def say(self):
        self.publisher.publish(String(data=str(self.sent)))
        self.sent += 1


@pytest.fixture
def talker(ros):
    return Talker(ros.node("talker"))


def setter(ros):
    return Setter(ros.node("tuner"), "/listener", TOPIC, "subscription")


@pytest.fixture
def hear(ros):
    """Make an AdaptiveSubscription in a node of its own, and what it received."""

    def make(qos=2000, executor=SingleThreadedExecutor, **options):
        received = []
        node = ros.node("listener", executor(context=ros.context))
        subscription = AdaptiveSubscription(node, String, TOPIC, received.append, qos, **options)
        return subscription, received

    return make


def numbers(received):
    return [int(message.data) for message in received]


def done(subscription):
    return sum(subscription.state().swaps_by_result.values())


@pytest.mark.parametrize("executor", EXECUTORS)
def test_swaps_lose_double_and_reorder_nothing(ros, hear, background, eventually, executor):
    """Eight swaps under 300 Hz deliver every message once and in order."""
    talker = Talker(ros.node("talker"))
    subscription, received = hear(executor=executor)
    configure = setter(ros)
    eventually(lambda: subscription.get_publisher_count() == 1)
    background(talker.at(300))
    eventually(lambda: len(received) > 20)
    for k in range(8):
        assert configure(depth=1000 + k).successful
        eventually(lambda k=k: subscription.state().depth == 1000 + k)
    so_far = talker.sent
    eventually(lambda: numbers(received)[-1] >= so_far)
    assert is_gapless(numbers(received))
    assert set(subscription.state().swaps_by_result) <= {"ok", "incomplete"}
    assert done(subscription) == 8


def test_swaps_under_a_reentrant_group_lose_and_double_nothing(ros, talker, hear, background, eventually):
    """Callbacks that may run in parallel receive every message once; the executor decides the order."""
    subscription, received = hear(executor=MultiThreadedExecutor, callback_group=ReentrantCallbackGroup())
    eventually(lambda: subscription.get_publisher_count() == 1)
    background(talker.at(200))
    eventually(lambda: len(received) > 20)
    for k in range(4):
        subscription.renew(replace(subscription.qos, depth=1000 + k))
        eventually(lambda k=k: subscription.state().depth == 1000 + k)
    so_far = talker.sent
    eventually(lambda: max(numbers(received)) >= so_far)
    time.sleep(0.5)
    assert is_gapless(sorted(numbers(received)))


@pytest.mark.parametrize("executor", EXECUTORS)
def test_a_callback_may_ask_for_message_info(ros, talker, eventually, executor):
    """Message and MessageInfo reach a callback of two arguments on every executor."""
    received = []
    node = ros.node("listener", executor(context=ros.context))
    subscription = AdaptiveSubscription(node, String, TOPIC, lambda *pair: received.append(pair), 10)
    assert subscription.callback
    subscription.callback = lambda message, info: received.append((message.data, info["publication_sequence_number"]))
    eventually(lambda: subscription.get_publisher_count() == 1)
    talker.say()
    eventually(lambda: received == [("0", 1)])


def test_raw_messages_are_bytes(talker, hear, eventually):
    """A raw subscription delivers serialized messages, as rclpy does."""
    subscription, received = hear(raw=True)
    eventually(lambda: subscription.get_publisher_count() == 1)
    talker.say()
    eventually(lambda: len(received) == 1)
    assert deserialize_message(received[0], String).data == "0"


def test_a_coroutine_is_awaited(ros, talker, eventually):
    """A coroutine function as callback is awaited, as rclpy does."""
    received = []

    async def remember(message):
        received.append(message.data)

    subscription = AdaptiveSubscription(ros.node("listener"), String, TOPIC, remember, 10)
    eventually(lambda: subscription.get_publisher_count() == 1)
    talker.say()
    eventually(lambda: received == ["0"])


def test_a_wrong_callback_is_refused(ros):
    """A callback with three arguments is refused at once, as in rclpy."""
    with pytest.raises(RuntimeError, match="MessageInfo"):
        AdaptiveSubscription(ros.node("listener"), String, TOPIC, lambda _a, _b, _c: None, 10)


def test_a_tighter_deadline_waits_for_the_writers(ros, hear, eventually):
    """A deadline shorter than a publisher offers is refused with the publisher's name; a longer one is taken."""
    node = ros.node("talker")
    offer = QoSProfile(depth=10, deadline=Duration(nanoseconds=500_000_000))
    loose = Talker(node, offer)
    subscription, received = hear()
    configure = setter(ros)
    eventually(lambda: subscription.get_publisher_count() == 1)
    result = configure(deadline=100_000_000)
    assert not result.successful
    assert "/talker offers 500000000 ns" in result.reason
    assert "shorten their deadlines first" in result.reason
    assert configure(deadline=600_000_000).successful
    eventually(lambda: subscription.state().deadline_ns == 600_000_000)
    loose.say()
    eventually(lambda: numbers(received) == [0])


def test_a_reader_that_does_not_match_is_undone(ros, talker, hear, background, eventually):
    """When the publishers do not match the new reader, the old one stays, delivers, and the refusal has a reason."""
    subscription, received = hear()
    eventually(lambda: subscription.get_publisher_count() == 1)
    background(talker.at(100))
    subscription.renew(replace(subscription.qos, deadline_ns=1_000_000))  # past the check of the parameters
    eventually(lambda: "not all publishers matched" in subscription.state().refusal)
    assert subscription.state().deadline_ns == 0
    so_far = talker.sent
    eventually(lambda: received and numbers(received)[-1] >= so_far)
    assert is_gapless(numbers(received))


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"depth": 0}, "outside 1..5000"),
        ({"depth": 5001}, "outside 1..5000"),
        ({"depth": "ten"}, "Wrong parameter type"),
        ({"deadline": -1}, "negative"),
    ],
)
def test_nonsense_is_refused_with_a_reason(ros, hear, values, reason):
    """A bad value is refused with a reason, and no swap begins."""
    subscription, _ = hear(qos=10)
    result = setter(ros)(**values)
    assert not result.successful
    assert reason in result.reason
    assert not subscription.state().swaps_by_result
    assert subscription.state().depth == 10


def test_a_latched_subscription_is_not_swapped(ros, hear):
    """A TRANSIENT_LOCAL reader stays: a new one would receive the history again."""
    hear(qos=QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL))
    result = setter(ros)(depth=5)
    assert not result.successful
    assert "TRANSIENT_LOCAL" in result.reason


def test_a_middleware_that_was_not_measured_keeps_its_readers(ros, hear):
    """On another RMW than Fast DDS a change is refused with the RMW's name."""
    hear(rmw=rmw_of("rmw_cyclonedds_cpp"))
    result = setter(ros)(depth=5)
    assert not result.successful
    assert "rmw_cyclonedds_cpp" in result.reason


def test_best_effort_readers_are_swapped_too(ros, hear, background, eventually):
    """A best-effort subscription takes a new depth, and no message comes twice."""
    best_effort = QoSProfile(depth=500, reliability=QoSReliabilityPolicy.BEST_EFFORT)
    talker = Talker(ros.node("talker"), best_effort)
    subscription, received = hear(qos=best_effort)
    eventually(lambda: subscription.get_publisher_count() == 1)
    background(talker.at(200))
    for depth in (600, 700):
        subscription.renew(replace(subscription.qos, depth=depth))
        eventually(lambda depth=depth: subscription.state().depth == depth)
    so_far = talker.sent
    eventually(lambda: received and numbers(received)[-1] >= so_far)
    assert numbers(received) == sorted(set(numbers(received)))


def test_overrides_given_at_the_start_are_in_force(ros):
    """Depth and deadline from --ros-args overrides are in force, and bad ones are refused."""
    overrides = [Parameter(DEPTH, value=77), Parameter(DEADLINE, value=50_000_000)]
    node = ros.node("overridden", parameter_overrides=overrides)
    state = AdaptiveSubscription(node, String, TOPIC, lambda _m: None, 10).state()
    assert (state.depth, state.deadline_ns) == (77, 50_000_000)
    node = ros.node("wrong", parameter_overrides=[Parameter(DEPTH, value=0)])
    with pytest.raises(ValueError, match=r"outside 1\.\.5000"):
        AdaptiveSubscription(node, String, TOPIC, lambda _m: None, 10)
    assert not node.get_subscriptions_info_by_topic(TOPIC)[1:]


def test_two_subscriptions_of_one_topic_in_one_node_are_refused(ros, eventually):
    """A second AdaptiveSubscription of a topic in one node is refused until the first is destroyed."""
    node = ros.node("listener")
    first = AdaptiveSubscription(node, String, TOPIC, lambda _m: None, 10)
    with pytest.raises(ValueError, match="already has an AdaptiveSubscription"):
        AdaptiveSubscription(node, String, TOPIC, lambda _m: None, 10)
    first.destroy()
    assert not node.has_parameter(DEPTH)
    eventually(lambda: not node.get_subscriptions_info_by_topic(TOPIC))  # the graph follows in a thread of its own
    AdaptiveSubscription(node, String, TOPIC, lambda _m: None, 10).destroy()


def test_destroy_in_the_middle_of_a_swap_leaves_nothing(ros, talker, hear, eventually):
    """A subscription destroyed while two readers exist destroys both."""
    subscription, _ = hear()
    node = subscription._node
    eventually(lambda: subscription.get_publisher_count() == 1)
    subscription.renew(replace(subscription.qos, depth=5))
    eventually(lambda: len(node.get_subscriptions_info_by_topic(TOPIC)) == 2)
    subscription.destroy()
    eventually(lambda: not node.get_subscriptions_info_by_topic(TOPIC))


def test_readers_that_swap_together_leave_the_executor_time(ros, monkeypatch, eventually):
    """Between two readers that a plan makes, the node's executor serves other callbacks."""
    node, log = ros.node("listener"), []

    def slow(self, qos, make=AdaptiveSubscription._create_reader):
        time.sleep(0.02)
        log.append("reader")
        return make(self, qos)

    monkeypatch.setattr(AdaptiveSubscription, "_create_reader", slow)
    readers = [AdaptiveSubscription(node, String, f"/heard{k}", log.append, 10) for k in range(6)]
    log.clear()
    node.create_timer(0.005, lambda: log.append("other"))
    node.set_parameters_atomically(
        [Parameter(f"qos_overrides.{reader.topic_name}.subscription.depth", value=50) for reader in readers]
    )
    eventually(lambda: log.count("reader") == 6)
    assert "reader" not in [after for before, after in pairwise(log) if before == "reader"]
    eventually(lambda: {reader.qos.depth for reader in readers} == {50})


@pytest.mark.parametrize("has_callback", [False, True], ids=["without callback", "with callback"])
def test_missed_deadlines_are_counted(ros, hear, eventually, has_callback):
    """The reader counts a silent writer's misses, with a callback and without; a swap keeps the count."""
    heard = []
    options = {"event_callbacks": SubscriptionEventCallbacks(deadline=heard.append)} if has_callback else {}
    talker = Talker(ros.node("talker"), QoSProfile(depth=10, deadline=Duration(nanoseconds=50_000_000)))
    subscription, received = hear(QoSProfile(depth=10, deadline=Duration(nanoseconds=60_000_000)), **options)
    eventually(lambda: talker.publisher.get_subscription_count() == 1)
    assert subscription.state().deadlines_missed == 0
    talker.say()
    eventually(lambda: received)
    eventually(lambda: subscription.state().deadlines_missed >= 3)
    assert bool(heard) == has_callback
    missed = subscription.state().deadlines_missed
    subscription.renew(replace(subscription.qos, depth=20, deadline_ns=0))
    eventually(lambda: done(subscription) == 1)
    counted = subscription.state().deadlines_missed
    assert counted >= missed
    talker.say()
    eventually(lambda: len(received) == 2)
    assert subscription.state().deadlines_missed == counted
    assert not has_callback or heard[-1].total_count >= counted
