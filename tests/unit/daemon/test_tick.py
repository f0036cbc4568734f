"""The daemon over a world that follows its calls, some of them late."""

import math
from collections import Counter
from dataclasses import replace
from typing import Any

import pytest

from arpd.daemon.run import new_durations, stop
from arpd.daemon.tick import Daemon
from arpd.model.endpoints import Direction
from arpd.model.link import LinkState
from arpd.model.plan import MOST_GENERATION
from arpd.model.settings import LinkSettings, RelaySettings, Settings
from arpd.report.situation import status_line
from arpd.solve.program import Program
from tests.sample_publishers import publisher
from tests.unit.daemon.world import KnownLink, World

TOPIC = "/t"
MS = 1_000_000


class Robot(World):
    """A publisher with a predecessor's plan, which announces a new row a second after it was sent."""

    def __init__(self, **options):
        super().__init__(
            publisher("/w", TOPIC, deadline_ns=80 * MS, baseline_deadline_ns=90 * MS, depth=20, generation=7),
            takes_s=1.0,
            **options,
        )
        self.now_s = 0.0

    @property
    def writer(self):
        return self.publishers[TOPIC]

    def change(self, **fields):
        self.publishers[TOPIC] = replace(self.writer, **fields)

    def hear(self, daemon):
        self.sees |= {"other_daemons": (daemon,) if daemon else (), "active_daemon": daemon}

    def wait(self, seconds):
        self.now_s += seconds


def restored(world):
    daemon = Daemon(world, Settings(), clock=lambda: world.now_s)
    return daemon.restore(wait=world.wait)


def test_a_clean_stop_restores_by_a_generation_that_nodes_take():
    """A node that announces the highest generation keeps nobody from restoring: nodes refuse a higher one."""
    world = Robot()
    world.change(generation=MOST_GENERATION, direction=Direction.SENSING, remote_readers=1)
    settings = Settings(link=LinkSettings(capacity_bytes_per_second=1e6))
    daemon = Daemon(world, settings, clock=lambda: world.now_s)
    while daemon.tick(world.now_s).plan.generation == 0:
        world.wait(0.1)
    assert daemon.restore(wait=world.wait) == 0
    assert (world.writer.depth, world.writer.generation) == (10, MOST_GENERATION)


def test_a_clean_stop_restores_the_application_s_qos_and_its_rates_last():
    """QoS comes first, at the paced rate, because a weak link could not prove a new writer at the full rate."""
    world = Robot()
    world.change(rate_hz=8.0, paced_rate_hz=5.0)
    assert restored(world) == 0
    assert (world.writer.depth, world.writer.deadline_ns, world.writer.rate_hz) == (10, 90 * MS, math.inf)
    assert world.writer.generation >= 7  # its own before
    rows = [topics[TOPIC] for node, topics in world.sent if node == "/w"]
    assert [row.rate_hz for row in rows] == [*(len(rows) - 1) * [5.0], math.inf]


def test_a_clean_stop_gives_each_publisher_of_a_topic_its_own_qos_back():
    """Several nodes may publish one topic, each with its own history; the plan has one row, with the fastest rate."""
    world = Robot()
    other = replace(world.writer, node="/w2", baseline_depth=9000, baseline_deadline_ns=0, paced_rate_hz=5.0)
    world.publishers["other"] = other
    world.change(paced_rate_hz=8.0)
    assert restored(world) == 0
    writers = [(each.depth, each.deadline_ns, each.rate_hz) for each in world.publishers.values()]
    assert writers == [(10, 90 * MS, math.inf), (9000, 0, math.inf)]
    assert world.sent[0][1][TOPIC].rate_hz == 8.0


def test_a_clean_stop_leaves_the_plan_of_the_daemon_that_took_over_alone():
    """It stood by because its GUID is higher, so that the one that stops never hears of it; its plans have a number."""
    world = Robot(deaf={"/w"})
    wait = world.wait

    def wait_for_the_other(seconds):
        wait(seconds)
        if world.now_s > 8.0:
            world.change(generation=20)

    world.wait = wait_for_the_other
    assert restored(world) is None
    assert world.now_s < 9.0


def test_a_clean_stop_gives_up_on_a_node_that_is_gone():
    """A publisher that does not answer is counted, and the daemon ends all the same."""
    world = Robot(deaf={"/w"})
    assert restored(world) == 1
    assert world.now_s < 16.5  # and the HTTP server has two seconds to end


def test_a_daemon_that_stands_by_only_watches(caplog):
    """While another daemon is active it sets, probes and restores nothing, and says why; then it takes over."""
    caplog.set_level("INFO", "arpd.daemon.run")
    world = Robot()
    events: list[Any] = []
    daemon = Daemon(world, Settings(), clock=lambda: world.now_s, tell=events.append)
    world.hear("robot-2")
    for _ in range(100):
        world.now_s += 0.1
        daemon.tick(world.now_s)
    assert (world.sent, world.prices, world.probes) == ([], [], [])
    stop(daemon)
    assert not world.sent
    assert "another daemon drives" in caplog.text
    assert "robot-2" in status_line(daemon.snapshot)
    assert [event.kind for event in events].count("standing_by") == 1
    world.hear("")
    world.now_s += 0.1
    daemon.tick(world.now_s)
    assert world.prices
    assert world.probes


