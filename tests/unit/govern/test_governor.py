"""Governor: the gate answers at once, the level rarely, and neither without a reason."""

from dataclasses import replace
from itertools import pairwise
from random import Random
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.govern.governor import Governor
from arpd.model.allocation import Topic
from arpd.model.link import LinkState
from arpd.model.settings import Backend, GovernorSettings, ProgramSettings, Settings
from arpd.solve.program import Program
from tests.sample_link import LINK
from tests.sample_publishers import publisher

if TYPE_CHECKING:
    from arpd.model.plan import Decision

MEMORY = 64 * 2.0**20
GOVERNOR = GovernorSettings()
TOPICS = tuple(
    Topic(name=f"/t{i}", wire_bytes=1000.0 * (i + 1), packets=1, desired_rate_hz=400.0, min_rate_hz=1.0)
    for i in range(3)
)


def announced(topic, generation=0):
    return publisher("/n", topic, source_rate_hz=400.0, rate_hz=400.0, generation=generation)


class Run:
    """A governor that ticks every 100 ms on a given capacity."""

    def __init__(self, generation=0, topics=TOPICS, newest=0, **governor):
        self.settings = Settings(governor=GovernorSettings(**governor))
        self.governor = Governor(self.settings)
        self.program = Program(settings=ProgramSettings(backend=Backend.EXACT), headroom=self.settings.link.headroom)
        self.topics = topics
        self.generation = generation
        self.newest = newest
        self.now_s = 100.0

    def tick(self, capacity=1e6, **link):
        self.now_s += 0.1
        estimate = replace(LINK, capacity_bytes_per_second=capacity, **link)
        return self.governor.decide(
            self.now_s,
            link=estimate,
            allocation=self.program.solve(estimate.available_bytes_per_second, self.topics, MEMORY),
            topics=self.topics,
            publishers=[announced(topic.name, self.generation) for topic in self.topics],
            newest=self.newest,
        )

    def ticks(self, seconds, capacity=1e6, **link):
        return [self.tick(capacity, **link) for _ in range(round(seconds * 10))]

    def until_changed(self, capacity, *, limit_s=60.0, **link):
        """Tick until the level changes; return the time that took, and the cause."""
        started_s = self.now_s
        while self.now_s - started_s < limit_s:
            if (decision := self.tick(capacity, **link)).level_changed:
                return self.now_s - started_s, decision.reason
        return limit_s, ""

    def planned(self, capacity=1e6):
        """Pass the first plan and its dwell."""
        self.ticks(8.0, capacity)
        assert self.governor.plan.generation > 0
        return self


def changes(decisions):
    return [decision.reason for decision in decisions if decision.level_changed]


def test_the_first_plan_waits_for_the_topics_to_settle():
    """All topics get one plan once they have been the same for the debounce time."""
    run = Run()
    assert not changes(run.ticks(0.9))
    assert changes(run.ticks(0.5)) == ["start"]
    assert set(run.governor.plan.topics) == {"/t0", "/t1", "/t2"}


def test_a_topic_that_comes_costs_one_plan_after_the_debounce():
    """Topics that come or go within a second cost one plan together."""
    run = Run().planned()
    run.topics = TOPICS[:2]
    assert not changes(run.ticks(0.5))
    run.topics = TOPICS[:1]
    assert changes(run.ticks(3.0)) == ["topics"]


def test_without_topics_nothing_is_planned():
    """Without topics there is no plan, and the gate is open."""
    run = Run(topics=())
    decisions = run.ticks(5.0)
    assert not changes(decisions)
    assert decisions[-1].gate == 1.0


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(0.82, 1.18), min_size=5, max_size=60))
def test_inside_the_band_the_level_stays(factors):
    """Neither a capacity within 0.8 to 1.2 of the level nor as little cross traffic causes a plan."""
    run = Run().planned()
    for factor in factors:
        assert not changes(run.ticks(0.5, 1e6 * factor))
        assert not changes(run.ticks(0.5, 1e6, cross_traffic_bytes_per_second=abs(1.0 - factor) * 1e6))


def test_a_short_fall_closes_only_the_gate():
    """A fall shorter than the hold closes the gate in proportion, and the level stays."""
    run = Run().planned()
    decisions = run.ticks(0.5, 5e5)
    assert not changes(decisions)
    assert decisions[0].gate == pytest.approx(0.5, rel=0.02)
    assert run.tick(1e6).gate == pytest.approx(1.0)


def test_a_fall_that_stays_becomes_a_level():
    """A fall that lasts gets a plan, and the gate opens again."""
    run = Run().planned()
    assert run.until_changed(5e5)[1] == "down"
    assert run.tick(5e5).gate == pytest.approx(1.0)
    assert run.governor.plan.level_bytes_per_second == pytest.approx(0.85 * 5e5)


