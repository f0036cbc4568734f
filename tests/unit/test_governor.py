"""The governor: the gate answers at once, the level rarely, and neither without a reason."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.governor import Governor
from arpd.model import CapacityKind, LinkEstimate, LinkState, Topic
from arpd.program import Program
from arpd.settings import Backend, GovernorSettings, ProgramSettings, Settings
from tests.sample_publishers import publisher

MEMORY = 64 * 2.0**20
LINK = LinkEstimate(
    capacity_bytes_per_second=1e6,
    kind=CapacityKind.PEER,
    state=LinkState.STEADY,
    queue_delay_s=0.0,
    delivery_rate_bytes_per_second=5e5,
    age_s=0.0,
    evidence="",
)
TOPICS = tuple(
    Topic(name=f"/t{i}", wire_bytes=1000.0 * (i + 1), packets=1, desired_rate_hz=400.0, min_rate_hz=1.0)
    for i in range(3)
)


def announced(topic, generation=0):
    return publisher("/n", topic, source_rate_hz=400.0, rate_hz=400.0, generation=generation)


class Run:
    """A governor, ticked every 100 ms over a capacity."""

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

    def planned(self, capacity=1e6):
        """Bring it to its first plan, and past its dwell."""
        self.ticks(8.0, capacity)
        assert self.governor.plan.generation > 0
        return self


def changes(decisions):
    return [decision.reason for decision in decisions if decision.level_changed]


def test_the_first_plan_waits_for_the_topics_to_settle():
    """One plan for all topics, after they have been the same for the debounce time."""
    run = Run()
    assert not changes(run.ticks(0.9))
    assert changes(run.ticks(0.5)) == ["start"]
    assert set(run.governor.plan.topics) == {"/t0", "/t1", "/t2"}


def test_a_topic_that_comes_costs_one_plan_after_the_debounce():
    """Ten topics that come within a second would cost one plan, not ten."""
    run = Run().planned()
    run.topics = TOPICS[:2]
    assert not changes(run.ticks(0.5))
    run.topics = TOPICS[:1]
    assert changes(run.ticks(3.0)) == ["topics"]


def test_without_topics_nothing_is_planned():
    """No topic, no plan, an open gate."""
    run = Run(topics=())
    decisions = run.ticks(5.0)
    assert not changes(decisions)
    assert decisions[-1].gate == 1.0


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(0.82, 1.18), min_size=5, max_size=60))
def test_inside_the_band_the_level_stays(factors):
    """Capacity that wanders within 0.8 to 1.2 of the level never swaps anything."""
    run = Run().planned()
    for factor in factors:
        assert not changes(run.ticks(0.5, 1e6 * factor))


def test_a_short_dip_is_the_gates_business():
    """A fall shorter than the hold time closes the gate in proportion and leaves the level alone."""
    run = Run().planned()
    decisions = run.ticks(0.5, 5e5)
    assert not changes(decisions)
    assert decisions[0].gate == pytest.approx(0.5, rel=0.02)
    assert run.tick(1e6).gate == pytest.approx(1.0)


def test_a_fall_that_stays_becomes_a_level():
    """After the hold time a fall is planned for, and the gate opens again."""
    run = Run().planned()
    decisions = run.ticks(2.5, 5e5)
    assert changes(decisions) == ["down"]
    assert decisions[-1].gate == pytest.approx(1.0)
    assert run.governor.plan.level_bytes_per_second == pytest.approx(0.85 * 5e5)


def test_a_rise_waits_for_hold_and_dwell():
    """A rise right after a fall waits until the dwell has passed, and says so."""
    run = Run().planned()
    run.ticks(2.5, 5e5)
    decisions = run.ticks(3.0, 1e6)
    assert not changes(decisions)
    assert ("dwell",) in {decision.refusals for decision in decisions}
    assert changes(run.ticks(4.0, 1e6)) == ["up"]


def test_flapping_doubles_the_dwell_up_to_its_maximum():
    """A link that goes up and down every few seconds costs ever fewer plans."""
    run = Run().planned()
    counts = []
    for _ in range(6):
        before = run.governor.plan.generation
        for _ in range(6):
            run.ticks(3.0, 4e5)
            run.ticks(7.0, 1e6)
        counts.append(run.governor.plan.generation - before)
    assert counts[-1] < counts[0]
    assert counts[-1] <= 4


def test_in_an_outage_the_gate_closes_and_the_level_stays():
    """A plan for a link that is gone would be a guess; floors are all that flows."""
    run = Run().planned()
    decisions = run.ticks(10.0, 1e6, state=LinkState.OUTAGE)
    assert not changes(decisions)
    assert all(0 < decision.gate <= 0.05 for decision in decisions)


@settings(deadline=None, max_examples=100)
@given(st.floats(1.0, 1e9), st.floats(0.0, 5.0), st.floats(0.0, 1.0), st.sampled_from(LinkState), st.booleans())
def test_the_gate_is_a_factor(capacity, queue_s, allowance_s, state, is_planned):
    """Whatever is believed of the link, the gate stays within (0, 1] and never lets more than the capacity through."""
    run = Run().planned() if is_planned else Run()
    decision = run.tick(capacity, queue_delay_s=queue_s, queue_allowance_s=allowance_s, state=state)
    assert 0 < decision.gate <= 1
    planned = sum(t.wire_bytes * row.rate_hz for t in TOPICS if (row := decision.plan.topics.get(t.name)))
    assert decision.gate <= 0.01 or decision.gate * planned <= capacity


def test_a_longer_queue_never_opens_the_gate():
    """More delay, less gate."""
    run = Run().planned()
    gates = [run.tick(queue_delay_s=delay / 100).gate for delay in range(40)]
    assert gates == sorted(gates, reverse=True)
    assert gates[0] == pytest.approx(1.0)
    assert gates[-1] == 0.01


def test_a_spent_budget_refuses_and_says_so():
    """More swaps than the budget of a minute are refused, until the minute is over."""
    run = Run(swaps_per_minute=3).planned()
    decisions = run.ticks(10.0, 4e5)
    assert not changes(decisions)
    assert ("budget",) in {decision.refusals for decision in decisions}
    assert run.governor.refusals_by_reason["budget"] > 0
    assert changes(run.ticks(55.0, 4e5)) == ["down"]


def test_a_new_configuration_is_planned_at_once():
    """A reload takes effect at the next tick."""
    run = Run().planned()
    run.governor.reconfigure(run.settings)
    assert changes([run.tick()]) == ["reload"]


def test_a_source_that_wants_more_gets_a_plan():
    """A topic whose demand moves by more than a quarter is planned for at the same capacity."""
    run = Run().planned(1e7)
    run.topics = (replace(TOPICS[0], desired_rate_hz=800.0), *TOPICS[1:])
    assert changes(run.ticks(3.0, 1e7)) == ["demand"]


def test_a_topic_that_grows_gets_a_plan():
    """Messages of twice the size are planned for as more demand is."""
    run = Run().planned()
    run.topics = (*TOPICS[:2], replace(TOPICS[2], wire_bytes=6000.0))
    assert changes(run.ticks(3.0)) == ["demand"]


def test_what_the_capacity_does_is_not_called_demand():
    """What is left for a large topic beside small ones moves by more than the capacity does: no reason for a plan."""
    small = tuple(
        Topic(name=f"/s{i}", wire_bytes=200.0, packets=1, desired_rate_hz=500.0, min_rate_hz=1.0) for i in range(6)
    )
    large = Topic(name="/large", wire_bytes=30_000.0, packets=21, desired_rate_hz=30.0, min_rate_hz=1.0)
    run = Run(topics=(*small, large)).planned()
    assert not changes(run.ticks(10.0, 0.85e6))


def test_foreign_traffic_closes_the_gate_at_once_and_lowers_the_level():
    """What others take is not there, for the gate and for the plan."""
    run = Run().planned()
    decisions = run.ticks(2.5, 1e6, foreign_bytes_per_second=4e5)
    assert decisions[0].gate == pytest.approx(0.6, rel=0.02)
    assert changes(decisions) == ["down"]
    assert run.governor.plan.level_bytes_per_second == pytest.approx(0.85 * 6e5)


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(0.0, 0.18), min_size=5, max_size=60))
def test_foreign_noise_leaves_the_level_alone(shares):
    """Foreign traffic that comes and goes within the hysteresis never swaps anything."""
    run = Run().planned()
    for share in shares:
        assert not changes(run.ticks(0.5, 1e6, foreign_bytes_per_second=share * 1e6))


@pytest.mark.parametrize("known", [{"generation": 41}, {"newest": 41}, {"generation": 41, "newest": 3}])
def test_a_restarted_daemon_never_falls_behind_its_predecessor(known):
    """Generations only grow, also over a restart, for publishers and readers refuse an older plan."""
    run = Run(**known)
    run.ticks(2.0)
    assert run.governor.plan.generation == 42
    assert run.governor.levels_by_cause == {"start": 1}


@pytest.mark.parametrize("where", ["publishers", "readers"])
def test_a_newer_plan_of_another_daemon_is_superseded(where):
    """A plan that is older than what a publisher or reader has would be refused, so a newer one is made, once."""
    run = Run().planned()
    if where == "publishers":
        run.generation = 5
    else:
        run.newest = 5
    assert changes(run.ticks(5.0)) == ["takeover"]
    assert run.governor.plan.generation == 6
    assert run.governor.levels_by_cause["takeover"] == 1


def test_who_stood_by_plans_anew():
    """While another daemon drives there is no plan; afterwards it starts from what that one left."""
    run = Run().planned()
    decision = run.governor.stand_by()
    assert (decision.plan.generation, dict(decision.plan.topics), decision.level_changed) == (0, {}, False)
    run.generation = 9
    assert changes(run.ticks(8.0)) == ["start"]
    assert run.governor.plan.generation == 10
