"""AdaptivePublisher with real rclpy and Fast DDS on this host."""

import math
import os
import re
import signal
import threading
import time
from dataclasses import replace

import pytest
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import Parameter
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSLivelinessPolicy,
    QoSPolicyKind,
    QoSProfile,
    QoSReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_msgs.msg import Float64MultiArray, String

from arpd import AdaptivePublisher
from arpd.govern.plan import is_confirmed
from arpd.model.endpoints import Overflow, RefusalReason, SwapTiming, WriterQos
from arpd.model.plan import TopicPlan
from arpd.model.price import Price
from arpd.ros.names import PRICE_TOPIC
from arpd.ros.price_message import encode_price
from arpd.ros.rcl import InvalidHandle
from tests.ros.ends_world import listen
from tests.ros.world import FREE, TERMS, Announced, Plans, costing, retune
from tests.waiting import PATIENCE_S

TOPIC = "/swapped"
LEASE_S = 60.0  # longer than a busy machine stops a process
# This host loses nothing, so readers match at once. And it waits: no swap goes on without its acknowledgements.
PATIENT = SwapTiming(settle_s=0.1, hold_s=60.0, patience_s=60.0, match_timeout_s=60.0, drain_s=60.0)


@pytest.fixture
def node(ros, clock):
    return clock.rule(ros.node("talker"))


@pytest.fixture
def publisher(node, clock):
    return AdaptivePublisher(node, String, TOPIC, 10, swap_timing=PATIENT, clock=clock)


@pytest.fixture
def send_price(ros, publisher, eventually):
    """Send a price again and again, because its topic is best effort, until a condition holds."""
    sender = ros.node("governor").create_publisher(Float64MultiArray, PRICE_TOPIC, 1)
    eventually("the publisher listens", sender.get_subscription_count)

    def until(price, what, condition):
        message = Float64MultiArray(data=encode_price(price))
        eventually(what, lambda: sender.publish(message) or condition())

    return until


def is_paced_at(publisher, rate_hz):
    return lambda: publisher.state().paced_rate_hz == pytest.approx(rate_hz)


def publish_at(publisher, rate_hz):
    def work(stopping):
        number = 0
        while not stopping.wait(1 / rate_hz):
            publisher.publish(String(data=str(number)))
            number += 1

    return work


def test_the_rate_follows_the_price_down_to_the_floor(publisher, send_price):
    """A price lowers the rate to what it buys, not below the floor and only with a weight; a better one raises it."""
    retune(publisher, rate_hz=100.0, min_rate_hz=20.0)
    send_price(costing(5.0), "the price arrives", lambda: publisher._flow.lane.price)
    assert is_paced_at(publisher, 100.0)(), "a rate that was set by hand has no price"
    retune(publisher, **TERMS)
    assert is_paced_at(publisher, 20.0)()
    for price, rate_hz in ((costing(50.0), 50.0), (costing(1.0), 20.0), (FREE, 100.0)):
        send_price(price, "the rate follows the price", is_paced_at(publisher, rate_hz))


def test_a_callback_that_sleeps_delays_no_price(publisher, send_price, eventually):
    """While the node's executor is inside a callback of the application, its publishers follow the price."""
    retune(publisher, rate_hz=100.0, min_rate_hz=1.0, **TERMS)
    sleeps, may_wake = threading.Event(), threading.Event()
    publisher._node.create_timer(0.01, lambda: sleeps.set() or may_wake.wait(PATIENCE_S))
    eventually("the executor is busy", sleeps.is_set)
    send_price(costing(50.0), "the rate follows the price", is_paced_at(publisher, 50.0))
    may_wake.set()