def test_the_deeper_a_fall_the_sooner_it_is_planned_for():
    """A deep fall waits less, because the gate cuts all topics alike and only a plan knows their weights."""
    held_s = [Run().planned().until_changed(capacity)[0] for capacity in (7.5e5, 5e5, 2e5, 2e4)]
    assert held_s == sorted(held_s, reverse=True)
    assert held_s[0] > 2 * held_s[-1]
    assert held_s[0] < 20.0


def test_floors_that_no_gate_can_cut_are_planned_for_soon():
    """When the floors alone exceed the link, a closed gate does not help, so the wait is short."""
    floored = tuple(replace(topic, min_rate_hz=150.0) for topic in TOPICS)
    held_s = [Run(topics=topics).planned().until_changed(3e5)[0] for topics in (TOPICS, floored)]
    assert held_s[1] < held_s[0]
    assert held_s[1] <= GOVERNOR.hold_s


def test_a_rise_waits_for_the_dwell_and_says_so():
    """A rise right after a fall is refused until the dwell has passed, which counts as one refusal."""
    run = Run().planned()
    run.until_changed(4e5)
    fallen_s = run.now_s
    decisions = run.ticks(GOVERNOR.dwell_s - 0.2, 4e6)
    assert not changes(decisions)
    assert ("dwell",) in {decision.refusals for decision in decisions}
    assert run.until_changed(4e6)[1] == "up"
    assert run.now_s - fallen_s == pytest.approx(GOVERNOR.dwell_s, abs=0.25)
    assert run.governor.refusals_by_reason == {"dwell": 1}


def test_a_rise_must_last():
    """A rise shorter than the hold causes no plan, and earlier rises do not add to it."""
    run = Run().planned()
    for _ in range(4):
        assert not changes(run.ticks(GOVERNOR.hold_s - 0.3, 1e7))
        run.ticks(10.0)
    assert run.until_changed(1e7) == (pytest.approx(GOVERNOR.hold_s, abs=0.25), "up")


def test_a_link_that_swings_is_used_at_its_better_half():
    """Time above the level adds up when it outweighs the time below, and otherwise never."""

    def swings(above_s):
        run = Run().planned(1e5)
        return changes([tick for _ in range(15) for tick in run.ticks(above_s, 1e6) + run.ticks(2.0 - above_s, 1e5)])

    assert swings(above_s=1.2)[:1] == ["up"]
    assert not swings(above_s=0.2)


def flapped(times):
    """Let the link fall right after each rise; return how long each fall and each rise waited."""
    run = Run().planned(4e5)
    falls_s, rises_s = [], []
    for _ in range(times):
        rises_s.append(run.until_changed(1e6)[0])
        falls_s.append(run.until_changed(4e5)[0])
    return falls_s, rises_s


def test_a_fall_soon_after_a_rise_is_held_longer_the_more_often_it_flapped():
    """On a link that swings, each fall waits longer than the one before."""
    alone_s = Run().planned().until_changed(4e5)[0]
    falls_s, _ = flapped(4)
    assert falls_s == pytest.approx(sorted(falls_s), abs=0.15)
    assert alone_s <= falls_s[0] < 0.7 * falls_s[-1]


def test_flapping_doubles_the_dwell_up_to_its_maximum():
    """Each rise waits twice as long as the one before, up to the maximum, while falls follow soon."""
    _, rises_s = flapped(7)
    assert rises_s[1:3] == pytest.approx([2 * GOVERNOR.dwell_s, 4 * GOVERNOR.dwell_s], abs=0.25)
    assert rises_s == pytest.approx(sorted(rises_s), abs=0.15)
    assert rises_s[-1] <= GOVERNOR.dwell_max_s + 0.15


def test_calm_shortens_the_dwell_again():
    """After minutes of calm a rise waits as long as at first."""
    run = Run().planned(4e5)
    for _ in range(5):
        run.until_changed(1e6)
        run.until_changed(4e5)
    run.ticks(600.0, 4e5)
    run.until_changed(1e6)
    run.ticks(60.0, 1e6)
    run.until_changed(4e5)
    assert run.until_changed(4e6)[0] < 2 * GOVERNOR.dwell_s


@pytest.mark.parametrize("capacity", [4e5, 8e4, 1e7])
def test_an_outage_clears_what_was_building_up(capacity):
    """Time above or below the level before an outage does not count after it."""
    held_s, cause = Run().planned().until_changed(capacity)
    run = Run().planned()
    for _ in range(5):
        assert not changes(run.ticks(held_s - 0.3, capacity))
        assert not changes(run.ticks(1.0, capacity, state=LinkState.OUTAGE))
    assert run.until_changed(capacity) == (pytest.approx(held_s, abs=0.15), cause)