@pytest.mark.parametrize(("generation", "waits"), [(7, True), (0, False)])
def test_a_predecessors_price_stays_until_there_is_another(generation, waits):
    """A daemon that has measured nothing yet sends a price to new nodes alone, because it would limit nothing."""
    world: Any = Robot()
    world.change(generation=generation, direction=Direction.SENSING, remote_readers=1)
    daemon: Any = Daemon(world, Settings(), clock=lambda: world.now_s)
    daemon.tick(world.now_s)
    while daemon.snapshot.allocation.price is None:
        assert bool(world.prices) is not waits
        world.wait(0.1)
        daemon.tick(world.now_s)
    assert 1.0 < world.now_s < 5.0
    assert world.prices


@pytest.mark.parametrize("stage", ["observe", "solve"])
def test_a_tick_that_fails_leaves_the_plan_in_force(monkeypatch, stage):
    """Such a tick sends nothing, and the next one that succeeds continues from the last good one."""
    world: Any = Robot()
    world.hear("robot-2")
    settings = Settings(link=LinkSettings(capacity_bytes_per_second=1e6))
    daemon: Any = Daemon(world, settings, clock=lambda: 0.0)
    daemon.tick(0.0)
    world.hear("")
    world.change(direction=Direction.SENSING, remote_readers=1)
    for tick in range(31):
        daemon.tick(0.1 * tick)
    before, prices = daemon.snapshot, len(world.prices)
    assert before.decision.plan.generation > 0

    def fail(*_arguments, **_options):
        raise ArithmeticError("a bug")

    with monkeypatch.context() as broken:
        broken.setattr(World if stage == "observe" else Program, stage, fail)
        for tick in range(10):  # the first is a whole turn, and so is every one after a failure
            with pytest.raises(ArithmeticError):
                daemon.tick(3.6 + 0.1 * tick)
            daemon.record.note_failed_tick()
    assert daemon.snapshot.totals.ticks_failed == 10
    assert (replace(daemon.snapshot, totals=before.totals), len(world.prices)) == (before, prices)
    daemon.tick(4.6)
    assert daemon.snapshot.decision.plan == before.decision.plan
    assert daemon.snapshot.totals.ticks_failed == 10


def test_it_plans_twice_a_second_and_at_once_on_news():
    """Between two plans only the price follows the link, and another state is news; each duration has its histogram."""
    world, link, told = Robot(), KnownLink(1e6), Counter()
    world.change(source_rate_hz=100.0, remote_readers=1)

    def timed(name, _took_s):
        told[name] += 1

    daemon: Any = Daemon(world, Settings(), clock=lambda: 0.0, estimator=link, timed=timed)
    for tick in range(10):
        daemon.record.note_lateness(0.0)
        daemon.tick(0.1 * tick)
    assert (daemon.record.counted, daemon.snapshot.totals.ticks) == (2, 6)
    assert told == {"tick_lateness": 10, "tick_duration": 10, "solve_duration": 2}
    assert told.keys() == new_durations().keys()
    link.state = LinkState.OUTAGE
    daemon.tick(1.0 - 0.05)
    assert (daemon.record.counted, daemon.snapshot.totals.ticks) == (3, 11)


def test_topics_that_have_settled_are_planned_when_the_capacity_is_known():
    """A daemon that starts waits for the capacity and for its topics at the same time, not for one after the other."""
    world, link = Robot(), KnownLink(1e6)
    world.change(source_rate_hz=100.0, remote_readers=1)
    daemon: Any = Daemon(world, Settings(), clock=lambda: 0.0, estimator=link)
    for tick in range(40):
        link.has_evidence = tick >= 15
        if daemon.tick(0.1 * tick).reason:
            break
    assert (tick, daemon.snapshot.decision.reason) == (15, "start")


def test_the_price_follows_the_link_within_a_tick():
    """The tick that sees another capacity sends another price, and no plan."""
    world, link = Robot(), KnownLink(1e6)
    world.change(source_rate_hz=100.0, remote_readers=1)
    daemon: Any = Daemon(world, Settings(), clock=lambda: 0.0, estimator=link)
    for tick in range(19):
        daemon.tick(0.1 * tick)
    link.capacity = 4e4
    daemon.tick(1.9)
    first, *_, last = world.prices
    row = daemon.snapshot.decision.plan.topics[TOPIC]
    assert (first.rate_hz(row), daemon.snapshot.decision.reason) == (row.rate_hz, "")
    assert 0.84 * 4e4 < last.rate_hz(row) * row.wire_bytes <= 4e4


@pytest.mark.parametrize(("link_domain", "is_postponed"), [(None, True), (77, False)])
def test_between_two_ends_the_plan_of_many_topics_waits_for_no_budget_of_swaps(link_domain, is_postponed):
    """The relay's queue takes a plan as it is, so 300 topics get theirs at once; nodes of their own swap in turn."""
    topics = [f"/t{number}" for number in range(300)]
    world = World(*(publisher("/arpd_relay", topic, source_rate_hz=2.0, remote_readers=1) for topic in topics))
    settings = Settings(relay=RelaySettings(link_domain=link_domain))
    daemon: Any = Daemon(world, settings, clock=lambda: 0.0, estimator=KnownLink(2.5e6))
    for tick in range(40):
        daemon.tick(0.1 * tick)
    deadlines = [each.deadline_ns > 0 for each in world.publishers.values()]
    assert any(deadlines)
    assert (daemon.snapshot.decision.is_postponed, all(deadlines)) == (is_postponed, not is_postponed)
