"""QoS that a swap keeps, and events that the application receives, with real rclpy and Fast DDS."""

from copy import copy
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import pytest
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import QoSDurabilityPolicy, QoSLivelinessPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.model.endpoints import SwapTiming
from tests.ros.world import FREE, retune

TOPIC = "/kept"


# This host loses nothing, so readers match at once; an old writer without acknowledgements drains for long.
QUICK = SwapTiming(settle_s=0.1, drain_s=60.0)
WEAK = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)


def make(node, qos, **options):
    return AdaptivePublisher(node, String, TOPIC, qos, swap_timing=QUICK, **options)


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
    publisher = make(ros.node("talker"), profile)
    profile.lifespan = Duration(seconds=1)  # a later change of the application's object has no effect
    watcher = ros.node("watcher")
    retune(publisher, depth=17, deadline_ns=10**9)

    def offered():
        found = [info.qos_profile for info in watcher.get_publishers_info_by_topic(TOPIC)]
        return found if [qos.deadline.nanoseconds for qos in found] == [10**9] else None

    (qos,) = eventually("only the new writer is in the graph", offered)
    assert qos.durability == QoSDurabilityPolicy.VOLATILE
    for name in ("reliability", "lifespan", "liveliness", "liveliness_lease_duration"):
        assert getattr(qos, name) == getattr(wanted, name), name
    publisher.assert_liveliness()


def test_a_reader_that_would_be_lost_undoes_the_swap(ros, eventually):
    """A reader that refuses the new writer's deadline is named, and still receives messages."""
    publisher = make(ros.node("talker"), 10)
    retune(publisher, deadline_ns=100_000_000)
    eventually("the deadline is offered", lambda: publisher.state().deadline_ns == 100_000_000)
    received = []
    demanding = QoSProfile(depth=10, deadline=Duration(nanoseconds=500_000_000))
    ros.node("demanding").create_subscription(String, TOPIC, received.append, demanding)
    eventually("the reader matches", lambda: publisher.get_subscription_count() == 1)
    retune(publisher, deadline_ns=900_000_000)
    refusal = eventually("the swap is refused", lambda: publisher.state().refusal)
    assert "DEADLINE" in refusal
    assert "/demanding requests 500000000 ns" in refusal
    assert publisher.state().swaps_by_result["incompatible"] == 1
    assert publisher.state().deadline_ns == 100_000_000
    publisher.publish(String(data="still there"))
    eventually("the reader still receives", lambda: received)


def test_a_writer_that_a_swap_retires_is_no_dead_one(ros, eventually):
    """Who asserts that it is alive does so with each of its writers: a reader watches them all."""
    publisher, asserted = AdaptivePublisher(ros.node("talker"), String, TOPIC, 10), []
    retune(publisher, depth=17)
    eventually("there are two writers", lambda: len(publisher._flow.swap.writers) == 2)
    for number, writer in enumerate(publisher._flow.swap.writers):
        writer.publisher.assert_liveliness = partial(asserted.append, number)
    publisher.assert_liveliness()
    assert asserted == [0, 1]


@pytest.mark.parametrize(
    ("events", "named"),
    [(None, 1), (PublisherEventCallbacks(use_default_callbacks=False), 0)],
    ids=["by default", "not wanted"],
)
def test_a_reader_that_hears_nothing_is_named_once_where_rclpy_would(ros, monkeypatch, eventually, events, named):
    """As the default callback of a plain publisher does."""
    publisher, said = make(ros.node("talker"), WEAK, event_callbacks=events), []
    monkeypatch.setattr(publisher._node, "get_logger", lambda: SimpleNamespace(warning=said.append))
    ros.node("demanding").create_subscription(String, TOPIC, lambda _message: None, 10)
    eventually("it is refused", publisher._flow.swap.current.refusals)
    for _ in range(2):
        publisher.state()
    assert ["RELIABILITY" in each for each in said] == [True] * named


def callbacks(**events):
    """Return the application's event callbacks, which keep events in these lists."""
    return PublisherEventCallbacks(use_default_callbacks=False, **{name: kept.append for name, kept in events.items()})


