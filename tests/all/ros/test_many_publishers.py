"""A thousand publishers on four nodes are found, planned and confirmed, with real rclpy."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.govern.progress import progress
from arpd.model.plan import QosPlan, TopicPlan
from arpd.model.settings import GraphSettings
from arpd.ros.world import RosControl
from tests.ros.world import DOMAIN

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]
NODES, TOPICS = 4, 250
REPO = Path(__file__).parents[3]
ALL = NODES * TOPICS
MOST_ROW_S = 250e-6  # of this process per topic and second; measured: 36
TICKS_HZ = 10.0
MEASURED_S = 16.0


class Planner:
    """The daemon's ROS side and its progress, without the program: one plan for every topic that is there."""

    def __init__(self, node):
        self._control = RosControl(node, interface="lo", graph=GraphSettings(), on_report=lambda: None)
        self.observation = self.come = self.plan = None

    def intend(self, generation, **fields):
        row = TopicPlan(**{"rate_hz": 50.0, "min_rate_hz": 0.1, "deadline_ns": 0, "depth": 10, **fields})
        topics = {publisher.topic: row for publisher in self.observation.publishers}
        self.plan = QosPlan(generation=generation, topics=topics, level_bytes_per_second=1.0)
        self.come = None

    @property
    def results(self):
        return self._control.results()

    @property
    def is_in_force(self):
        return self.come is not None and self.come.confirmed == ALL and not self.come.missing

    def tick(self):
        now_s = time.monotonic()
        self.observation = seen = self._control.observe(now_s)
        if (plan := self.plan) is None:
            return
        self.come = progress(seen.publishers, plan)
        self._control.apply(plan, lease_s=0.0, missing=self.come.missing, now_s=now_s)


@pytest.fixture
def talkers():
    with subprocess.Popen(
        [sys.executable, Path(__file__).with_name("many_talkers.py"), str(NODES), str(TOPICS)],
        env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "PYTHONPATH": str(REPO)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        yield process
        process.kill()


def wait_until(planner, condition, timeout_s=60.0):
    """Tick as the daemon does until a condition holds; return the time it took (s)."""
    begun_s = time.monotonic()
    while not condition():
        assert time.monotonic() - begun_s < timeout_s, planner.come and planner.come.confirmed
        planner.tick()
        time.sleep(1 / TICKS_HZ)
    return time.monotonic() - begun_s


def test_a_thousand_publishers_are_found_planned_and_confirmed(ros, talkers):
    """All are found and stay, a plan of terms and one with another depth come into force, at a small cost."""
    planner = Planner(ros.node("arpd"))
    while (line := talkers.stdout.readline().strip()) != "ready":
        print(line)
    found_s = wait_until(planner, lambda: planner.observation and len(planner.observation.publishers) == ALL)
    planner.intend(1, weight=1.0, wire_bytes=250.0, packets=1)
    terms_s = wait_until(planner, lambda: planner.is_in_force)
    planner.intend(2, weight=1.0, wire_bytes=250.0, packets=1, depth=12)
    swaps_s = wait_until(planner, lambda: planner.is_in_force, timeout_s=120.0)
    print(f"found in {found_s:.1f} s, terms in force in {terms_s:.1f} s, swaps in {swaps_s:.1f} s; {planner.results}")
    assert planner.results["ok"] >= 2 * NODES
    cost_s = measure(planner)
    print(f"the daemon's ROS side takes {1e6 * cost_s / ALL:.0f} us a topic and second")
    assert len(planner.observation.publishers) == ALL, "all of them stay"
    assert all(state.offered > 0 for state in planner.observation.publishers)
    assert cost_s / ALL < MOST_ROW_S


def measure(planner):
    """Return the processor time of this process a second while nothing happens (s)."""
    begun_s, cpu_s = time.monotonic(), time.process_time()
    while time.monotonic() - begun_s < MEASURED_S:
        planner.tick()
        time.sleep(1 / TICKS_HZ)
    return (time.process_time() - cpu_s) / (time.monotonic() - begun_s)
