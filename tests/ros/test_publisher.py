"""AdaptivePublisher with real rclpy and Fast DDS on this host; test_offers.py has who writes its samples, and when."""

import math
import re
import threading
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray, String

from arpd import AdaptivePublisher
from arpd.endpoint.writer_swap import SwapTiming
from arpd.model.endpoints import WriterQos
from arpd.model.plan import TopicPlan
from arpd.model.price import Price
from arpd.ros.raw_reader import Sample
from tests.ros.announced import Announced
from tests.ros.clock import SkippingClock
from tests.ros.price import FREE, TERMS, PriceSender, costing
from tests.ros.setter import Setter
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.ros
TOPIC = "/swapped"
DEPTH = f"qos_overrides.{TOPIC}.publisher.depth"
DEADLINE = f"qos_overrides.{TOPIC}.publisher.deadline"
DEEP = 2000  # at 200 Hz ten seconds
# This host loses nothing, so readers match at once. And it waits: no swap goes on without its acknowledgements.
PATIENT = SwapTiming(settle_s=0.1, hold_s=60.0, patience_s=60.0, match_timeout_s=60.0, drain_s=60.0)


class Reader:
    def __init__(self, node, qos=DEEP):
        self.received = []
        self.subscription = node.create_subscription(
            String, TOPIC, lambda message: self.received.append(int(message.data)), qos
        )

    def has_matched(self, publisher):
        """Return whether both sides of the only match know it."""
        return publisher.get_subscription_count() == 1 == self.subscription.get_publisher_count()


@pytest.fixture
def clock():
    return SkippingClock()


@pytest.fixture
def node(ros, clock):
    return clock.rule(ros.node("talker"))


@pytest.fixture
def publisher(node, clock):
    return AdaptivePublisher(node, String, TOPIC, 10, swap_timing=PATIENT, clock=clock)


@pytest.fixture
def configure(publisher):
    return Setter(publisher)


@pytest.fixture
def reader(ros, publisher, eventually):
    reader = Reader(ros.node("listener"))
    eventually("publisher and reader match", lambda: reader.has_matched(publisher))
    return reader


@pytest.fixture
def send_price(ros, publisher, eventually):
    """Send the price, again and again because its topic is best effort, until a condition holds."""
    send = PriceSender(ros.node("governor"))
    eventually("somebody listens to the price", lambda: send.listeners)

    def until(price, what, condition):
        def holds():
            send(price)
            return condition()

        eventually(what, holds)

    return until


def state(publisher):
    return publisher.state()


def is_paced_at(publisher, rate_hz):
    return lambda: state(publisher).paced_rate_hz == pytest.approx(rate_hz)


def publish_at(publisher, rate_hz):
    def work(stopping):
        number = 0
        while not stopping.wait(1 / rate_hz):
            publisher.publish(String(data=str(number)))
            number += 1

    return work


def test_swap_loses_nothing(publisher, reader, configure, background, eventually):
    """Eight swaps of depth and deadline under 200 Hz lose, double and reorder no message."""
    for k in range(9):
        configure(depth=DEEP + k, deadline=10**9 + k)
        eventually("the new depth is in force", lambda k=k: state(publisher).depth == DEEP + k)
        if k == 0:  # from now on a busy machine may stop this process for ten seconds without a loss
            background(publish_at(publisher, 200))
    eventually("the last swap has ended", lambda: sum(state(publisher).swaps_by_result.values()) == 9)
    assert state(publisher).swaps_by_result == {"ok": 9}
    sent = state(publisher).published
    eventually("all that was sent arrives", lambda: len(reader.received) >= sent)
    received = list(reader.received)
    assert received == list(range(len(received)))


