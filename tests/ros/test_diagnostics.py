"""The daemon's statuses on /diagnostics, as a monitor on another node receives them."""

import platform
import time
from dataclasses import replace

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from arpd.report.decision_log import DecisionLog
from arpd.ros.diagnostics import DIAGNOSTICS_TOPIC, Diagnostics
from tests.golden.sample import changed

NAMES = ["arpd: link", "arpd: plan", "arpd: configuration", "arpd: events"]


class Daemon:
    """A daemon whose snapshots and ticks the test makes."""

    def __init__(self, node):
        self._decision_log = DecisionLog()
        self.node, self.now_s, self.snapshot = node, 0.0, None
        self.diagnostics = Diagnostics(node, lambda: self.snapshot, clock=lambda: self.now_s)

    def take(self, **link):
        """Take the sample with all traffic admitted, and another link where the test says so."""
        snapshot = changed(link=link, decision={"allowed": 1.0}, finished_at_s=1e9, unix_time_s=time.time())
        self._decision_log.follow(snapshot)
        self.snapshot = replace(snapshot, events=self._decision_log.events)

    def look(self, after_s=10.0):
        self.now_s += after_s
        self.diagnostics.look()


class Monitor:
    """A monitor such as rqt_robot_monitor: it keeps arrays."""

    def __init__(self, node):
        self.arrays = []
        # diagnostic_aggregator subscribes with ROS's defaults: reliable, volatile.
        node.create_subscription(DiagnosticArray, DIAGNOSTICS_TOPIC, self.arrays.append, 10)

    def __getitem__(self, name):
        """Return the last status of this name, an empty one if there is none."""
        return next((status for status in self.arrays[-1].status if status.name == name), DiagnosticStatus())


@pytest.fixture
def daemon(ros):
    return Daemon(ros.node("arpd"))


@pytest.fixture
def monitor(ros, daemon, eventually):
    monitor = Monitor(ros.node("monitor"))
    eventually("an array arrives", lambda: daemon.look() or monitor.arrays)
    return monitor


def test_a_monitor_sees_every_status(monitor, daemon, eventually):
    """An array has four statuses with names for an aggregator, levels, host, values and a stamp."""
    assert {status.level for status in monitor.arrays[-1].status} == {DiagnosticStatus.STALE}
    daemon.take()
    eventually("the link is shown", lambda: daemon.look() or "4 Mbit/s" in monitor["arpd: link"].message)
    array = monitor.arrays[-1]
    assert [status.name for status in array.status] == NAMES
    assert {status.hardware_id for status in array.status} == {platform.node()}
    assert monitor["arpd: link"].level == DiagnosticStatus.OK
    assert all(value.key and value.value for status in array.status[:2] for value in status.values)
    assert array.header.stamp.sec > 0


def test_nothing_is_made_without_a_subscriber(ros, daemon, eventually, monkeypatch):
    """Arrays are published only once there is a subscriber."""
    published = []
    monkeypatch.setattr(daemon.diagnostics._publisher, "publish", published.append, raising=False)
    for _ in range(8):
        daemon.look()
    assert not published
    Monitor(ros.node("monitor"))
    eventually("it publishes", lambda: daemon.look() or published)


def test_a_fault_in_publishing_is_logged_once_and_harms_nobody(daemon, monkeypatch, caplog):
    """Whoever calls it goes on, and the fault is logged once."""
    monkeypatch.setattr(daemon.diagnostics, "_snapshot", lambda: 1 / 0)
    for _ in range(3):
        daemon.look()
    assert sum("nothing is published on /diagnostics" in record.message for record in caplog.records) == 1