def wandering(seed, **governor):
    """Let the link wander for four minutes; return the run, its decisions, and their times."""
    random, run = Random(seed), Run(**governor)
    decisions: list[Decision] = []
    times_s: list[float] = []
    while len(decisions) < 2400:
        capacity = 3e3 * 3e3 ** random.random()
        delay_s, state = random.choice([0.0, 0.0, 0.1]), random.choice([LinkState.STEADY] * 4 + [LinkState.OUTAGE])
        for _ in range(round(10 * 0.1 * 100 ** random.random())):
            decisions.append(run.tick(capacity, queue_delay_s=delay_s, state=state))
            times_s.append(run.now_s)
    return run, decisions, times_s


@pytest.mark.parametrize("seed", range(4))
def test_nothing_flaps_faster_than_its_dwell(seed):
    """On any course of the link, a rise comes no sooner than the dwell after any other plan."""
    _, decisions, times_s = wandering(seed)
    taken = zip(times_s, decisions, strict=True)
    planned = [(at_s, decision.reason) for at_s, decision in taken if decision.level_changed]
    assert len(planned) > 10
    for (before_s, _), (at_s, cause) in pairwise(planned):
        assert cause != "up" or at_s - before_s >= GOVERNOR.dwell_s - 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_no_minute_costs_more_swaps_than_its_budget(seed):
    """On any course of the link, swaps stay within the budget, and refusals are counted."""
    run, decisions, times_s = wandering(seed, swaps_per_minute=6)
    rows: dict[str, tuple[int, int]] = {}
    swaps: list[float] = []
    for at_s, decision in zip(times_s, decisions, strict=True):
        now = {name: (row.depth, row.deadline_ns) for name, row in decision.plan.topics.items()}
        swaps += [at_s] * sum(rows.get(name) != row for name, row in now.items())
        rows = now
    assert max(sum(at_s <= other_s <= at_s + 59.9 for other_s in swaps) for at_s in swaps) <= 6
    refused = [decision.refusals for decision in decisions]
    started = sum("budget" in now and "budget" not in before for before, now in pairwise(refused))
    assert run.governor.refusals_by_reason["budget"] == started > 0


@pytest.mark.parametrize("seed", range(4))
def test_on_a_steady_link_plans_end(seed):
    """After any course, one minute on a steady link ends all changes."""
    run, _, _ = wandering(seed)
    for capacity in (2e5, 1e6):
        run.ticks(60.0, capacity)
        assert not changes(run.ticks(60.0, capacity))
        assert 0.8 * 0.85 <= run.governor.plan.level_bytes_per_second / capacity <= 0.85 / 0.8


def test_in_an_outage_the_gate_closes_and_the_level_stays():
    """In an outage only floors flow, and no plan is made."""
    run = Run().planned()
    decisions = run.ticks(10.0, 1e6, state=LinkState.OUTAGE)
    assert not changes(decisions)
    assert all(0 < decision.gate <= 0.05 for decision in decisions)


@settings(deadline=None, max_examples=100)
@given(st.floats(1.0, 1e9), st.floats(0.0, 5.0), st.floats(0.0, 1.0), st.sampled_from(LinkState), st.booleans())
def test_the_gate_is_a_factor(capacity, queue_s, allowance_s, state, is_planned):
    """At any estimate the gate is in (0, 1] and lets no more than the capacity through."""
    run = Run().planned() if is_planned else Run()
    decision = run.tick(capacity, queue_delay_s=queue_s, queue_allowance_s=allowance_s, state=state)
    assert 0 < decision.gate <= 1
    planned = sum(t.wire_bytes * row.rate_hz for t in TOPICS if (row := decision.plan.topics.get(t.name)))
    assert decision.gate <= 0.01 or decision.gate * planned <= capacity


def test_the_gate_answers_a_queue_at_once():
    """The gate closes in the tick that shows the queue, and opens when the queue is gone."""
    run = Run().planned()
    assert [run.tick(queue_delay_s=delay_s).gate < 0.5 for delay_s in (0.0, 0.15, 0.0)] == [False, True, False]


def test_a_longer_queue_never_opens_the_gate():
    """The gate never rises with the delay, and starts to close above the allowance."""
    run = Run().planned()
    assert run.tick(queue_delay_s=0.15, queue_allowance_s=0.15).gate == pytest.approx(1.0)
    gates = [run.tick(queue_delay_s=delay / 100).gate for delay in range(40)]
    assert gates == sorted(gates, reverse=True)
    assert gates[0] == pytest.approx(1.0)
    assert gates[-1] == 0.01


