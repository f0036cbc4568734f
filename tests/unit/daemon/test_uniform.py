"""The uniform policy in the whole tick: N from the graph, Rmax from the link, R and D on every publisher."""

from __future__ import annotations

import math
from typing import Any

import pytest

from arpd.daemon.tick import TICK_S, Daemon
from arpd.model.settings import (
    DefaultPreferences,
    GraphSettings,
    LinkSettings,
    Policy,
    ProgramSettings,
    Settings,
)
from arpd.model.wire import wire_size
from tests.sample_publishers import publisher
from tests.unit.daemon.world import World
from tests.unit.solve.test_eq4 import TABLE_2

PAYLOAD_BYTES, SOURCE_HZ = 100.0, 1000.0
WIRE_BYTES = wire_size(PAYLOAD_BYTES, rate_hz=SOURCE_HZ)[0]


PUBLISHERS = [
    publisher("/n", f"/t{i:02}", payload_bytes=PAYLOAD_BYTES, source_rate_hz=SOURCE_HZ, remote_readers=1)
    for i in range(12)
]


class Robot:
    """A daemon with the uniform policy, and a graph that may have more topics than those that it manages."""

    def __init__(self, max_rate_hz=200.0, **settings):
        self.settings = Settings(
            **{
                "link": LinkSettings(
                    capacity_bytes_per_second=max_rate_hz * WIRE_BYTES, headroom=1.0, packet_overhead_s=0.0
                ),
                "program": ProgramSettings(policy=Policy.UNIFORM, memory_budget_bytes=2.0**31),
                "defaults": DefaultPreferences(latency_budget_s=None),
                **settings,
            }
        )
        self.now_s = 0.0
        self.world = World(*PUBLISHERS, sensing_topics=11, actuation_topics=1, peers=0)
        self.daemon: Any = Daemon(self.world, self.settings, clock=lambda: self.now_s)

    def run(self, seconds):
        causes = []
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            decision = self.daemon.tick(self.now_s)
            causes += [decision.reason] if decision.reason else []
        return causes

    @property
    def rows(self):
        return self.daemon.snapshot.decision.plan.topics.values()

    @property
    def rates_hz(self):
        """Return the rates that publishers have in force: those of the last price sent, and of their rows."""
        return {round(self.world.prices[-1].rate_hz(row), 6) for row in self.rows}


@pytest.mark.parametrize("row", TABLE_2, ids=str)
def test_the_live_answer_is_table_2(row):
    """Twelve topics on a link whose Rmax is that of the paper have the R and D of its Table 2."""
    max_rate_hz, rate_floor, depth_floor, *_ = row
    robot = Robot(max_rate_hz)
    assert robot.run(3.0) == ["start"]
    assert len(robot.rows) == 12
    assert {math.floor(rate_hz) for rate_hz in robot.rates_hz} == {rate_floor}
    assert {plan.depth for plan in robot.rows} == {depth_floor}
    (deadline_ns,) = {plan.deadline_ns for plan in robot.rows}
    assert deadline_ns > 1e9 / min(robot.rates_hz)
    assert {each.depth for each in robot.world.publishers.values()} == {depth_floor}


def test_a_topic_that_arpd_does_not_manage_counts():
    """When topics join the graph, R falls at the next tick; after the debounce a plan has the new DEADLINE."""
    robot = Robot(800.0)
    robot.run(3.0)
    (before_hz,), (before,) = robot.rates_hz, {row.deadline_ns for row in robot.rows}
    robot.world.sees["sensing_topics"] = 23
    assert robot.run(0.3) == []
    (after_hz,) = robot.rates_hz
    assert (before_hz, after_hz) == (pytest.approx(800 / 12 - 1, rel=0.01), pytest.approx(800 / 24 - 1, rel=0.01))
    assert robot.run(2.0) == ["topics"]
    (after,) = {row.deadline_ns for row in robot.rows}
    assert after > 1.5 * before


def test_pinned_counts_replace_those_of_the_graph():
    """N is the sum of the counts in ``graph``."""
    robot = Robot(graph=GraphSettings(sensing_topics=30, actuation_topics=10))
    robot.run(3.0)
    assert robot.daemon.snapshot.allocation.uniform.topics == 40
    assert [*robot.rates_hz] == pytest.approx([200 / 40 - 1], rel=0.01)
