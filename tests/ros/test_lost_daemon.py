"""A node whose daemon is gone, with real rclpy."""

import math
import threading
import time

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.parameter import Parameter
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.adapters.ros.plan_message import PlanAnswer
from arpd.adapters.ros.plan_sender import PlanSender
from arpd.model.plan import TopicPlan, Transition
from tests.ros.announced import Announced
from tests.ros.price import TERMS, PriceSender, costing
from tests.ros.setter import Setter

pytestmark = pytest.mark.ros
TOPIC = "/leased"
DEPTH = f"qos_overrides.{TOPIC}.publisher.depth"
ROW = TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=10**9, depth=40, **TERMS)
PRICE = costing(2.5)


class FakeDaemon:
    """Applies one plan as `arpd run` does, and sends the price until `fall_silent`."""

    def __init__(self, node, announced, stopping):
        self._sender = PlanSender(
            node,
            publishers_answer=lambda name: announced.answers.get(name, PlanAnswer()),
            readers_answer=lambda _name: PlanAnswer(),
        )
        self._send_price = PriceSender(node)
        self._is_talking = threading.Event()
        self._thread = threading.Thread(target=self._talk, args=(stopping,), daemon=True)
        self._transition = None
        self._thread.start()

    def plan(self, generation, lease_s):
        self._transition = Transition(
            node="/talker", generation=generation, topics={TOPIC: ROW}, reason="test", lease_s=lease_s
        )
        self._is_talking.set()

    def fall_silent(self):
        self._is_talking.clear()

    def _talk(self, stopping):
        while not stopping.wait(0.1):
            if self._is_talking.is_set():
                self._send_price(PRICE)
                self._sender.apply([self._transition], now_s=time.monotonic())


@pytest.fixture
def node(ros):
    return ros.node("talker")


@pytest.fixture
def publisher(node):
    return AdaptivePublisher(node, String, TOPIC, 10)


@pytest.fixture
def announced(ros, publisher):
    return Announced(ros.node("watcher"))


@pytest.fixture
def daemon(ros, announced):
    stopping = threading.Event()
    fake = FakeDaemon(ros.node("planner"), announced, stopping)
    yield fake
    stopping.set()
    fake._thread.join(timeout=5)


def test_a_plan_outlives_its_daemon_only_as_long_as_was_granted(node, publisher, announced, daemon, eventually):
    """Plan and price stay while the daemon sends, and end with the lease; a returning daemon plans again."""
    daemon.plan(generation=7, lease_s=5.0)
    eventually(lambda: announced.shows(depth=40, generation=7, lease_s=5.0, paced_rate_hz=2.5))
    time.sleep(7.0)
    assert publisher.plan == ROW, "the daemon still sends its price"
    daemon.fall_silent()
    eventually(lambda: announced.shows(depth=10, deadline_ns=0, rate_hz=math.inf, generation=0))
    eventually(lambda: announced.shows(paced_rate_hz=math.inf))
    assert node.get_parameter(DEPTH).value == 10, "the parameters follow"
    daemon.plan(generation=1, lease_s=5.0)  # another daemon, without knowledge of its predecessor
    eventually(lambda: announced.shows(depth=40, generation=1, paced_rate_hz=2.5))


def test_without_a_lease_a_plan_stays(publisher, announced, daemon, eventually):
    """By default plan and price stay in force when their daemon falls silent."""
    daemon.plan(generation=7, lease_s=0.0)
    eventually(lambda: announced.shows(depth=40, generation=7, paced_rate_hz=2.5))
    daemon.fall_silent()
    time.sleep(7.0)
    assert announced.shows(depth=40, generation=7, paced_rate_hz=2.5)


def test_settings_made_by_hand_have_no_lease(node, publisher, eventually):
    """Settings made by hand, with no plan in force, do not end with a lease."""
    node.set_parameters([Parameter("arpd.lease", value=0.5), Parameter(DEPTH, value=33)])
    eventually(lambda: publisher.state(generation=0).depth == 33)
    time.sleep(2.5)
    assert publisher.plan.depth == 33


@pytest.mark.parametrize("value", [-1.0, math.inf, math.nan])
def test_an_impossible_lease_is_refused(node, publisher, value):
    """A negative or infinite lease is refused with a reason."""
    (result,) = node.set_parameters([Parameter("arpd.lease", value=value)])
    assert not result.successful
    assert "is not a lease" in result.reason


def test_a_late_call_of_an_older_plan_changes_nothing(ros, node, publisher, announced, eventually):
    """Calls that overtake each other leave the newest plan and its lease in force."""
    configure = Setter(ros.node("planner"), "/talker", TOPIC)
    answers = [configure.call(depth=10 + n, lease=100.0 + n, generation=n) for n in (1, 4, 2, 3)]
    eventually(lambda: all(answer.done() for answer in answers))
    assert [answer.result().result.successful for answer in answers] == [True, True, False, False]
    eventually(lambda: announced.shows(depth=14, generation=4, lease_s=104.0))
