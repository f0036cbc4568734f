"""The daemon over a world that follows its calls, some of them late."""

import itertools
import math
from dataclasses import replace
from typing import Any

import pytest

from arpd.daemon.tick import Daemon
from arpd.model.endpoints import Direction
from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.link import LinkState
from arpd.model.observation import Glance, MemoryState, Observation
from arpd.model.settings import LinkSettings, Settings
from arpd.solve.program import Program
from tests.sample_link import LINK
from tests.sample_publishers import publisher, reader

TOPIC = "/t"
MS = 1_000_000


class World:
    """One publisher and one reader with a predecessor's plan; each announces a new row a second after its call."""

    def __init__(self, *, deaf=()):
        self.now_s = 0.0
        self.sent = []
        self.active_daemon = ""
        self.prices = []
        self.probes = []
        self._deaf = deaf
        self._pending = []
        self.writer = publisher("/w", TOPIC, deadline_ns=80 * MS, baseline_deadline_ns=90 * MS, depth=20, generation=7)
        self.reader = reader("/r", TOPIC, deadline_ns=120 * MS, baseline_deadline_ns=100 * MS, depth=20, generation=9)

    def observe(self, now_s):
        for at_s, change in tuple(self._pending):
            if at_s <= now_s:
                change()
                self._pending.remove((at_s, change))
        return Observation(
            now_s=now_s,
            counters=None,
            reports=(),
            publishers=(self.writer,),
            readers=(self.reader,),
            memory=MemoryState(total_bytes=2**30, available_bytes=2**29),
            sensing_topics=1,
            actuation_topics=0,
            other_daemons=(self.active_daemon,) if self.active_daemon else (),
            active_daemon=self.active_daemon,
        )

    def apply(self, transitions, *, now_s):
        for step in transitions:
            if step.node in self._deaf or (step.node, step.topics, step.readers) in self.sent:
                continue
            self.sent.append((step.node, step.topics, step.readers))
            self._pending.append((now_s + 1.0, lambda step=step: self._announce(step)))

    def _announce(self, step):
        for row in step.topics.values():
            self.writer = replace(
                self.writer,
                generation=step.generation,
                rate_hz=row.rate_hz,
                paced_rate_hz=row.rate_hz,
                depth=row.depth,
                deadline_ns=row.deadline_ns,
            )
        for row in step.readers.values():
            self.reader = replace(self.reader, generation=step.generation, depth=row.depth, deadline_ns=row.deadline_ns)

    def set_price(self, price):
        self.prices.append(price)

    def ask(self, ask):
        pass

    def probe(self, request):
        self.probes.append(request)

    def reconfigure(self, graph):
        pass

    def results(self):
        return {}

    def stand_by(self):
        self.stood_by = True

    def glance(self):
        return Glance(has_reports=True, backlog_bytes=None)

    def probes_sent(self):
        return 0, 0

    def wait(self, seconds):
        self.now_s += seconds


def restored(world):
    daemon = Daemon(world, Settings(), interface="lo", clock=lambda: world.now_s)
    return daemon.restore(wait=world.wait)


def test_a_clean_stop_restores_writers_and_readers_in_order():
    """Writer and reader return to their application's QoS without losing each other."""
    world = World()
    assert restored(world) == 0
    assert (world.writer.depth, world.writer.deadline_ns) == (10, 90 * MS)
    assert (world.reader.depth, world.reader.deadline_ns) == (10, 100 * MS)
    assert world.writer.generation >= 9, "a reader refuses a plan that is older than its own"


def test_a_clean_stop_waits_for_the_reader_that_goes_first():
    """A writer whose own deadline is longer than the reader's request waits until the reader is restored."""
    world = World()
    world.reader = replace(world.reader, deadline_ns=85 * MS)
    assert restored(world) == 0
    offers = [topics[TOPIC].deadline_ns if topics else node for node, topics, _ in world.sent]
    assert offers == [80 * MS, "/r", 90 * MS]


def test_a_clean_stop_gives_the_rates_back_last():
    """QoS comes first, at the paced rate, because a weak link could not prove a new writer at the full rate."""
    world = World()
    world.writer = replace(world.writer, rate_hz=8.0, paced_rate_hz=5.0)
    assert restored(world) == 0
    rows = [topics[TOPIC] for node, topics, _ in world.sent if node == "/w"]
    assert [row.rate_hz for row in rows] == [*(len(rows) - 1) * [5.0], math.inf]
    assert (rows[-2].depth, rows[-2].deadline_ns) == (rows[-1].depth, rows[-1].deadline_ns) == (10, 90 * MS)


