"""The daemon's statuses on /diagnostics, as a monitor on another node receives them."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from arpd.model.link import LinkState
from arpd.report.decision_log import DecisionLog
from arpd.ros.crossing import read_graph
from arpd.ros.diagnostics import DIAGNOSTICS_TOPIC, Diagnostics
from arpd.ros.graph_view import GraphView
from arpd.ros.rmw import current_rmw
from tests.golden.sample import changed

pytestmark = pytest.mark.ros

NAMES = ["arpd: link", "arpd: plan", "arpd: configuration", "arpd: events"]


class Daemon:
    """A daemon whose snapshots the test makes."""

    def __init__(self):
        self._decision_log = DecisionLog()
        self.snapshot = None

    def tick(self, **link):
        """Take the sample with all traffic admitted, and another link where the test says so."""
        # Of the future, so that it does not grow stale on a slow machine.
        times = {"finished_at_s": time.monotonic() + 1000.0, "unix_time_s": time.time()}
        snapshot = changed(link=link, decision={"gate": 1.0}, **times)
        self._decision_log.follow(snapshot)
        self.snapshot = replace(snapshot, events=self._decision_log.events)


class Monitor:
    """A monitor such as rqt_robot_monitor: it keeps arrays."""

    def __init__(self, node):
        self.arrays = []
        # diagnostic_aggregator subscribes with ROS's defaults: reliable, volatile.
        node.create_subscription(DiagnosticArray, DIAGNOSTICS_TOPIC, self.arrays.append, 10)

    def statuses(self):
        return {status.name: status for status in self.arrays[-1].status} if self.arrays else {}

    def message(self, name):
        return self.statuses()[name].message if name in self.statuses() else ""

    def events(self):
        return [value.value for value in self.statuses()["arpd: events"].values]


@pytest.fixture
def daemon():
    return Daemon()


class Clock:
    """A clock that can be stopped, so that nothing becomes due."""

    def __init__(self):
        self._stopped_s = None

    def stop(self):
        self._stopped_s = time.monotonic()

    def __call__(self):
        return self._stopped_s or time.monotonic()


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def looking(background):
    """Let diagnostics look again and again, as the daemon does after every tick."""

    def look(diagnostics):
        def work(stopping):
            while not stopping.wait(0.1):
                diagnostics.look()

        background(work)

    return look


@pytest.fixture
def monitor(ros, daemon, clock, looking):
    looking(Diagnostics(ros.node("arpd"), lambda: daemon.snapshot, clock=clock, host="robot-1"))
    return Monitor(ros.node("monitor"))


def test_a_monitor_sees_every_status(monitor, daemon, eventually):
    """An array has four statuses with names for an aggregator, levels, host, values and a stamp."""
    eventually("an array arrives", monitor.statuses)
    assert {status.level for status in monitor.statuses().values()} == {DiagnosticStatus.STALE}
    daemon.tick()
    eventually("the link is shown", lambda: "4 Mbit/s" in monitor.message("arpd: link"))
    array = monitor.arrays[-1]
    assert [status.name for status in array.status] == NAMES
    assert {status.hardware_id for status in array.status} == {"robot-1"}
    assert monitor.statuses()["arpd: link"].level == DiagnosticStatus.OK
    assert all(value.key and value.value for status in array.status[:2] for value in status.values)
    assert array.header.stamp.sec > 0


def test_an_event_reaches_a_monitor_at_once(monitor, daemon, clock, eventually):
    """An outage is published when it happens, also when nothing else is due."""
    daemon.tick()
    eventually("an array arrives", lambda: monitor.message("arpd: events"))
    clock.stop()
    daemon.tick(state=LinkState.OUTAGE)
    eventually("the outage is shown", lambda: any("carries nothing" in event for event in monitor.events()))
    assert monitor.statuses()["arpd: link"].level == DiagnosticStatus.ERROR


def test_nothing_is_made_without_a_subscriber(ros, daemon, looking, eventually, monkeypatch):
    """Arrays are published only once there is a subscriber."""
    published = []
    node = ros.node("arpd")
    real = node.create_publisher

    def watched(*arguments, **options):
        publisher = real(*arguments, **options)
        monkeypatch.setattr(publisher, "publish", published.append, raising=False)
        return publisher

    monkeypatch.setattr(node, "create_publisher", watched)
    looks = []
    looking(Diagnostics(node, lambda: looks.append(1) or daemon.snapshot))
    eventually("it has looked for longer than its period", lambda: len(looks) > 8)
    assert not published
    Monitor(ros.node("monitor"))
    eventually("it publishes", lambda: published)


def test_a_fault_in_publishing_is_logged_once_and_harms_nobody(ros, caplog):
    """Whoever calls it goes on, and the fault is logged once."""

    def broken():
        raise RuntimeError("no picture")

    diagnostics = Diagnostics(ros.node("arpd"), broken)
    for _ in range(3):
        diagnostics.look()
    assert sum("nothing is published on /diagnostics" in record.message for record in caplog.records) == 1


def test_the_daemons_diagnostics_are_no_traffic_of_the_robot(ros, daemon, looking, eventually):
    """The graph shows the robot's writers of /diagnostics without the daemon's."""
    node = ros.node("arpd")
    looking(Diagnostics(node, lambda: daemon.snapshot))
    Monitor(ros.node("monitor"))
    view = GraphView.of(node)

    def seen():
        view.look()
        return read_graph(view, current_rmw()).crossings.get(DIAGNOSTICS_TOPIC)

    eventually("the monitor shows", lambda: seen() and view.readers(DIAGNOSTICS_TOPIC))
    battery = ros.node("battery").create_publisher(DiagnosticArray, DIAGNOSTICS_TOPIC, 1)
    eventually("the robot's alone shows", lambda: seen().writers == {"/battery"})
    battery.destroy()
