"""Daemons of one ROS domain, over real topics."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Float64MultiArray

from arpd.adapters.ros.daemons import Daemons, from_status, to_status
from arpd.adapters.ros.names import DAEMONS_TOPIC, PRICE_TOPIC
from arpd.observe.leader import LEAST_STARTED_NS, DaemonHeartbeat

pytestmark = pytest.mark.ros
OWN = DaemonHeartbeat(started_ns=LEAST_STARTED_NS, token="0" * 32, host="robot")


def test_the_elder_drives_and_is_succeeded(ros, eventually):
    """The older of two daemons is active; when it is gone, the younger one is."""
    first, second = ros.node("first"), ros.node("second")
    for node in (first, second):
        node.create_publisher(Float64MultiArray, PRICE_TOPIC, 1)
    elder = Daemons(first, wall_clock_ns=lambda: LEAST_STARTED_NS + 1)
    younger = Daemons(second, wall_clock_ns=lambda: LEAST_STARTED_NS + 2)
    eventually(lambda: elder.others() and younger.active_daemon())
    assert elder.active_daemon() == ""
    first.destroy_node()
    eventually(lambda: not younger.others())
    assert younger.active_daemon() == ""


def test_who_sends_no_price_is_no_daemon(ros, eventually, background):
    """Heartbeats of a node without a price do not make it the active daemon."""
    driver = ros.node("driver")
    driver.create_publisher(Float64MultiArray, PRICE_TOPIC, 1)
    received = []
    daemons = Daemons(driver, wall_clock_ns=lambda: LEAST_STARTED_NS + 1)
    note = daemons._leader.note
    daemons._leader.note = lambda heartbeat, now_s: received.append(heartbeat) or note(heartbeat, now_s)
    liar = ros.node("liar")
    heartbeats = liar.create_publisher(DiagnosticArray, DAEMONS_TOPIC, 10)

    def beat(stopping):
        while not stopping.wait(0.2):
            heartbeats.publish(DiagnosticArray(status=[to_status(OWN)]))

    background(beat)
    eventually(lambda: received.count(OWN) > 5)
    assert (daemons.active_daemon(), daemons.others()) == ("", ())
    liar.create_publisher(Float64MultiArray, PRICE_TOPIC, 1)
    eventually(lambda: daemons.active_daemon() == "robot")


def test_a_heartbeat_survives_the_wire():
    """Decoding returns the encoded heartbeat."""
    assert from_status(to_status(OWN)) == OWN


@pytest.mark.parametrize(
    "spoil",
    [
        lambda status: setattr(status, "hardware_id", "x" * 32),
        lambda status: setattr(status, "hardware_id", ""),
        lambda status: setattr(status, "name", "arpd on "),
        lambda status: setattr(status, "name", "arpd on \x1b[2J"),
        lambda status: setattr(status, "name", "h" * 10_000),
        lambda status: setattr(status, "values", []),
        lambda status: setattr(status.values[0], "value", "0"),
        lambda status: setattr(status.values[0], "value", str(LEAST_STARTED_NS - 1)),
        lambda status: setattr(status.values[0], "value", "9" * 30),
    ],
)
def test_a_malformed_heartbeat_is_refused(spoil):
    """A heartbeat with a wrong token, host or time raises."""
    status = to_status(OWN)
    assert isinstance(status, DiagnosticStatus)
    spoil(status)
    with pytest.raises(ValueError, match=r"heartbeat|invalid"):
        from_status(status)
