"""Times of parameter calls, over a node that only keeps them, and bounds of their values."""

import logging
import math
from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from hypothesis import given, settings
from hypothesis import strategies as st
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.task import Future

from arpd.adapters.ros.bounds import (
    LEAST_DEADLINE_NS,
    MOST_RATE_HZ,
    checked_deadline_ns,
    checked_depth,
    checked_floor_hz,
    checked_lease_s,
    checked_packets,
    checked_rate_hz,
    checked_weight,
    checked_wire_bytes,
)
from arpd.adapters.ros.grant import Grant
from arpd.adapters.ros.parameters import ParameterApplier
from arpd.model.plan import MOST_GENERATION, ReaderPlan, TopicPlan, Transition

pytestmark = pytest.mark.ros
ROW = TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=0, depth=20, weight=2.0, wire_bytes=1500.5, packets=3)
STEP = Transition(node="/n", generation=3, topics={"/t": ROW}, reason="test")
TO_READERS = Transition(
    node="/n", generation=3, topics={}, readers={"/t": ReaderPlan(depth=7, deadline_ns=9)}, reason="test", lease_s=4.0
)


class Node:
    """A node whose parameter calls the test answers."""

    def __init__(self):
        self.calls, self.futures, self.destroyed = [], [], 0

    def create_client(self, _kind, _name):
        return self

    def service_is_ready(self):
        return True

    def call_async(self, request):
        self.calls.append({parameter.name: parameter.value for parameter in request.parameters})
        self.futures.append(Future())
        return self.futures[-1]

    def remove_pending_request(self, future):
        pass

    def destroy_client(self, client):
        self.destroyed += 1


@pytest.fixture
def node():
    return Node()


@pytest.fixture
def applier(node):
    return ParameterApplier(node)


def accept(future):
    future.set_result(SetParametersAtomically.Response(result=SetParametersResult(successful=True)))


@pytest.mark.parametrize(
    ("answer", "expected_s"), [(Future.cancel, [0.0, 1.5, 4.5, 10.5]), (accept, [0.0, 6.0, 12.0])], ids=["no", "yes"]
)
def test_an_unconfirmed_step_is_repeated_after_a_while(node, applier, answer, expected_s):
    """Without an answer a step is repeated with growing back-off; an accepted one after the time of a swap."""
    sent_s = []
    for tick in range(180):
        before = len(node.calls)
        applier.apply([STEP], now_s=tick / 10)
        if len(node.calls) > before:
            sent_s.append(tick / 10)
            answer(node.futures[-1])
    assert sent_s == expected_s


def test_another_row_of_the_same_plan_goes_out_at_once(node, applier):
    """A new row waits neither for the back-off nor for the answer of an older call."""
    applier.apply([STEP], now_s=0.0)
    applier.apply([replace(STEP, topics={"/t": replace(ROW, deadline_ns=5)})], now_s=0.1)
    assert node.futures[0].cancelled()
    applier.apply([replace(STEP, topics={"/u": ROW})], now_s=0.2)
    assert [call["arpd.generation"].integer_value for call in node.calls] == [3, 3, 3]
    assert node.calls[1]["qos_overrides./t.publisher.deadline"].integer_value == 5


def test_a_part_of_what_was_told_is_nothing_new(node, applier):
    """When one of two topics has confirmed, the other is not sent again at once."""
    applier.apply([replace(STEP, topics={"/t": ROW, "/u": ROW})], now_s=0.0)
    applier.apply([STEP], now_s=0.1)
    assert len(node.calls) == 1


def test_readers_are_told_apart_from_publishers(node, applier):
    """A node's publishers and readers have a call each, with their own generation and lease."""
    applier.apply([STEP, TO_READERS], now_s=0.0)
    to_publishers, to_readers = node.calls
    assert "arpd.generation" in to_publishers
    assert {name: value.integer_value or value.double_value for name, value in to_readers.items()} == {
        "qos_overrides./t.subscription.depth": 7,
        "qos_overrides./t.subscription.deadline": 9,
        "arpd.readers.generation": 3,
        "arpd.readers.lease": 4.0,
    }