def test_the_application_does_not_hear_of_the_second_writer(ros, eventually):
    """Swaps cause no event for a known reader, and a reader that joins afterwards causes one."""
    matched = []
    publisher = make(ros.node("talker"), 10, event_callbacks=callbacks(matched=matched))
    ros.node("first").create_subscription(String, TOPIC, lambda _message: None, 10)
    eventually("the first reader is heard of", lambda: matched)
    for depth in (20, 30):
        retune(publisher, depth=depth)
        eventually("the new depth is in force", lambda depth=depth: publisher.state().depth == depth)
    eventually("the last swap ends", lambda: not publisher._flow.swap.is_busy)
    ros.node("second").create_subscription(String, TOPIC, lambda _message: None, 10)
    eventually("the second reader is heard of", lambda: len(matched) > 1)
    assert [event.current_count for event in matched] == [1, 2]


def test_only_the_writer_in_force_misses_deadlines(ros, monkeypatch, eventually):
    """Missed deadlines are told and counted, a swap keeps the count, and a retired writer adds none."""
    events = []
    profile = QoSProfile(depth=10, deadline=Duration(nanoseconds=200_000_000))
    publisher = make(ros.node("talker"), profile, event_callbacks=callbacks(deadline=events))
    ros.node("reader").create_subscription(String, TOPIC, lambda _message: None, 10)
    eventually("the reader matches", lambda: publisher.get_subscription_count() == 1)
    publisher.publish(String(data="0"))
    eventually("the silent writer misses deadlines", lambda: len(events) > 1)
    old, asked = publisher._flow.swap.current, []
    monkeypatch.setattr(old, "is_acknowledged", lambda: False)  # so that it drains
    monkeypatch.setattr(
        old, "_in_force", lambda: asked.append(old is not publisher._flow.swap.current) or publisher._flow.swap.current
    )
    before = publisher.state().deadlines_missed
    retune(publisher, depth=20, deadline_ns=60_000_000_000)
    # It still misses a deadline five times a second; its callbacks are called, and stay silent.
    eventually("the retired writer misses a deadline", lambda: any(asked))
    missed, counted, denied = len(events), publisher.state().deadlines_missed, asked.count(True)
    assert counted >= before > 0
    eventually("it misses more", lambda: asked.count(True) > denied + 1)
    assert (len(events), publisher.state().deadlines_missed) == (missed, counted)
    retune(publisher, deadline_ns=100_000_000)
    eventually("the deadline is in force", lambda: publisher.state().deadline_ns == 100_000_000)
    publisher.publish(String(data="1"))
    eventually("the new writer misses deadlines", lambda: len(events) > missed)
    assert publisher.state().deadlines_missed > counted


@pytest.mark.parametrize(
    ("writes", "reads", "can_prove"),
    [("RELIABLE", "RELIABLE", True), ("RELIABLE", "BEST_EFFORT", False), ("BEST_EFFORT", "BEST_EFFORT", False)],
)
def test_a_swap_knows_whether_its_readers_acknowledge_and_what_the_link_loses(
    ros, eventually, writes, reads, can_prove
):
    """A new writer can prove itself if it and all readers are reliable; the loss comes with the price."""
    qos = {name: QoSProfile(depth=10, reliability=QoSReliabilityPolicy[name]) for name in (writes, reads)}
    node = ros.node("listener")
    for profile in (qos[writes], qos[reads]):
        node.create_subscription(String, TOPIC, lambda _message: None, profile)
    publisher = make(ros.node("talker"), qos[writes])
    publisher.set_price(replace(FREE, loss_ratio=0.25))
    publisher._flow.service(0.0)
    assert publisher._flow.swap.loss_ratio == 0.25
    eventually("both readers match", lambda: publisher.get_subscription_count() == 2)
    eventually("the graph shows both", lambda: len(publisher._requests.names()) == 2)
    assert publisher._flow.swap.current.readers_acknowledge() == can_prove
