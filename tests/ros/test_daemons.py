"""Daemons of one ROS domain, over real topics."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

import rclpy

from arpd.ros.graph import writers_of
from arpd.ros.names import PRICE_TOPIC
from arpd.ros.other_daemons import OtherDaemons
from arpd.ros.rcl import rcl
from tests.ros.clock import SkippingClock
from tests.ros.domain import DOMAIN
from tests.ros.price import PriceSender

pytestmark = pytest.mark.ros


class Daemon:
    """What a daemon knows of the others, and its price, which it sends while it drives."""

    def __init__(self, node, clock):
        self._node = node
        self.send = PriceSender(node)
        self.guid = rcl().gid_of(self.send.handle)
        self.heard = OtherDaemons(node, self.guid, tells_hosts=True, clock=clock)

    def beat(self):
        self.heard.see(writers_of(self._node, PRICE_TOPIC))
        if not self.heard.active_daemon():
            self.send()
        return self.heard


@pytest.fixture
def clock():
    return SkippingClock()


@pytest.fixture
def daemons(ros, clock):
    """Two daemons in participants of their own, as in processes of their own; the one with the lower GUID first."""
    elsewhere = rclpy.Context()
    rclpy.init(context=elsewhere, domain_id=DOMAIN)
    found = [Daemon(ros.node("arpd"), clock), Daemon(rclpy.create_node("arpd", context=elsewhere), clock)]
    yield sorted(found, key=lambda daemon: daemon.guid)
    rclpy.try_shutdown(context=elsewhere)


def test_the_one_with_the_lowest_guid_drives_and_is_succeeded(daemons, clock, eventually):
    """Of two daemons one drives while its price is heard, whoever came first; then the other one does."""
    lower, higher = daemons
    eventually("the other stands by", lambda: (lower.beat(), higher.beat())[1].active_daemon() == "this host")
    assert lower.beat().others == higher.beat().others == ("this host",)
    assert lower.heard.active_daemon() == ""

    def succeeds():
        clock.skip(5.0)
        return higher.beat().active_daemon() == ""

    eventually("it is succeeded", succeeds)
