"""Governor: rates follow the price at once; a plan is for what lasts, and never without a reason."""

import math
from dataclasses import replace
from random import Random
from typing import Any

import pytest

from arpd.govern.governor import Governor
from arpd.model.allocation import Decision, Topic
from arpd.model.link import LinkState
from arpd.model.plan import MOST_GENERATION
from arpd.model.settings import Backend, GovernorSettings, Settings
from arpd.model.wire import swap_bytes
from arpd.solve.program import Program
from tests.sample_publishers import publisher

MEMORY = 64 * 2.0**20
GOVERNOR = GovernorSettings()
SOURCE_HZ = 40.0
LATE_S = 0.25  # two ticks: one begins the wait, one ends it
APPLICATION = (10, 0)  # depth and deadline before the first plan
TOPICS = tuple(
    Topic(
        name=f"/t{i}",
        wire_bytes=10_000.0 * (i + 1),
        packets=1,
        desired_rate_hz=SOURCE_HZ,
        min_rate_hz=1.0,
        latency_budget_s=0.5,
    )
    for i in range(3)
)


class Run:
    """A governor that ticks every 100 ms; the budget that lasts is that of the tick, unless a test says otherwise."""

    def __init__(self, generation=0, topics=TOPICS, participants=1):
        self.settings = Settings()
        self.participants = participants
        self.governor = Governor(self.settings)
        self.program = Program(self.settings, backend=Backend.CLOSED_FORM)
        self.answers = {}
        self.topics = topics
        self.silent = set()
        self.others = ()  # publishers, beside one for each topic
        self.generation = generation
        self.requested_ns = 0
        self.memory = MEMORY
        self.now_s = 100.0

    def announced(self, name):
        return publisher(
            "/n",
            name,
            source_rate_hz=0.0 if name in self.silent else SOURCE_HZ,
            rate_hz=SOURCE_HZ,
            generation=self.generation,
            requested_deadline_ns=self.requested_ns,
        )

    def solved(self, capacity):
        key = (capacity, self.topics, self.memory)
        if key not in self.answers:
            link = self.program.on_link(capacity, self.topics)
            self.answers[key] = self.program.solve(link, self.memory)
        return self.answers[key]

    def tick(self, capacity=1e6, *, lasting=None, state=LinkState.STEADY):
        self.now_s += 0.1
        return self.governor.decide(
            self.now_s,
            state=state,
            rates=self.solved(capacity),
            lasting=self.solved(capacity if lasting is None else lasting),
            topics=self.topics,
            publishers=[*(self.announced(topic.name) for topic in self.topics), *self.others],
            participants=self.participants,
        )

    def ticks(self, seconds, capacity=1e6, **how):
        return [self.tick(capacity, **how) for _ in range(round(seconds * 10))]

    def until_changed(self, capacity):
        """Tick until there is a new plan; return the time that took, and the cause."""
        started_s = self.now_s
        while self.now_s - started_s < 60.0:
            if (decision := self.tick(capacity)).reason:
                return self.now_s - started_s, decision.reason
        return 60.0, ""

    def planned(self, capacity=1e6):
        """Pass the first plan and its dwell."""
        self.ticks(GOVERNOR.dwell_s + 2.0, capacity)
        assert self.governor.plan.generation > 0
        return self


def changes(decisions):
    return [decision.reason for decision in decisions if decision.reason]


def qos(plan):
    return {name: row.qos for name, row in plan.topics.items()}


@pytest.mark.parametrize(("state", "allowed"), [(LinkState.OUTAGE, 0.0), (LinkState.STEADY, 1.0)])
def test_where_nobody_sends_above_its_floor_an_outage_allows_nothing(state, allowed):
    """In an outage the topics may be unknown, and a gauge at 100 % would stand beside a link that carries nothing."""
    run = Run(topics=())
    assert {decision.allowed for decision in run.ticks(1.0, state=state)} == {allowed}


# -- plans for topics


def test_a_topic_that_comes_costs_one_plan_after_the_debounce():
    """Topics that come or go within a second cost one plan together, and one that blinks costs none."""
    run = Run().planned()
    for _ in range(3):
        run.topics = TOPICS[:2]
        assert not changes(run.ticks(0.3))
        run.topics = TOPICS
        assert not changes(run.ticks(3.0))
    run.topics = TOPICS[:2]
    assert not changes(run.ticks(0.5))
    run.topics = TOPICS[:1]
    assert changes(run.ticks(3.0)) == ["topics"]


@pytest.mark.parametrize("change", [{"desired_rate_hz": 52.0}, {"desired_rate_hz": 29.0}, {"wire_bytes": 39_000.0}])
def test_demand_does_not_wait_for_the_dwell(change):
    """A source whose rate or size changes by more than a quarter gets a plan after the hold, however new the last."""
    run = Run()
    run.until_changed(1e6)
    run.topics = (*TOPICS[:2], replace(TOPICS[2], **change))
    assert run.until_changed(1e6) == (pytest.approx(GOVERNOR.hold_s, abs=LATE_S), "demand")
    row, topic = run.governor.plan.topics["/t2"], run.topics[2]
    assert (row.rate_hz, row.wire_bytes) == (1.25 * topic.desired_rate_hz, topic.wire_bytes)


