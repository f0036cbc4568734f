"""Daemons of one ROS domain, over real topics."""

import threading
import time

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64MultiArray

from arpd.adapters.ros.daemons import Daemons, to_status
from arpd.adapters.ros.names import DAEMONS_TOPIC, PRICE_TOPIC
from arpd.adapters.ros.raw_reader import ReadingThread
from arpd.observe.leader import LEAST_STARTED_NS, DaemonHeartbeat

pytestmark = pytest.mark.ros
LIE = DaemonHeartbeat(started_ns=LEAST_STARTED_NS, token="0" * 32, host="robot")


@pytest.fixture
def beating(background):
    """Make a daemon's side of a node, whose heartbeats go on until the returned function is called."""

    def start(node, **options):
        daemons, ended = Daemons(node, thread=ReadingThread.of(node.context), **options), threading.Event()

        def beat(stopping):
            while not (ended.is_set() or stopping.wait(0.1)):
                daemons.step(time.monotonic())

        background(beat)
        return daemons, ended.set

    return start


def test_the_elder_drives_and_is_succeeded(ros, beating, eventually):
    """The older of two daemons is active; when it is gone, the younger one is."""
    first, second = ros.node("first"), ros.node("second")
    for node in (first, second):
        node.create_publisher(Float64MultiArray, PRICE_TOPIC, 1)
    elder, end = beating(first, wall_clock_ns=lambda: LEAST_STARTED_NS + 1)
    younger, _ = beating(second, wall_clock_ns=lambda: LEAST_STARTED_NS + 2)
    eventually("each knows the other", lambda: elder.others() and younger.active_daemon())
    assert elder.active_daemon() == ""
    end()
    eventually("the elder is forgotten", lambda: not younger.others())
    assert younger.active_daemon() == ""


def test_who_sends_no_price_is_no_daemon(ros, beating, eventually, background):
    """Heartbeats of a node without a price do not make it the active daemon."""
    driver = ros.node("driver")
    driver.create_publisher(Float64MultiArray, PRICE_TOPIC, 1)
    received = []
    daemons, _ = beating(driver, wall_clock_ns=lambda: LEAST_STARTED_NS + 1)
    note = daemons._leader.note
    daemons._leader.note = lambda heartbeat, now_s: received.append(heartbeat) or note(heartbeat, now_s)
    liar = ros.node("liar")
    heartbeats = liar.create_publisher(DiagnosticArray, DAEMONS_TOPIC, 10)

    def beat(stopping):
        while not stopping.wait(0.2):
            heartbeats.publish(DiagnosticArray(status=[to_status(LIE)]))

    background(beat)
    eventually("six heartbeats of the liar arrive", lambda: received.count(LIE) > 5)
    assert (daemons.active_daemon(), daemons.others()) == ("", ())
    liar.create_publisher(Float64MultiArray, PRICE_TOPIC, 1)
    eventually("it counts with a price", lambda: daemons.active_daemon() == "robot")
