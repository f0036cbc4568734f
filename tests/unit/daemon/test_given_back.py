"""Topics whose last reader across the link has left: they are their application's again."""

import math
from dataclasses import replace
from typing import Any

import pytest

from arpd.daemon.tick import Daemon
from arpd.model.endpoints import Direction
from arpd.model.link import LinkState
from arpd.model.settings import Settings
from tests.sample_publishers import publisher
from tests.unit.daemon.world import KnownLink, World

MS = 1_000_000
OWN = 10, 90 * MS  # depth and deadline that each application has chosen
BACK_S = 30.0  # three dwells


class Robot(World):
    """Publishers with readers across the link, and a daemon that has planned them."""

    def __init__(self, *names):
        super().__init__(
            *(
                publisher(
                    "/w", name, payload_bytes=1e4, remote_readers=1, deadline_ns=OWN[1], baseline_deadline_ns=OWN[1]
                )
                for name in names
            )
        )
        self.link, self.now_s = KnownLink(1e5), 0.0  # where no deadline is as short as the applications' own
        self.daemon: Any = Daemon(self, Settings(), clock=lambda: self.now_s, estimator=self.link)
        self.ticks(15.0)
        self.planned = {name: self.qos(name) for name in names}
        assert all(deadline_ns > 100 * MS for _, deadline_ns in self.planned.values())

    def qos(self, name):
        return self.publishers[name].depth, self.publishers[name].deadline_ns

    def change(self, name, **fields):
        self.publishers[name] = replace(self.publishers[name], **fields)

    def leave(self, *names):
        for name in names:
            self.change(name, direction=Direction.LOCAL, remote_readers=0)

    def come(self, *names):
        self.sent.clear()  # the same plan is a new one
        for name in names:
            self.change(name, direction=Direction.SENSING, remote_readers=1)

    def ticks(self, seconds):
        """Tick for so long; return the causes of plans."""
        causes = []
        for _ in range(round(10 * seconds)):
            self.now_s += 0.1
            causes.append(self.daemon.tick(self.now_s).reason)
        return [cause for cause in causes if cause]


@pytest.mark.parametrize("gone", [("/a",), ("/a", "/b")], ids=["beside others", "nothing crosses"])
def test_a_local_reader_of_a_topic_that_has_left_is_served(gone):
    """It requests less than the plan offers, and the application offers that."""
    robot = Robot("/a", "/b")
    robot.leave(*gone)
    robot.ticks(3.0)
    robot.change("/a", requested_deadline_ns=100 * MS)
    assert robot.ticks(2.0) == ["readers"]
    assert robot.qos("/a") == OWN
    assert ("/b" in gone) <= (robot.qos("/b") == robot.planned["/b"])


def test_a_topic_that_crosses_no_more_is_its_applications_again():
    """After the time that any better QoS waits it has its own, without a ceiling, once; back on the link, a plan."""
    robot = Robot("/a", "/b")
    robot.leave("/a")
    assert robot.ticks(BACK_S) == ["topics"]
    assert robot.qos("/a") == robot.planned["/a"]
    assert robot.ticks(BACK_S) == ["topics"]
    assert robot.qos("/a") == OWN
    assert robot.publishers["/a"].rate_hz == math.inf
    assert robot.daemon.snapshot.confirmed == 2
    assert robot.daemon.snapshot.decision.plan.topics["/a"].weight > 0  # so the price holds until that plan
    robot.come("/a")
    assert robot.ticks(5.0) == ["topics"]
    assert robot.qos("/a") == robot.planned["/a"]


@pytest.mark.parametrize("gone", [("/a",), ("/a", "/b")], ids=["beside others", "nothing crosses"])
def test_a_far_reader_that_blinks_swaps_nothing(gone):
    """However often it leaves for less than half a minute, the QoS in force stays."""
    robot = Robot("/a", "/b")
    kept = {name: robot.planned[name] for name in gone}
    for _ in range(4):
        robot.leave(*gone)
        robot.ticks(BACK_S - 2.0)
        assert {name: robot.qos(name) for name in gone} == kept
        robot.come(*gone)
        robot.ticks(5.0)
        assert {name: robot.qos(name) for name in gone} == kept


def test_what_an_outage_hides_is_not_given_back():
    """Readers beyond a lost link are only silent, and return some seconds after it."""
    robot = Robot("/a", "/b")
    robot.link.state = LinkState.OUTAGE
    robot.leave("/a", "/b")
    assert robot.ticks(300.0) == []
    robot.link.state = LinkState.STEADY
    assert robot.ticks(BACK_S - 2.0) == []
    robot.come("/a", "/b")
    assert robot.ticks(BACK_S) == []


def test_a_reader_that_only_the_plan_serves_keeps_its_topic():
    """Its request is shorter than what the application offers, which would lose it."""
    robot = Robot("/a")
    robot.change("/a", requested_deadline_ns=80 * MS)
    robot.ticks(3.0)
    assert robot.qos("/a")[1] == 80 * MS
    robot.leave("/a")
    assert robot.ticks(3 * BACK_S) == ["topics"]
    assert robot.qos("/a")[1] == 80 * MS
    robot.change("/a", requested_deadline_ns=0)
    robot.ticks(BACK_S + 1.0)
    assert robot.qos("/a") == OWN


def test_what_a_predecessor_planned_is_given_back_too():
    """A daemon that starts finds the ceiling of a plan on a topic that does not cross."""
    robot = Robot("/a")
    robot.leave("/a")
    robot.daemon = Daemon(robot, Settings(), clock=lambda: robot.now_s, estimator=robot.link)
    assert robot.ticks(BACK_S + 5.0) == ["topics"]
    assert (robot.qos("/a"), robot.publishers["/a"].rate_hz) == (OWN, math.inf)