def test_large_samples_of_two_nodes_cross_one_at_a_time(ros, clock, publisher, send_price, eventually):
    """Of two large samples of a participant that leave together the second waits until the first has crossed."""
    other = AdaptivePublisher(clock.rule(ros.node("second")), String, "/other", 10, clock=clock)
    large = {"weight": 1.0, "wire_bytes": 60_000.0, "packets": 40}
    row = TopicPlan(rate_hz=0.002, min_rate_hz=0.0, deadline_ns=0, depth=10, **large)
    for one in (publisher, other):
        one.retune(row)
    crosses_in_200_s = Price(share_per_weight=math.inf, capacity_bytes_per_second=300.0)
    send_price(crosses_in_200_s, "both know it", lambda: publisher._flow.lane.price and other._flow.lane.price)
    large = String(data=60_000 * "x")
    publisher.pass_on(large)
    eventually("the first leaves", lambda: publisher.state().published == 1)
    other.publish(large)
    assert (other.state().published, other.state().queued) == (0, 1)
    clock.skip(300.0)
    eventually("the second leaves", lambda: other.state().published == 1)
    assert publisher.state().published == 1


def test_a_forked_process_that_shuts_rclpy_down_ends(ros, eventually):
    """It destroys no reader: the middleware would wait for threads that only its parent has."""
    talker = ros.elsewhere().idle_node("talker")  # an executor's thread could hold the lock of its context at the fork
    publisher = AdaptivePublisher(talker, String, TOPIC, 10)
    child = os.fork()
    if not child:
        talker.context.shutdown()
        os._exit(publisher._shared._inboxes[0]._reader._is_destroyed)
    try:
        eventually("the child ends", lambda: os.waitpid(child, os.WNOHANG) == (child, 0))
    except AssertionError:
        os.kill(child, signal.SIGKILL)
        raise


def test_silence_ends_the_wait_for_a_plan_and_no_price(clock, publisher, send_price, eventually):
    """After some seconds without a price no new topic waits for a plan, and a topic with a plan keeps the price."""
    send_price(costing(5.0), "the daemon is noticed", lambda: publisher._flow.lane.price)

    def has_no_daemon():
        clock.skip(6.0)  # more than once, because a last price may still be under way
        return publisher._flow.lane.price is None

    eventually("its silence is noticed", has_no_daemon)
    retune(publisher, rate_hz=100.0, **TERMS)
    assert is_paced_at(publisher, 5.0)(), "a plan finds the last price"


def test_a_plan_outlives_its_daemon_only_as_long_as_was_granted(ros, clock, publisher, send_price, eventually):
    """Plan and price stay while the price comes, and end with the lease; a returning daemon plans again."""
    send_plan = Plans(ros.node("planner"))
    row = TopicPlan(rate_hz=100.0, min_rate_hz=1.0, deadline_ns=10**9, depth=40, **TERMS)

    def plan_and_price(generation, *rates_hz):
        send_plan(generation, {TOPIC: row}, lease_s=LEASE_S)
        eventually("the plan is in force", lambda: publisher.plan == row)
        for rate_hz in rates_hz:
            clock.skip(0.9 * LEASE_S)
            send_price(costing(rate_hz), "the price is in force", is_paced_at(publisher, rate_hz))

    def has_ended():
        clock.skip(1.1 * LEASE_S)  # more than once, because a last price may still be under way
        return (publisher.plan.depth, publisher.plan.rate_hz) == (10, math.inf)

    plan_and_price(7, 10.0, 20.0, 30.0)
    assert publisher.plan == row
    eventually("the plan ends", has_ended)
    eventually("the price ends", lambda: publisher.state().paced_rate_hz == math.inf)
    plan_and_price(1, 50.0)  # of another daemon, without knowledge of its predecessor


def writers_of(node):
    return [writer for writer in node.publishers if writer.topic_name == TOPIC]


def test_a_topic_has_one_publisher_in_a_node(node, publisher):
    """A second one is refused and leaves no writer; once the first is destroyed, another one may follow."""
    with pytest.raises(ValueError, match="already has an AdaptivePublisher"):
        AdaptivePublisher(node, String, TOPIC, 10)
    assert writers_of(node) == [publisher, publisher._flow.swap.current.publisher]
    publisher.destroy()
    assert not writers_of(node)
    other = AdaptivePublisher(node, String, TOPIC, 99)
    assert other.baseline.depth == 99
    publisher.destroy()  # again, as rclpy allows
    with pytest.raises(ValueError, match="already has an AdaptivePublisher"):
        AdaptivePublisher(node, String, TOPIC, 10)
    other.destroy()