def test_the_rate_follows_the_price_down_to_the_floor(publisher, configure, send_price):
    """A price lowers the rate to what it buys, not below the floor and only with a weight; a better one raises it."""
    configure(rate=100.0, min_rate=20.0)
    send_price(costing(5.0), "the price arrives", lambda: publisher._price)
    assert is_paced_at(publisher, 100.0)(), "a rate that was set by hand has no price"
    configure(**TERMS)
    assert is_paced_at(publisher, 20.0)()
    for price, rate_hz in ((costing(50.0), 50.0), (costing(1.0), 20.0), (FREE, 100.0)):
        send_price(price, "the rate follows the price", is_paced_at(publisher, rate_hz))


def test_a_callback_that_sleeps_delays_no_price(publisher, configure, send_price, eventually):
    """While the node's executor is inside a callback of the application, its publishers follow the price."""
    configure(rate=100.0, min_rate=1.0, **TERMS)
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
    send_price(crosses_in_200_s, "both know it", lambda: publisher._price and other._price)
    large = String(data=60_000 * "x")
    publisher.pass_on(large)
    eventually("the first leaves", lambda: state(publisher).published == 1)
    other.publish(large)
    assert (state(other).published, state(other).queued) == (0, 1)
    clock.skip(300.0)
    eventually("the second leaves", lambda: state(other).published == 1)
    assert state(publisher).published == 1


def test_what_is_no_price_changes_nothing(publisher, configure, send_price):
    """Malformed messages are ignored, and the next price counts."""
    configure(rate=100.0, **TERMS)
    send_price(costing(5.0), "the price is in force", is_paced_at(publisher, 5.0))
    for numbers in ([], [1.0, math.nan, *[0.0] * 5], [7.0] * 7, [1.0] * 500):
        message = bytes(serialize_message(Float64MultiArray(data=numbers)))
        publisher._shared._inboxes[0].take(Sample(message, b"", 0))
        assert is_paced_at(publisher, 5.0)()
    send_price(costing(6.0), "the next price is in force", is_paced_at(publisher, 6.0))


def test_a_later_publisher_has_the_last_price_at_once(node, publisher, send_price):
    """A publisher that is made after the price was sent follows it from the beginning."""
    send_price(costing(5.0), "the price arrives", lambda: publisher._price)
    later = AdaptivePublisher(node, String, "/later", 10)
    later.retune(TopicPlan(rate_hz=100.0, min_rate_hz=0.0, deadline_ns=0, depth=10, **TERMS))
    assert is_paced_at(later, 5.0)()


def test_silence_ends_the_wait_for_a_plan_and_no_price(clock, publisher, configure, send_price, eventually):
    """After some seconds without a price no new topic waits for a plan, and a topic with a plan keeps the price."""
    send_price(costing(5.0), "the daemon is noticed", lambda: publisher._price)

    def has_no_daemon():
        clock.skip(6.0)  # more than once, because a last price may still be under way
        return publisher._price is None

    eventually("its silence is noticed", has_no_daemon)
    configure(rate=100.0, **TERMS)
    assert is_paced_at(publisher, 5.0)(), "a plan finds the last price"


def test_deadline_is_clamped_to_the_tightest_reader(ros, publisher, configure, background, eventually):
    """An offered deadline longer than a reader requests is clamped, so no reader is lost."""
    configure(deadline=100_000_000)
    eventually("the deadline is offered", lambda: state(publisher).deadline_ns == 100_000_000)
    demanding = Reader(ros.node("demanding"), QoSProfile(depth=DEEP, deadline=Duration(nanoseconds=500_000_000)))
    eventually("the reader matches", lambda: demanding.has_matched(publisher))
    eventually("the graph shows its request", lambda: publisher._requests.tightest_ns() == 500_000_000)
    configure(deadline=900_000_000, depth=30)
    eventually("the new depth is in force", lambda: state(publisher).depth == 30)
    assert state(publisher).deadline_ns == 500_000_000
    background(publish_at(publisher, 50))
    eventually("the reader still receives", lambda: len(demanding.received) > 5)