def test_a_spent_budget_refuses_and_says_so():
    """Swaps above the budget are refused until the minute is over."""
    run = Run(swaps_per_minute=3).planned()
    decisions = run.ticks(10.0, 4e5)
    assert not changes(decisions)
    assert ("budget",) in {decision.refusals for decision in decisions}
    assert run.governor.refusals_by_reason["budget"] > 0
    assert changes(run.ticks(55.0, 4e5)) == ["down"]


def test_a_new_configuration_is_planned_at_once():
    """A reload causes a plan at the next tick."""
    run = Run().planned()
    run.governor.reconfigure(run.settings)
    assert changes([run.tick()]) == ["reload"]


@pytest.mark.parametrize(
    ("capacity", "place", "change"), [(1e7, 0, {"desired_rate_hz": 800.0}), (1e6, 2, {"wire_bytes": 6000.0})]
)
def test_a_source_that_wants_more_gets_a_plan(capacity, place, change):
    """A rate or a message size that changes by more than a quarter causes a plan."""
    run = Run().planned(capacity)
    run.topics = (*TOPICS[:place], replace(TOPICS[place], **change), *TOPICS[place + 1 :])
    assert changes(run.ticks(3.0, capacity)) == ["demand"]


def test_a_change_of_the_capacity_is_no_demand():
    """The rest for a large topic beside small ones moves by more than the capacity, which causes no plan."""
    small = tuple(
        Topic(name=f"/s{i}", wire_bytes=200.0, packets=1, desired_rate_hz=500.0, min_rate_hz=1.0) for i in range(6)
    )
    large = Topic(name="/large", wire_bytes=30_000.0, packets=21, desired_rate_hz=30.0, min_rate_hz=1.0)
    run = Run(topics=(*small, large)).planned()
    assert not changes(run.ticks(10.0, 0.85e6))


def test_cross_traffic_closes_the_gate_at_once_and_lowers_the_level():
    """Cross traffic reduces what gate and plan may use."""
    run = Run().planned()
    assert run.tick(cross_traffic_bytes_per_second=4e5).gate == pytest.approx(0.6, rel=0.02)
    assert run.until_changed(1e6, cross_traffic_bytes_per_second=4e5)[1] == "down"
    assert run.governor.plan.level_bytes_per_second == pytest.approx(0.85 * 6e5)


@pytest.mark.parametrize("known", [{"generation": 41}, {"newest": 41}, {"generation": 41, "newest": 3}])
def test_a_restarted_daemon_never_falls_behind_its_predecessor(known):
    """Generations only grow, even over a restart, because endpoints refuse an older plan."""
    run = Run(**known)
    run.ticks(2.0)
    assert run.governor.plan.generation == 42
    assert run.governor.levels_by_cause == {"start": 1}


def test_a_restarted_daemon_keeps_what_its_predecessor_left():
    """The first plan keeps announced rows that are near enough, so it swaps nothing."""
    left = Run().planned().governor.plan
    run = Run()
    estimate = replace(LINK, capacity_bytes_per_second=1.03e6)
    publishers = [
        replace(announced(topic, left.generation), rate_hz=row.rate_hz, depth=row.depth, deadline_ns=row.deadline_ns)
        for topic, row in left.topics.items()
    ]
    decisions = [
        run.governor.decide(
            run.now_s + after_s,
            link=estimate,
            allocation=run.program.solve(estimate.available_bytes_per_second, TOPICS, MEMORY),
            topics=TOPICS,
            publishers=publishers,
        )
        for after_s in (0.0, 1.1)
    ]
    assert (decisions[-1].reason, decisions[-1].plan.generation) == ("start", left.generation + 1)
    assert decisions[-1].plan.topics == left.topics


@pytest.mark.parametrize("where", ["publishers", "readers"])
def test_a_newer_plan_of_another_daemon_is_superseded(where):
    """Endpoints with a newer plan would refuse an older one, so one newer plan is made."""
    run = Run().planned()
    if where == "publishers":
        run.generation = 5
    else:
        run.newest = 5
    assert changes(run.ticks(5.0)) == ["takeover"]
    assert run.governor.plan.generation == 6
    assert run.governor.levels_by_cause["takeover"] == 1


def test_after_standing_by_it_starts_again():
    """While another daemon is active there is no plan; afterwards the first plan follows that daemon's generation."""
    run = Run().planned()
    decision = run.governor.stand_by()
    assert (decision.plan.generation, dict(decision.plan.topics), decision.level_changed) == (0, {}, False)
    run.generation = 9
    assert changes(run.ticks(8.0)) == ["start"]
    assert run.governor.plan.generation == 10
