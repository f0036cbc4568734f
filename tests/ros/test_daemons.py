"""Daemons of one ROS domain, over real topics."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticStatus

from arpd.incumbent import Claim
from arpd.ros.daemons import Daemons, from_status, to_status

pytestmark = pytest.mark.ros
OWN = Claim(started_ns=5, token="0" * 32, host="robot")


def test_the_elder_drives_and_is_succeeded(ros, eventually):
    """Two daemons hear of each other; when the elder is gone, the younger one drives."""
    first = ros.node("first")
    elder = Daemons(first, wall_clock_ns=lambda: 1)
    younger = Daemons(ros.node("second"), wall_clock_ns=lambda: 2)
    eventually(lambda: elder.others() and younger.superior())
    assert elder.superior() == ""
    first.destroy_node()
    eventually(lambda: not younger.others())
    assert younger.superior() == ""


def test_a_claim_survives_the_wire():
    """What is encoded is decoded as it was."""
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
        lambda status: setattr(status.values[0], "value", "-1"),
        lambda status: setattr(status.values[0], "value", "9" * 30),
    ],
)
def test_a_malformed_claim_is_refused(spoil):
    """What no daemon says is no daemon."""
    status = to_status(OWN)
    assert isinstance(status, DiagnosticStatus)
    spoil(status)
    with pytest.raises(ValueError, match=r"claim|invalid"):
        from_status(status)