def test_who_waits_for_acknowledgements_waits_for_the_queue(ros, node, clock, eventually):
    """What waits for its turn is not acknowledged: an application that has waited may destroy its publisher."""
    heard = []
    ros.node("listener").create_subscription(String, TOPIC, lambda message: heard.append(message.data), 10)
    publisher = AdaptivePublisher(node, String, TOPIC, 10, overflow=Overflow.QUEUE, clock=clock)
    eventually("the reader matches", lambda: publisher.publish(String(data="hello")) or heard)
    retune(publisher, rate_hz=0.001, max_rate_hz=0.001)
    for number in "0123456789":
        publisher.publish(String(data=number))
    assert not publisher.wait_for_all_acked(Duration(seconds=0))
    retune(publisher, rate_hz=50.0, max_rate_hz=50.0)
    assert publisher.wait_for_all_acked(Duration(seconds=int(PATIENCE_S)))
    assert publisher.state().queued == 0
    publisher.destroy()
    eventually("all arrive", lambda: heard[-10:] == [*"0123456789"])


def test_overflow_takes_the_word_of_the_manual(node, clock):
    """`overflow="queue"` keeps what waits, as `Overflow.QUEUE` does."""
    publisher = AdaptivePublisher(node, String, TOPIC, 10, overflow="queue", clock=clock)
    retune(publisher, rate_hz=0.001, max_rate_hz=0.001)
    for number in "0123456789":
        publisher.publish(String(data=number))
    assert publisher.state().withheld == 0
    publisher.destroy()


@pytest.mark.parametrize("topic", ["bad name!", "/a/{foo}", ""])
def test_a_wrong_name_is_refused_as_rclpy_refuses_it(node, topic):
    """By the same error, which names it."""
    with pytest.raises(Exception, match=r"(?i)invalid|empty") as plain:
        node.create_publisher(String, topic, 10)
    with pytest.raises(type(plain.value)) as ours:
        AdaptivePublisher(node, String, topic, 10)
    assert str(ours.value) == str(plain.value)


def test_a_publisher_that_is_slowed_stays_alive(node, clock):
    """With MANUAL_BY_TOPIC what is published asserts its liveliness, though it waits or is withheld."""
    manual = QoSProfile(
        depth=1,
        liveliness=QoSLivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(seconds=LEASE_S),
    )
    publisher, asserted = AdaptivePublisher(node, String, TOPIC, manual, clock=clock), []
    publisher.retune(TopicPlan(rate_hz=0.01, min_rate_hz=0.0, deadline_ns=0, depth=1))
    publisher._flow.swap.current.publisher.assert_liveliness = lambda: asserted.append(None)
    for part in (0.0, 0.1, 0.2, 0.01, 0.3):
        clock.skip(part * LEASE_S)
        publisher.publish(String())
    assert len(asserted) == 3, "a quarter of a lease apart, because each is a packet"


@pytest.mark.parametrize(
    ("qos", "overflow", "fault", "words"),
    [
        (-1, "latest", ValueError, "depth must be greater than or equal to zero"),
        ("10", "latest", TypeError, "Expected QoSProfile or int"),
        (10, "oldest", ValueError, "'oldest' is not a valid Overflow"),
    ],
)
def test_a_wrong_argument_is_refused_by_name(node, qos, overflow, fault, words):
    """As `create_publisher` does; and no writer stays."""
    with pytest.raises(fault, match=words):
        AdaptivePublisher(node, String, TOPIC, qos, overflow=overflow)
    assert not writers_of(node)


def test_its_node_destroys_it_as_any_publisher(node, publisher):
    """`destroy_publisher` ends it once, and what is called then fails as with rclpy; so it does after a shutdown."""
    assert node.destroy_publisher(publisher)
    assert not node.destroy_publisher(publisher)
    assert not writers_of(node)
    with pytest.raises(InvalidHandle):
        publisher.publish(String())
    other = AdaptivePublisher(node, String, TOPIC, 99)
    node.context.shutdown()
    with pytest.raises(
        rclpy_implementation.RCLError, match=f"{TOPIC}: Failed to publish: publisher's context is invalid"
    ):
        other.publish(String())