def test_silence_is_no_demand():
    """A source that falls silent and returns keeps its row; one that was silent at its plan gets another."""
    run = Run()
    run.silent = {"/t0"}
    run.planned()
    assert run.governor.plan.topics["/t0"].rate_hz == math.inf
    run.silent = set()
    assert run.until_changed(1e6)[1] == "demand"
    row = run.governor.plan.topics["/t0"]
    run.silent = {"/t0"}
    run.topics = (replace(TOPICS[0], desired_rate_hz=1.0, wire_bytes=1400.0), *TOPICS[1:])
    assert not changes(run.ticks(5.0))
    run.governor.reconfigure(run.settings)
    run.tick()
    run.silent, run.topics = set(), TOPICS
    assert not changes(run.ticks(5.0))
    assert run.governor.plan.topics["/t0"] == row


def test_a_silent_topic_of_two_nodes_keeps_a_depth_that_both_may_have():
    """A node refuses a whole plan with a depth beyond the bounds that its application did not choose."""
    run = Run()
    run.silent = {"/t0"}
    run.others = (replace(run.announced("/t0"), node="/other", depth=9000, baseline_depth=9000),)
    assert run.planned().governor.plan.topics["/t0"].depth == APPLICATION[0]


def test_a_reader_that_asks_for_less_is_served_at_once():
    """A reader whose request is shorter than the offer gets a plan at the next tick, also over the swap budget."""
    run = Run(participants=10_000).planned()
    run.requested_ns = 40_000_000
    assert changes([run.tick()]) == ["readers"]
    assert {row.deadline_ns for row in run.governor.plan.topics.values()} == {run.requested_ns}


# -- topics that keep coming


def test_a_graph_that_grows_makes_few_plans():
    """Topics that come twice a second for a minute cost a plan per dwell at most, and none waits longer than two."""
    run = Run().planned()
    came: list[tuple[float, str]] = []
    planned_s: dict[str, float] = {}
    plans = 0
    for step in range(800):
        if step < 600 and step % 5 == 0:
            run.topics = (*run.topics, replace(TOPICS[0], name=f"/new{step}", wire_bytes=100.0))
            came.append((run.now_s, run.topics[-1].name))
        decision = run.tick()
        plans += decision.reason == "topics"
        for name in decision.plan.topics:
            planned_s.setdefault(name, run.now_s)
    assert 2 <= plans <= 60.0 / GOVERNOR.dwell_s + 4
    assert max(planned_s[name] - came_s for came_s, name in came) <= 2 * GOVERNOR.dwell_s
    assert set(changes(run.ticks(30.0))) <= {"budget"}


# -- plans for the link

RISE_S = 3 * GOVERNOR.dwell_s


@pytest.mark.parametrize(("capacity", "cause", "lasts_s"), [(5e5, "down", GOVERNOR.hold_s), (2e6, "up", RISE_S)])
def test_a_change_must_last(capacity, cause, lasts_s):
    """Shorter changes cause no plan, do not add up, and do not count for the other way; one that lasts causes one."""
    run = Run().planned()
    for _ in range(4):
        assert not changes(run.ticks(RISE_S - 0.3, 2e6))
        assert not changes(run.ticks(GOVERNOR.hold_s - 0.3, 5e5))
        run.ticks(1.0)
    assert run.until_changed(capacity) == (pytest.approx(lasts_s, abs=LATE_S), cause)
    assert run.governor.plan.level_bytes_per_second == pytest.approx(0.85 * capacity)


def test_a_link_that_swings_within_a_minute_swaps_nothing():
    """Shorter deadlines wait until a rise has lasted, so the topics settle at what always fits."""
    run = Run().planned(4e5)
    for _ in range(10):
        assert not changes([*run.ticks(20.0, 2e6), *run.ticks(20.0, 4e5)])


def test_a_daemon_that_starts_in_an_outage_plans_when_the_link_is_there():
    """A first plan for a lost link would spend the budget of swaps on QoS that nothing can use."""
    run = Run()
    assert changes(run.ticks(30.0, state=LinkState.OUTAGE)) == []
    assert run.until_changed(1e6)[1] == "start"


def wandering(seed, **options):
    """Let the link wander for ten minutes; return the run, its decisions, and their times."""
    random, run = Random(seed), Run(**options)
    decisions: list[Decision] = []
    times_s: list[float] = []
    while len(decisions) < 6000:
        capacity = 3e4 * 3e2 ** random.random()
        state = random.choice([LinkState.STEADY] * 4 + [LinkState.OUTAGE])
        for _ in range(round(10 * 0.1 * 1000 ** random.random())):
            decisions.append(run.tick(capacity, state=state))
            times_s.append(run.now_s)
    return run, decisions, times_s


