"""A node whose daemon is gone, with real rclpy and a clock that the test puts forward."""

import math

import pytest
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.model.plan import TopicPlan
from tests.ros.clock import SkippingClock
from tests.ros.plans import Plans
from tests.ros.price import TERMS, PriceSender, costing

TOPIC = "/leased"
ROW = TopicPlan(rate_hz=100.0, min_rate_hz=1.0, deadline_ns=10**9, depth=40, **TERMS)
LEASE_S = 60.0  # longer than a busy machine stops a process


@pytest.fixture
def clock():
    return SkippingClock()


@pytest.fixture
def node(ros, clock):
    return clock.rule(ros.node("talker"))


@pytest.fixture
def publisher(node, clock):
    return AdaptivePublisher(node, String, TOPIC, 10, clock=clock)


@pytest.fixture
def send_plan(ros, publisher, eventually):
    """Send a plan and wait until the publisher has it."""
    plans = Plans(ros.node("planner"))

    def send(generation, lease_s):
        plans(generation, {TOPIC: ROW}, lease_s=lease_s)
        eventually("the plan is in force", lambda: publisher.plan == ROW)

    return send


@pytest.fixture
def send_price(ros, publisher):
    """Send the price of a rate and wait until it is in force."""
    send = PriceSender(ros.node("governor"))

    def is_at(rate_hz):
        return lambda: publisher.state().paced_rate_hz == pytest.approx(rate_hz)

    return lambda rate_hz: send.until(costing(rate_hz), "the price is in force", is_at(rate_hz))


def test_a_plan_outlives_its_daemon_only_as_long_as_was_granted(clock, publisher, send_plan, send_price, eventually):
    """Plan and price stay while the price comes, and end with the lease; a returning daemon plans again."""
    send_plan(generation=7, lease_s=LEASE_S)
    for rate_hz in (10.0, 20.0, 30.0):
        send_price(rate_hz)
        clock.skip(0.9 * LEASE_S)
    send_price(40.0)
    assert publisher.plan == ROW

    def has_ended():
        clock.skip(1.1 * LEASE_S)  # more than once, because a last price may still be under way
        return (publisher.plan.depth, publisher.plan.rate_hz) == (10, math.inf)

    eventually("the plan ends", has_ended)
    eventually("the price ends", lambda: publisher.state().paced_rate_hz == math.inf)
    assert publisher._shared._answer.generation == 0
    send_plan(generation=1, lease_s=LEASE_S)  # another daemon, without knowledge of its predecessor
    send_price(50.0)