@pytest.mark.parametrize("end", ["destroyed", "shut down"])
def test_the_last_sample_leaves_at_the_end(ros, eventually, end):
    """What waits for its turn is written when its publisher or its context ends: it may tell a robot to stop."""
    received = listen(ros.node("robot"), TOPIC)
    node = ros.elsewhere().idle_node("operator")
    publisher = AdaptivePublisher(node, String, TOPIC, 10)
    retune(publisher, rate_hz=1e-3)
    eventually("the reader has matched", publisher.get_subscription_count)
    publisher.publish(String(data="begin"))
    eventually("the first one arrives", lambda: received)
    for word in ("go on", "go on", "stop"):
        publisher.publish(String(data=word))
    if end == "destroyed":
        node.destroy_node()
    else:
        node.context.shutdown()
    eventually("the last one arrives", lambda: received[-1] == "stop")


def test_who_ends_waits_shortly_for_the_readers_of_the_last_sample(node, publisher, monkeypatch):
    """Nobody would repeat the robot's command to stop; readers that are gone hold up all topics of a node together."""
    answers, thread = [True, False, False], publisher._thread
    monkeypatch.setattr(publisher._flow.swap.current, "is_acknowledged", answers.pop)
    with monkeypatch.context() as patient:
        patient.setattr(thread, "heard_by_s", lambda: math.inf)
        publisher.destroy()
    assert not answers
    until_s, heard_by_s = set(), thread.heard_by_s
    monkeypatch.setattr(thread, "heard_by_s", lambda: (at_s := heard_by_s(), until_s.add(at_s))[0])
    AdaptivePublisher(node, String, "/heard", 10).destroy()
    assert not until_s  # whose readers have all does not take of the time of others
    others = [AdaptivePublisher(node, String, f"/other_{number}", 10) for number in range(20)]
    for each in others:
        monkeypatch.setattr(each._flow.swap.current, "is_acknowledged", lambda: False)
    begun_s = time.monotonic()
    node.destroy_node()
    assert time.monotonic() - begun_s > 0.2
    assert len(until_s) < len(others) / 2  # one, unless this computer needs seconds for them


def test_the_function_of_a_signal_that_destroys_a_publisher_waits_for_no_other_thread(publisher, background):
    """Who gives it a price waits for the change of the queue that the signal has interrupted."""
    holds, may_end, has_ended = threading.Event(), threading.Event(), threading.Event()

    def hold(_stopping):
        with publisher._shared._lock:
            holds.set()
            may_end.wait(PATIENCE_S)
        has_ended.set()

    background(hold)
    assert holds.wait(PATIENCE_S)
    publisher.destroy()
    assert not has_ended.is_set()
    may_end.set()


def test_a_destroyed_node_leaves_nothing_and_the_others(ros, publisher, background, eventually):
    """It has left the graph and the queue when `destroy_node` returns; the daemon hears that at once, and others go on.

    The thread of their participant serves them. The last snapshot has no publishers, so nobody waits for its silence.
    """
    watcher, node = Announced(ros.node("watcher")), ros.idle_node("short_lived")
    for topic in (TOPIC, "/gone"):
        gone = AdaptivePublisher(node, String, topic, 10)
    assert gone._thread is publisher._thread
    gone.retune(TopicPlan(rate_hz=100.0, min_rate_hz=1.0, deadline_ns=0, depth=40))
    background(publish_at(publisher, 50))
    eventually("all are known", lambda: len(watcher.states) == 3)
    node.destroy_node()
    assert {*publisher._node.get_node_names()} == {"talker", "watcher"}
    assert publisher._thread.topics == 1
    eventually("it has no publishers", lambda: sorted(len(each.publishers) for each in watcher.snapshots) == [0, 1])
    retune(publisher, depth=30)
    eventually("the other node's writer is swapped", lambda: [state.depth for state in watcher.states] == [30])


