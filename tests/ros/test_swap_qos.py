"""QoS that a swap keeps, and events that the application receives, with real rclpy and Fast DDS."""

import os
import time
from copy import copy
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.parameter import Parameter
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSLivelinessPolicy,
    QoSPolicyKind,
    QoSProfile,
    QoSReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.apply.endpoint.writer_swap import SwapTiming

pytestmark = pytest.mark.ros
TOPIC = "/kept"
LATCHED = QoSProfile(depth=3, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


def state(publisher):
    return publisher.state(generation=0)


def retune(publisher, **changes):
    publisher.retune(replace(publisher.plan, **changes))


def swaps(publisher):
    done = state(publisher).swaps_by_result
    return done.get("ok", 0) + done.get("reorder_possible", 0)


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def offered_qos(ros_node):
    infos = ros_node.get_publishers_info_by_topic(TOPIC)
    return [info.qos_profile for info in infos if info.node_name == "talker"]


def test_every_other_policy_survives(ros, eventually):
    """After a swap the new writer offers the application's reliability, durability, lifespan and liveliness."""
    profile = QoSProfile(
        depth=5,
        reliability=QoSReliabilityPolicy.BEST_EFFORT,
        lifespan=Duration(seconds=7),
        liveliness=QoSLivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(seconds=9),
    )
    wanted = copy(profile)
    publisher = AdaptivePublisher(ros.node("talker"), String, TOPIC, profile)
    profile.lifespan = Duration(seconds=1)  # a later change of the application's object has no effect
    watcher = ros.node("watcher")
    retune(publisher, depth=17, deadline_ns=10**9)
    eventually(lambda: [qos.deadline.nanoseconds for qos in offered_qos(watcher)] == [10**9])
    (qos,) = offered_qos(watcher)
    assert qos.reliability == wanted.reliability
    assert qos.durability == QoSDurabilityPolicy.VOLATILE
    assert qos.lifespan == wanted.lifespan
    assert qos.liveliness == wanted.liveliness
    assert qos.liveliness_lease_duration == wanted.liveliness_lease_duration
    publisher.assert_liveliness()


def test_a_reader_that_would_be_lost_undoes_the_swap(ros, monkeypatch, eventually):
    """A reader that refuses the new writer's deadline is named, and still receives messages."""
    publisher = AdaptivePublisher(ros.node("talker"), String, TOPIC, 10)
    retune(publisher, deadline_ns=100_000_000)
    eventually(lambda: state(publisher).deadline_ns == 100_000_000)
    received = []
    demanding = QoSProfile(depth=10, deadline=Duration(nanoseconds=500_000_000))
    ros.node("demanding").create_subscription(String, TOPIC, received.append, demanding)
    eventually(lambda: publisher.get_subscription_count() == 1)
    # As if it had joined after the clamp read the graph.
    monkeypatch.setattr(publisher._requests, "tightest_ns", lambda: 0)
    retune(publisher, deadline_ns=900_000_000)
    eventually(lambda: state(publisher).refusal)
    refusal = state(publisher).refusal
    assert "DEADLINE" in refusal
    assert "/demanding requests 500000000 ns" in refusal
    assert state(publisher).swaps_by_result["incompatible"] == 1
    assert state(publisher).deadline_ns == 100_000_000
    publisher.publish(String(data="still there"))
    eventually(lambda: received)


def test_a_reader_that_was_never_served_does_not_stop_a_swap(ros, eventually):
    """A reader that refuses the writer in force too does not stop its replacement."""
    publisher = AdaptivePublisher(ros.node("talker"), String, TOPIC, 10)
    impossible = QoSProfile(depth=10, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    ros.node("impossible").create_subscription(String, TOPIC, lambda _message: None, impossible)
    served = []
    ros.node("served").create_subscription(String, TOPIC, served.append, 10)
    eventually(lambda: publisher.get_subscription_count() == 1)
    eventually(lambda: publisher._writer.refusals() == 1)
    assert publisher._writer.refused_policy == "DURABILITY"
    retune(publisher, depth=30)
    eventually(lambda: state(publisher).depth == 30)
    assert publisher._writer.refusals() == 1
    eventually(lambda: swaps(publisher) == 1)
    publisher.publish(String(data="x"))
    eventually(lambda: served)


class Events:
    """The application's event callbacks, and their events."""

    def __init__(self):
        self.matched = []
        self.missed = []
        self.callbacks = PublisherEventCallbacks(
            matched=self.matched.append, deadline=self.missed.append, use_default_callbacks=False
        )


def test_the_application_does_not_hear_of_the_second_writer(ros, eventually):
    """Swaps cause no event for a known reader, and a reader that joins afterwards causes one."""
    events = Events()
    publisher = AdaptivePublisher(ros.node("talker"), String, TOPIC, 10, event_callbacks=events.callbacks)
    ros.node("first").create_subscription(String, TOPIC, lambda _message: None, 10)
    eventually(lambda: len(events.matched) == 1)
    for depth in (20, 30):
        retune(publisher, depth=depth)
        eventually(lambda depth=depth: state(publisher).depth == depth)
    assert [event.current_count for event in events.matched] == [1]
    ros.node("second").create_subscription(String, TOPIC, lambda _message: None, 10)
    eventually(lambda: len(events.matched) == 2)
    assert events.matched[-1].current_count == 2


def test_a_retired_writer_misses_no_deadlines(ros, monkeypatch, eventually):
    """The old writer, silent from the switch on, reports no missed deadline while it drains; the new one does."""
    events = Events()
    profile = QoSProfile(depth=10, deadline=Duration(nanoseconds=200_000_000))
    publisher = AdaptivePublisher(ros.node("talker"), String, TOPIC, profile, event_callbacks=events.callbacks)
    ros.node("reader").create_subscription(String, TOPIC, lambda _message: None, 10)
    eventually(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(String(data="0"))
    eventually(lambda: events.missed)  # the silent writer in force misses its deadline
    old = publisher._writer
    monkeypatch.setattr(old, "is_acknowledged", lambda: False)  # so that it drains for seconds
    retune(publisher, depth=20, deadline_ns=60_000_000_000)
    eventually(lambda: state(publisher).depth == 20)
    time.sleep(0.1)  # for an event that was under way at the switch
    missed, counted = len(events.missed), state(publisher).deadlines_missed
    assert counted >= missed  # on a busy machine one event may stand for several misses
    asked = []
    # The old writer still misses its deadline five times a second; its callbacks are called, and stay silent.
    monkeypatch.setattr(publisher, "_is_current", lambda writer: asked.append(writer) or publisher._writer is writer)
    old._is_current = publisher._is_current
    eventually(lambda: asked.count(old) >= 2)
    assert len(events.missed) == missed
    assert state(publisher).deadlines_missed == counted
    retune(publisher, deadline_ns=100_000_000)
    eventually(lambda: state(publisher).deadline_ns == 100_000_000)
    publisher.publish(String(data="1"))
    eventually(lambda: len(events.missed) > missed)
    assert state(publisher).deadlines_missed > counted


def test_missed_deadlines_are_counted_without_anybody_listening(ros, background, eventually):
    """A silent publisher misses deadlines, a steady one misses none, and a swap keeps the count."""
    timing = SwapTiming(settle_s=0.1)
    node = ros.node("talker")
    silent, steady = (
        AdaptivePublisher(
            node, String, topic, QoSProfile(depth=10, deadline=Duration(nanoseconds=deadline_ns)), swap_timing=timing
        )
        for topic, deadline_ns in ((TOPIC, 50_000_000), ("/steady", 20_000_000_000))
    )
    time.sleep(0.2)
    assert state(silent).deadlines_missed == 0, "no deadline runs before the first sample"
    silent.publish(String(data="0"))

    def go_on(stopping):
        while not stopping.wait(0.02):
            steady.publish(String(data="x"))

    background(go_on)
    eventually(lambda: state(silent).deadlines_missed >= 3)
    missed = state(silent).deadlines_missed
    retune(silent, depth=20, deadline_ns=60_000_000_000)
    eventually(lambda: state(silent).depth == 20)
    assert (counted := state(silent).deadlines_missed) >= missed
    eventually(lambda: swaps(silent) == 1)
    silent.publish(String(data="1"))
    assert state(silent).deadlines_missed == counted
    before_bytes = resident_bytes()
    for _ in range(20_000):
        silent._writer.deadlines_missed()
    assert resident_bytes() - before_bytes < 20_000 * 64, "reading the count leaks memory"
    assert state(steady).deadlines_missed == 0


def test_a_coroutine_hears_events_too(ros, eventually):
    """An event callback that is a coroutine function is awaited, as rclpy does."""
    matched = []

    async def on_matched(event):
        matched.append(event)

    callbacks = PublisherEventCallbacks(matched=on_matched, use_default_callbacks=False)
    AdaptivePublisher(ros.node("talker"), String, TOPIC, 10, event_callbacks=callbacks)
    ros.node("reader").create_subscription(String, TOPIC, lambda _message: None, 10)
    eventually(lambda: matched)


def test_a_latched_topic_swaps_when_the_application_says_so(ros, eventually):
    """With swap_transient_local a late reader receives the old writer's history from the new one, and no more."""
    publisher = AdaptivePublisher(ros.node("talker"), String, TOPIC, LATCHED, swap_transient_local=True)
    for number in range(5):
        publisher.publish(String(data=str(number)))
    retune(publisher, depth=8)
    eventually(lambda: state(publisher).depth == 8)
    time.sleep(0.3)  # the old writer, without readers, is gone by then
    publisher.publish(String(data="5"))
    received = []
    late = QoSProfile(depth=100, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    ros.node("late").create_subscription(String, TOPIC, lambda message: received.append(message.data), late)
    eventually(lambda: len(received) >= 4)
    assert received == ["2", "3", "4", "5"]
    assert state(publisher).published == 6, "replayed samples do not count again"


def test_a_volatile_topic_is_never_replayed(ros, eventually):
    """On a volatile topic swap_transient_local doubles nothing."""
    publisher = AdaptivePublisher(ros.node("talker"), String, TOPIC, 10, swap_transient_local=True)
    received = []
    ros.node("reader").create_subscription(String, TOPIC, lambda message: received.append(message.data), 10)
    eventually(lambda: publisher.get_subscription_count() == 1)
    time.sleep(0.3)
    publisher.publish(String(data="0"))
    retune(publisher, depth=20)
    eventually(lambda: state(publisher).depth == 20)
    publisher.publish(String(data="1"))
    eventually(lambda: len(received) >= 2)
    assert received == ["0", "1"]


def test_overriding_options_work_as_in_rclpy_and_leave_depth_writable(ros, eventually):
    """Parameters override other policies at the start, and depth stays writable."""
    overrides = [
        Parameter(f"qos_overrides.{TOPIC}.publisher.reliability", value="best_effort"),
        Parameter(f"qos_overrides.{TOPIC}.publisher.depth", value=40),
    ]
    node = ros.node("talker", parameter_overrides=overrides)
    options = QoSOverridingOptions([QoSPolicyKind.RELIABILITY, QoSPolicyKind.DEPTH])
    publisher = AdaptivePublisher(node, String, TOPIC, 10, qos_overriding_options=options)
    eventually(lambda: state(publisher).depth == 40)
    assert publisher.qos_profile.reliability == QoSReliabilityPolicy.BEST_EFFORT
    (result,) = node.set_parameters([Parameter(f"qos_overrides.{TOPIC}.publisher.depth", value=50)])
    assert result.successful
    eventually(lambda: state(publisher).depth == 50)
    watcher = ros.node("watcher")
    eventually(lambda: [qos.reliability for qos in offered_qos(watcher)] == [QoSReliabilityPolicy.BEST_EFFORT])