def test_a_plan_has_the_terms_of_the_price(node, applier):
    """One call sets rate, floor, weight, size, QoS and generation of a publisher."""
    applier.apply([STEP], now_s=0.0)
    (call,) = node.calls
    assert {name: value.integer_value or value.double_value for name, value in call.items()} == {
        "qos_overrides./t.publisher.depth": 20,
        "qos_overrides./t.publisher.deadline": 0,
        "arpd./t.publisher.rate": 5.0,
        "arpd./t.publisher.min_rate": 1.0,
        "arpd./t.publisher.weight": 2.0,
        "arpd./t.publisher.wire_bytes": 1500.5,
        "arpd./t.publisher.packets": 3,
        "arpd.generation": 3,
        "arpd.lease": 0.0,
    }


def test_nodes_without_end_take_no_memory_without_end(node, applier):
    """Beyond the limit of nodes those used longest ago are forgotten."""
    for k in range(600):
        applier.apply([replace(STEP, node=f"/n{k}")], now_s=0.0)
    assert node.destroyed == 100
    applier.apply([replace(STEP, node="/n599")], now_s=0.1)
    assert len(node.calls) == 600


def test_a_nodes_reason_is_cut_short_and_harmless(node, applier, caplog):
    """A reason of a megabyte with control characters is one short line of the log."""
    applier.apply([STEP], now_s=0.0)
    answer = SetParametersResult(successful=False, reason="\x1b[2J\n" * 10**5)
    with caplog.at_level(logging.WARNING):
        node.futures[0].set_result(SetParametersAtomically.Response(result=answer))
    (message,) = [record.getMessage() for record in caplog.records]
    assert len(message) < 2000
    assert message.isprintable()


BOUNDS = {
    checked_rate_hz: lambda value: 0 <= value <= MOST_RATE_HZ or value == math.inf,
    checked_floor_hz: lambda value: 0 <= value <= MOST_RATE_HZ,
    checked_lease_s: lambda value: value == 0 or 5 <= value <= 1e9,
    checked_weight: lambda value: value == 0 or 1e-6 <= value <= 1e6,
    checked_wire_bytes: lambda value: value == 0 or 1 <= value <= 1e12,
}


@pytest.mark.parametrize("check", BOUNDS, ids=lambda check: check.__name__)
@settings(max_examples=60)
@given(value=st.floats())
def test_a_number_that_is_set_is_within_bounds_or_refused_by_name(check, value):
    """Any float, NaN and denormals too, is taken as it is or refused with a reason."""
    parameter = SimpleNamespace(name="arpd./t.publisher.x", value=value)
    if BOUNDS[check](value):
        assert check(parameter) == value
    else:
        with pytest.raises(ValueError, match=r"arpd\./t\.publisher\.x = .+ is"):
            check(parameter)


@settings(max_examples=60)
@given(st.integers(-(2**63), 2**63 - 1))
def test_an_integer_that_is_set_is_within_bounds_or_refused_by_name(value):
    """Depths from 1 to 5000 and deadlines from 10 us are taken, and the application's own deadline always."""
    parameter = SimpleNamespace(name="p", value=value)
    for check, is_good in (
        (lambda: checked_depth(parameter, 5000), 1 <= value <= 5000),
        (lambda: checked_deadline_ns(parameter), value == 0 or value >= LEAST_DEADLINE_NS),
        (lambda: checked_deadline_ns(parameter, own_ns=value), value >= 0),
        (lambda: checked_packets(parameter), 0 <= value <= 10**9),
    ):
        if is_good:
            assert check() in (value, 0)
        else:
            with pytest.raises(ValueError, match="p = "):
                check()


def test_no_plan_is_numbered_beyond_all_others():
    """A generation above the greatest is refused, because it would block every later plan."""
    declared = SimpleNamespace(declare_parameter=lambda *_: None, publishers=())
    grant = Grant(declared, generation_name="g", lease_name="l", plan="", whose="", clock=lambda: 0.0)
    grant.check([SimpleNamespace(name="g", value=MOST_GENERATION)])
    with pytest.raises(ValueError, match="g 9223372036854775807 is more than"):
        grant.check([SimpleNamespace(name="g", value=2**63 - 1)])