def test_a_clean_stop_gives_the_rates_back_whatever_the_readers_do():
    """A publisher whose QoS cannot be restored is unpaced all the same."""
    world = World(deaf={"/r"})
    world.writer, world.reader = replace(world.writer, rate_hz=5.0), replace(world.reader, deadline_ns=85 * MS)
    assert restored(world) == 1
    assert math.isinf(world.writer.rate_hz)


def test_a_clean_stop_gives_up_on_a_reader_that_is_gone():
    """A reader that does not answer is counted, and its writer offers what that reader requests."""
    world = World(deaf={"/r"})
    world.reader = replace(world.reader, deadline_ns=85 * MS)
    assert restored(world) == 1
    assert (world.writer.depth, world.writer.deadline_ns) == (10, 85 * MS)


def test_a_daemon_that_stands_by_only_watches():
    """While another daemon is active it sets, probes and restores nothing, and says why; then it takes over."""
    world = World()
    events: list[Any] = []
    daemon = Daemon(world, Settings(), interface="lo", clock=lambda: world.now_s, tell=events.append)
    world.active_daemon = "robot-2"
    for _ in range(100):
        world.now_s += 0.1
        daemon.tick(world.now_s)
    assert (world.sent, world.prices, world.probes) == ([], [], [])
    assert daemon.restore(wait=world.wait) == 0
    assert not world.sent
    assert (
        daemon.status_line() == "standing by: another arpd daemon, on robot-2, has run for longer and drives this robot"
    )
    assert [event.text for event in events if event.kind == "standing_by"] == [
        "standing by: another arpd daemon, on robot-2, has run for longer and drives this robot"
    ]
    world.active_daemon = ""
    world.now_s += 0.1
    daemon.tick(world.now_s)
    assert world.prices
    assert world.probes


def test_a_stop_right_after_the_start_restores_what_a_predecessor_left():
    """A daemon first waits for the publishers with a plan, and for another active daemon."""
    world = World()
    late: Any = World()
    late.active_daemon = "robot-2"
    seen = late.observe

    def observe(now_s):
        observation = seen(now_s)
        return observation if now_s > 1.0 else replace(observation, active_daemon="", other_daemons=())

    late.observe = observe
    assert (restored(world), restored(late)) == (0, 0)
    assert world.writer.deadline_ns == 90 * MS
    assert not late.sent


@pytest.mark.parametrize("stage", ["observe", "solve"])
def test_a_tick_that_fails_leaves_the_plan_in_force(monkeypatch, stage):
    """Such a tick sends nothing, and the next one that succeeds continues from the last good one."""
    world: Any = World()
    world.active_daemon = "robot-2"
    daemon: Any = Daemon(world, Settings(link=LinkSettings(capacity_bytes_per_second=1e6)), interface="lo")
    daemon.tick(0.0)
    world.active_daemon = ""
    world.writer = replace(world.writer, direction=Direction.SENSING, remote_readers=1)
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


class KnownLink:
    """An estimator that knows the capacity, tick by tick."""

    has_evidence = True

    def needs_look(self, _now_s, _backlog_bytes):
        return True

    def __init__(self, *capacities, **fields):
        self._capacities = itertools.chain(capacities, itertools.repeat(capacities[-1]))
        self._fields = fields

    def update(self, _observation):
        return replace(LINK, capacity_bytes_per_second=next(self._capacities), **self._fields)

    def wanted_probes(self, _now_s):
        return ()


def governed(estimator, *, ticks=20):
    """Return a world after some ticks of a daemon, and the daemon."""
    world: Any = World()
    world.writer = replace(world.writer, source_rate_hz=100.0, remote_readers=1)
    daemon: Any = Daemon(world, Settings(), interface="lo", clock=lambda: 0.0, estimator=estimator)
    for tick in range(ticks):
        daemon.tick(0.1 * tick)
    return world, daemon


@pytest.mark.parametrize("state", [LinkState.STEADY, LinkState.OUTAGE])
@pytest.mark.parametrize("capacity", [0.0, 0.5, 2e4, 1e6])
def test_whatever_the_link_carries_there_is_a_price(capacity, state):
    """Every tick ends with a price that admits no more than the link carries, also where that is nothing."""
    world, daemon = governed(KnownLink(capacity, state=state, loss_ratio=0.25))
    row = daemon.snapshot.decision.plan.topics[TOPIC]
    assert world.prices[-1].rate_hz(row) * row.wire_bytes <= capacity
    assert world.prices[-1].loss_ratio == 0.25