# -- the swap budget


@pytest.mark.parametrize("seed", range(2))
def test_swaps_stay_within_their_part_of_the_link(seed):
    """On any course, swaps take at most 1 % of the lasting budget, besides half a minute of it and one swap."""
    participants = 50
    _, decisions, times_s = wandering(seed, participants=participants)
    cost = participants * swap_bytes(20 + 2 * len(TOPICS))
    rows = dict.fromkeys((topic.name for topic in TOPICS), APPLICATION)
    spent = 0.0
    most_level = max(decision.plan.level_bytes_per_second for decision in decisions)
    for at_s, decision in zip(times_s, decisions, strict=True):
        if now := qos(decision.plan):
            spent += cost * sum(rows[name] != row for name, row in now.items())
            rows = now
        assert spent <= 0.01 * most_level * (30.0 + at_s - times_s[0]) + cost
    assert spent > cost
    assert any(decision.is_postponed for decision in decisions)


def test_over_the_swap_budget_terms_go_out_and_swaps_follow():
    """A plan over the budget sets ceilings and terms at once; the heaviest topics swap first, the rest later."""
    weighted = tuple(replace(topic, weight=1.0 + i) for i, topic in enumerate(TOPICS))
    run = Run(topics=weighted, participants=50)
    decision = next(decision for decision in run.ticks(3.0) if decision.reason)
    assert (decision.reason, decision.is_postponed) == ("start", True)
    for topic in weighted:
        row = decision.plan.topics[topic.name]
        assert (row.rate_hz, row.weight) == (1.25 * SOURCE_HZ, topic.weight)
    assert {name for name, row in qos(decision.plan).items() if row != APPLICATION} == {"/t1", "/t2"}
    assert changes(run.ticks(30.0)) == []
    assert changes(run.ticks(30.0)) == ["budget"]
    assert APPLICATION not in qos(run.governor.plan).values()
    assert changes(run.ticks(120.0)) == []


# -- memory


def test_depths_follow_memory_down_even_in_an_outage():
    """Memory that shrinks costs one plan at once: only depths change, and not those of silent topics."""
    run = Run(participants=1000).planned()  # whose first plan has spent the budget of swaps
    before = run.governor.plan
    run.memory, run.silent = 15_000.0, {"/t0"}
    decision, later = run.tick(state=LinkState.OUTAGE), run.ticks(20.0, state=LinkState.OUTAGE)
    assert decision.reason == "memory"
    assert decision.plan.generation == before.generation + 1
    assert run.governor.plans_by_cause == {"start": 1, "memory": 1}
    depths = {name: row.depth for name, row in decision.plan.topics.items()}
    assert depths["/t0"] == before.topics["/t0"].depth
    assert 0 < depths["/t1"] < before.topics["/t1"].depth
    assert decision.plan.topics == {name: replace(before.topics[name], depth=depth) for name, depth in depths.items()}
    assert changes(later) == []


# -- other daemons


def test_a_restarted_daemon_keeps_what_its_predecessor_left():
    """The first plan keeps announced QoS that is near enough, so it swaps nothing."""
    left = Run().planned().governor.plan
    run: Any = Run()
    run.announced = lambda name: publisher(
        "/n",
        name,
        source_rate_hz=SOURCE_HZ,
        rate_hz=left.topics[name].rate_hz,
        depth=left.topics[name].depth,
        deadline_ns=left.topics[name].deadline_ns,
        generation=left.generation,
    )
    decision = next(decision for decision in run.ticks(2.0, 1.03e6) if decision.reason)
    assert (decision.reason, decision.plan.generation) == ("start", left.generation + 1)
    assert decision.plan.topics == left.topics


@pytest.mark.parametrize("announced", [MOST_GENERATION, 2**80])
def test_planning_goes_on_at_the_end_of_all_numbers(announced):
    """Plans are still made, with numbers that parameters and metrics can hold, whatever an endpoint announces."""
    run = Run().planned()
    run.generation = announced
    assert run.tick().reason == "takeover"
    assert run.governor.plan.generation == MOST_GENERATION
    run.governor.reconfigure(run.settings)
    decision = run.tick()
    assert (decision.reason, decision.plan.generation) == ("reload", MOST_GENERATION)


def test_who_invents_a_newer_plan_each_time_is_not_followed_each_time():
    """A takeover is made at once where the last plan is old enough, the next one only after the dwell."""
    run, decisions = Run().planned(), []
    for number in range(200):
        run.generation = 10 * (number + 1)
        decisions.append(run.tick())
    assert decisions[0].reason == "takeover"
    assert changes(decisions).count("takeover") <= 1 + 20.0 / GOVERNOR.dwell_s