def test_it_announces_itself(ros, publisher, eventually):
    """The announcement has the settings in force and the counters."""
    watcher = Announced(ros.node("watcher"))
    publisher.publish(String(data="0"))
    eventually("the sample is announced", lambda: watcher.shows(published=1))
    announced = watcher.last
    assert (announced.node, announced.topic, announced.depth) == ("/talker", TOPIC, 10)
    assert announced.type_name == "std_msgs/msg/String"


def writers_of(node):
    return [writer for writer in node.publishers if writer.topic_name == TOPIC]


def test_two_publishers_of_one_topic_in_one_node_are_refused(node, publisher):
    """A second AdaptivePublisher of a topic in one node is refused, and leaves no writer."""
    with pytest.raises(ValueError, match="already has an AdaptivePublisher"):
        AdaptivePublisher(node, String, TOPIC, 10)
    assert writers_of(node) == [publisher._writer.publisher]


def test_destroy_frees_name_and_writers(node, publisher):
    """A destroyed publisher leaves no writer behind, and another one with other QoS may follow."""
    publisher.destroy()
    assert not writers_of(node)
    other = AdaptivePublisher(node, String, TOPIC, 99)
    assert other.baseline.depth == 99
    publisher.destroy()  # again, as rclpy allows
    with pytest.raises(ValueError, match="already has an AdaptivePublisher"):
        AdaptivePublisher(node, String, TOPIC, 10)
    other.destroy()


def test_one_failing_topic_does_not_stop_the_others(publisher, configure, background, monkeypatch, eventually):
    """A publisher that raises is logged and tried again, and the node's other topics are paced."""
    other = AdaptivePublisher(publisher._node, String, "/other", 10)
    failures = []

    def fail(_now_s):
        failures.append(None)
        raise RuntimeError("the middleware is out of resources")

    monkeypatch.setattr(other._flow, "service", fail)
    other.retune(other.plan)
    configure(rate=20.0)
    background(publish_at(publisher, 100))
    eventually("it is tried again", lambda: len(failures) > 1)
    before = state(publisher).published
    eventually("twenty samples of the other topic leave", lambda: state(publisher).published >= before + 20)


def test_a_node_that_is_destroyed_leaves_the_others(ros, publisher, background, eventually):
    """The thread of a participant serves its other nodes when one is destroyed with its publishers."""
    node = ros.node("short_lived")
    gone = AdaptivePublisher(node, String, "/gone", 10)
    assert gone._thread is publisher._thread
    background(publish_at(publisher, 50))
    node.destroy_node()
    publisher.retune(replace(publisher.plan, depth=30))
    eventually("another node's writer is swapped", lambda: state(publisher).depth == 30)
    watcher = Announced(ros.node("watcher"))
    eventually("the other node announces", lambda: watcher.shows(depth=30))
    assert publisher._thread._thread.is_alive()


def test_overrides_given_at_the_start_are_the_application_s_own_qos(ros):
    """Depth and deadline of a parameter file are in force, and are what returns when a plan ends."""
    overrides = [Parameter(DEPTH, value=77), Parameter(DEADLINE, value=10**9)]
    publisher = AdaptivePublisher(ros.node("overridden", parameter_overrides=overrides), String, TOPIC, 10)
    assert publisher.baseline == WriterQos(depth=77, deadline_ns=10**9)
    now = state(publisher)
    assert (now.depth, now.deadline_ns, now.baseline_depth) == (77, 10**9, 77)


@pytest.mark.parametrize(("name", "value"), [("depth", 0), ("deadline", -1), ("deadline", 5)])
def test_an_override_out_of_bounds_is_refused_by_name(ros, name, value):
    """The message names the parameter and what is wrong."""
    parameter = f"qos_overrides.{TOPIC}.publisher.{name}"
    node = ros.node("overridden", parameter_overrides=[Parameter(parameter, value=value)])
    with pytest.raises(ValueError, match=rf"{re.escape(parameter)}: {name}.* = {value} is "):
        AdaptivePublisher(node, String, TOPIC, 10)