def test_the_price_follows_the_link_within_a_tick():
    """The tick that sees another capacity sends another price, and no plan."""
    world, daemon = governed(KnownLink(*[1e6] * 19, 4e4))
    first, *_, last = world.prices
    row = daemon.snapshot.decision.plan.topics[TOPIC]
    assert (first.rate_hz(row), daemon.snapshot.decision.level_changed) == (row.rate_hz, False)
    assert 0.84 * 4e4 < last.rate_hz(row) * row.wire_bytes <= 4e4


def test_a_link_that_hardly_moves_is_divided_once():
    """Capacities within a fraction of a per cent are one or two questions to the program, not one per tick."""
    _, daemon = governed(KnownLink(*[1e6 * (1.0 + 1e-4 * (tick % 7)) for tick in range(40)]), ticks=40)
    assert sum(daemon.snapshot.totals.solves_by_outcome.values()) <= 8  # each for link and memory


def test_an_interface_that_is_not_there_yet_is_named():
    """The status distinguishes an interface that was never there from one that is gone."""
    world: Any = World()
    for wanted, said in (("wlan0", "wlan0 is not there yet"), ("auto", "no link interface is there yet")):
        daemon: Any = Daemon(world, Settings(), interface=wanted)
        daemon.tick(0.0)
        assert daemon.status_line().startswith(f"{said}; ")
    counters = LinkCounters(
        interface="wlan1", rx_bytes=0, tx_bytes=0, rx_packets=0, tx_packets=0, tx_dropped=0, state=InterfaceState.UP
    )
    seen = world.observe
    world.observe = lambda now_s: replace(seen(now_s), counters=counters if now_s == 0.1 else None)
    daemon.tick(0.1)
    assert (daemon.interface, daemon.snapshot.interface) == ("wlan1", "wlan1")
    daemon.tick(0.2)
    assert daemon.status_line().startswith("wlan1 is gone; ")


def test_a_decision_log_that_fails_stops_nothing(monkeypatch, caplog):
    """Ticks go on, and the failure is logged once."""
    daemon = Daemon(World(), Settings(), interface="lo", clock=lambda: 0.0)
    monkeypatch.setattr(daemon.record._decision_log, "follow", lambda _picture: 1 / 0)
    for tick in range(3):
        daemon.tick(tick / 2)
    assert daemon.snapshot is not None
    assert daemon.snapshot.totals.ticks == 3
    (record,) = caplog.records
    assert record.message == "the decision log failed and misses events; not logged again"


def test_between_whole_turns_only_the_price_follows():
    """Twice a second the daemon plans and reports; every other tick reads the link and counts, and nothing else."""
    world = World()
    daemon: Any = Daemon(world, Settings(), interface="lo", clock=lambda: world.now_s)
    turns: list[float] = []
    solve = daemon._program.solve

    def count(*parts, **more):
        turns.append(world.now_s)
        return solve(*parts, **more)

    daemon._program.solve = count
    for _ in range(100):
        daemon.tick(world.now_s)
        world.wait(0.1)
    assert 3 <= len({at_s for at_s in turns if at_s > 8.0}) <= 5
    assert daemon.snapshot.totals.ticks >= 96


def test_a_busy_link_without_news_costs_a_glance():
    """Between two usual ticks nothing is observed, until a report waits or the estimator needs a look."""
    world: Any = World()
    link: Any = KnownLink(1e6, delivery_rate_bytes_per_second=9e5)
    daemon: Any = Daemon(world, Settings(), interface="lo", clock=lambda: world.now_s, estimator=link)
    observed: list[float] = []
    observe = world.observe

    def note(now_s):
        observed.append(now_s)
        return observe(now_s)

    world.observe = note
    world.glance = lambda: Glance(has_reports=world.has_reports, backlog_bytes=0)
    link.needs_look = lambda _now_s, _backlog_bytes: world.is_queued
    world.has_reports = world.is_queued = False
    for at_s in (0.0, 0.03, 0.06, 0.1, 0.13):
        daemon.tick(at_s)
    world.has_reports = True
    daemon.tick(0.14)
    world.has_reports, world.is_queued = False, True
    daemon.tick(0.17)
    assert observed == [0.0, 0.1, 0.14, 0.17]


def test_after_a_stand_by_every_row_is_asked_for_again():
    """Another daemon may have set other terms, which no announcement shows; and its own plans are taken back."""
    world: Any = World()
    daemon: Any = Daemon(world, Settings(), interface="lo", clock=lambda: world.now_s)
    ordering = daemon._ordering
    world.active_daemon = "robot-2"
    daemon.tick(0.0)
    assert daemon._ordering is not ordering
    assert world.stood_by