@pytest.mark.parametrize(("entity", "entity_id"), [("publisher", None), ("publisher_left", "left")])
def test_overrides_given_at_the_start_are_the_application_s_own_qos(ros, entity, entity_id):
    """Depth and deadline of a parameter file are in force, and what returns when a plan ends; others are as rclpy's."""
    values = {"depth": 77, "deadline": 10**9, "reliability": "best_effort"}
    overrides = [Parameter(f"qos_overrides.{TOPIC}.{entity}.{name}", value=value) for name, value in values.items()]
    node = ros.node("overridden", parameter_overrides=overrides)
    options = QoSOverridingOptions([QoSPolicyKind.RELIABILITY], entity_id=entity_id)
    publisher = AdaptivePublisher(node, String, TOPIC, 10, qos_overriding_options=options)
    assert publisher.qos_profile.reliability == QoSReliabilityPolicy.BEST_EFFORT
    assert publisher.baseline == WriterQos(depth=77, deadline_ns=10**9)
    now = publisher.state()
    assert (now.depth, now.deadline_ns, now.baseline_depth) == (77, 10**9, 77)


@pytest.mark.parametrize(("name", "value"), [("depth", 0), ("deadline", -1), ("deadline", 5)])
def test_an_override_out_of_bounds_is_refused_by_name(ros, name, value):
    """The message names the parameter and what is wrong."""
    parameter = f"qos_overrides.{TOPIC}.publisher.{name}"
    node = ros.node("overridden", parameter_overrides=[Parameter(parameter, value=value)])
    with pytest.raises(ValueError, match=rf"{re.escape(parameter)}: {name}.* = '{value}' is "):
        AdaptivePublisher(node, String, TOPIC, 10)


REFUSED_ROW = TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=500_000_000, depth=40)


@pytest.mark.parametrize("durability", ["TRANSIENT_LOCAL", "SYSTEM_DEFAULT", "BEST_AVAILABLE"])
def test_a_latched_publisher_is_settled_by_its_rate(ros, durability):
    """A TRANSIENT_LOCAL topic refuses new QoS and says why; its rate confirms the plan. Fast DDS' default is one."""
    latched = QoSProfile(depth=3, durability=QoSDurabilityPolicy[durability])
    publisher = AdaptivePublisher(ros.node("talker"), String, "/map", latched)
    assert publisher.state().refusal_reason is RefusalReason.NONE
    publisher.retune(REFUSED_ROW)
    state = publisher.state()
    assert (state.refusal_reason, state.depth, state.rate_hz) == (RefusalReason.TRANSIENT_LOCAL, 3, 5.0)
    assert "late joiners" in state.refusal
    assert is_confirmed(state, REFUSED_ROW)
    publisher.retune(replace(REFUSED_ROW, depth=3, deadline_ns=0))
    assert not publisher.state().refusal


def test_a_publisher_that_keeps_all_gets_no_writer_for_a_depth(ros, eventually):
    """With KEEP_ALL a new depth makes no swap, a new deadline makes one, and the plan is confirmed."""
    publisher = AdaptivePublisher(ros.node("talker"), String, "/all", QoSProfile(history=QoSHistoryPolicy.KEEP_ALL))
    publisher.retune(TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=0, depth=40))
    assert not publisher._flow.swap.is_busy
    publisher.retune(REFUSED_ROW)
    eventually("the plan is confirmed", lambda: is_confirmed(publisher.state(), REFUSED_ROW))
    eventually("the swap ends", lambda: not publisher._flow.swap.is_busy)
    assert sum(publisher.state().swaps_by_result.values()) == 1


@pytest.mark.parametrize(
    ("overflow", "profile"),
    [("latest", QoSProfile(history=QoSHistoryPolicy.KEEP_ALL)), ("queue", QoSProfile(depth=1))],
    ids=["keep all", "queue"],
)
def test_no_sample_of_who_keeps_all_is_left_out_at_the_start(ros, overflow, profile):
    """Without a daemon a burst of large samples leaves as it comes, though no reader has the first one yet."""
    publisher = AdaptivePublisher(ros.node("talker"), String, "/all", profile, overflow=overflow)
    publisher._flow.swap.current.matched, publisher._flow.swap.current.is_acknowledged = (lambda: 1), (lambda: False)
    for _ in range(3):
        publisher.publish(String(data=50_000 * "x"))
    state = publisher.state()
    assert (state.published, state.queued, state.withheld) == (3, 0, 0)
