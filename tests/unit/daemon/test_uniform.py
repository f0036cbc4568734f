"""The uniform policy in the whole tick: N from the graph, Rmax from the link, R and D on every publisher."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from arpd.daemon.tick import TICK_S, Daemon
from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.observation import Glance, MemoryState, Observation
from arpd.model.settings import (
    GraphSettings,
    LinkSettings,
    Policy,
    ProgramSettings,
    Settings,
    TopicSettings,
)
from arpd.model.wire import wire_size
from arpd.report.status import status_document
from tests.sample_publishers import publisher
from tests.unit.solve.test_eq4 import TABLE_2

PAYLOAD_BYTES, SOURCE_HZ = 100.0, 1000.0
WIRE_BYTES = wire_size(PAYLOAD_BYTES, rate_hz=SOURCE_HZ)[0]


class World:
    """Publishers that take every row at once, on a graph that has more topics than those."""

    def __init__(self, settings, managed=12):
        self.graph, self.seen = settings.graph, managed
        self.price: Any = None
        self.steps = []
        self.publishers = {
            f"/t{i:02}": publisher(
                "/n", f"/t{i:02}", payload_bytes=PAYLOAD_BYTES, source_rate_hz=SOURCE_HZ, remote_readers=1
            )
            for i in range(managed)
        }

    def observe(self, now_s):
        pinned = self.graph
        return Observation(
            now_s=now_s,
            counters=LinkCounters(
                interface="w", rx_bytes=0, tx_bytes=0, rx_packets=0, tx_packets=0, tx_dropped=0, state=InterfaceState.UP
            ),
            reports=(),
            publishers=tuple(self.publishers.values()),
            memory=MemoryState(total_bytes=2**33, available_bytes=2**32),
            sensing_topics=self.seen - 1 if pinned.sensing_topics is None else pinned.sensing_topics,
            actuation_topics=1 if pinned.actuation_topics is None else pinned.actuation_topics,
            peers=0,
        )

    def apply(self, transitions, *, now_s):
        for step in transitions:
            self.steps.append(step)
            for name, row in step.topics.items():
                self.publishers[name] = replace(
                    self.publishers[name],
                    generation=step.generation,
                    rate_hz=row.rate_hz,
                    depth=row.depth,
                    deadline_ns=row.deadline_ns,
                )

    def set_price(self, price):
        self.price = price

    def ask(self, ask):
        pass

    def probe(self, request):
        pass

    def reconfigure(self, graph):
        self.graph = graph

    def results(self):
        return {}

    def stand_by(self):
        pass

    def glance(self):
        return Glance(has_reports=True, backlog_bytes=None)

    def probes_sent(self):
        return 0, 0


class Robot:
    """A daemon with the uniform policy over such a world."""

    def __init__(self, max_rate_hz=200.0, **settings):
        self.settings = Settings(
            **{
                "link": LinkSettings(
                    capacity_bytes_per_second=max_rate_hz * WIRE_BYTES, headroom=1.0, packet_overhead_s=0.0
                ),
                "program": ProgramSettings(policy=Policy.UNIFORM, memory_budget_bytes=2.0**31),
                "default_topic": TopicSettings(latency_budget_s=None),
                **settings,
            }
        )
        self.now_s = 0.0
        self.world = World(self.settings)
        self.daemon: Any = Daemon(self.world, self.settings, interface="w", clock=lambda: self.now_s)

    def run(self, seconds):
        causes = []
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            decision = self.daemon.tick(self.now_s)
            causes += [decision.reason] if decision.level_changed else []
        return causes

    @property
    def rows(self):
        return self.daemon.snapshot.decision.plan.topics.values()

    @property
    def rates_hz(self):
        """Return the rates that publishers have in force: those of the last price sent, and of their rows."""
        return {round(self.world.price.rate_hz(row), 6) for row in self.rows}


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
    robot.world.seen = 24
    assert robot.run(0.3) == []
    (after_hz,) = robot.rates_hz
    assert (before_hz, after_hz) == (pytest.approx(800 / 12 - 1, rel=0.01), pytest.approx(800 / 24 - 1, rel=0.01))
    assert robot.run(2.0) == ["topics"]
    (after,) = {row.deadline_ns for row in robot.rows}
    assert after > 1.5 * before


def test_a_count_that_comes_back_causes_no_plan():
    """A topic that is in the graph for less than the debounce changes the rate, but no QoS."""
    robot = Robot()
    robot.run(3.0)
    robot.world.seen = 24
    assert robot.run(0.5) == []
    robot.world.seen = 12
    assert robot.run(5.0) == []


def test_pinned_counts_replace_those_of_the_graph():
    """N is the sum of the counts in ``graph``."""
    robot = Robot(graph=GraphSettings(sensing_topics=30, actuation_topics=10))
    robot.world.seen = 12
    robot.run(3.0)
    assert robot.daemon.snapshot.allocation.uniform.topics == 40
    assert [*robot.rates_hz] == pytest.approx([200 / 40 - 1], rel=0.01)


def test_preferences_of_a_topic_do_not_count():
    """Weight, floor, bounds and budget of a single topic change nothing; those of all topics do."""
    own = TopicSettings(weight=9.0, min_rate_hz=20.0, max_rate_hz=3.0, min_depth=7, max_depth=9, latency_budget_s=0.1)
    robot = Robot(topics={"/t03": own}, default_topic=TopicSettings(min_rate_hz=2.0, latency_budget_s=None))
    robot.run(3.0)
    assert [*robot.rates_hz] == pytest.approx([200 / 12 - 2], rel=0.01)
    assert len({row.depth for row in robot.rows}) == 1


def test_a_reload_changes_the_policy():
    """A reload gives every topic the common rate with one plan, and its own rate back with another."""
    robot = Robot(program=ProgramSettings(memory_budget_bytes=2.0**31), topics={"/t03": TopicSettings(weight=4.0)})
    robot.run(3.0)
    assert len(robot.rates_hz) == 2
    per_topic = robot.settings
    uniform = replace(per_topic, program=replace(per_topic.program, policy=Policy.UNIFORM))
    for settings, rates in ((uniform, 1), (per_topic, 2)):
        assert robot.daemon.reload(lambda settings=settings: settings)
        assert robot.run(0.2) == ["reload"]
        assert len(robot.rates_hz) == rates
        assert robot.run(3.0) == []


def test_the_status_tells_the_optimum():
    """The status has N, Rmax, R and D; with the other policy it has null."""
    robot = Robot()
    robot.run(3.0)
    uniform = status_document(robot.daemon.snapshot)["allocation"]["uniform"]
    assert (uniform["topics"], uniform["depth"]) == (12, 390)
    assert uniform["max_rate_hz"] == pytest.approx(200, rel=0.01)
    other = Robot(program=ProgramSettings())
    other.run(3.0)
    assert status_document(other.daemon.snapshot)["allocation"]["uniform"] is None
