"""Invented plan numbers neither stop the planning nor keep it busy."""

import pytest

from arpd.govern.governor import Governor
from arpd.model.link import LinkState
from arpd.model.plan import MOST_GENERATION
from arpd.model.settings import Settings
from arpd.solve.program import Program
from arpd.solve.topics import Demand
from tests.sample_publishers import publisher


class Run:
    """A governor over two publishers; one of them announces any generation."""

    def __init__(self):
        self.settings = Settings()
        self.governor = Governor(self.settings)
        self.program = Program.of(self.settings)
        self.now_s = 100.0

    def tick(self, announced):
        self.now_s += 0.1
        publishers = [publisher("/honest", "/a"), publisher("/liar", "/b", generation=announced)]
        topics = Demand().topics(publishers, self.settings)
        allocation = self.program.solve(1e6, topics, 2.0**26)
        return self.governor.decide(
            self.now_s,
            state=LinkState.STEADY,
            rates=allocation,
            lasting=allocation,
            topics=topics,
            publishers=publishers,
        )

    def start(self):
        while self.governor.plan.generation == 0:
            self.tick(0)


@pytest.fixture
def run():
    run = Run()
    run.start()
    return run


@pytest.mark.parametrize("announced", [MOST_GENERATION - 1, MOST_GENERATION, 2**63 - 1, 2**80])
def test_planning_goes_on_at_the_end_of_all_numbers(run, announced):
    """Plans are still made, with numbers that parameters and metrics can hold, whatever an endpoint announces."""
    assert run.tick(announced).reason == "takeover"
    assert run.governor.plan.generation == MOST_GENERATION
    run.governor.reconfigure(run.settings)
    decision = run.tick(announced)
    assert (decision.reason, decision.plan.generation) == ("reload", MOST_GENERATION)


def test_who_invents_a_newer_plan_each_time_is_not_followed_each_time(run):
    """A takeover is made at once, the next one only after the dwell, and the refusal names the dwell."""
    decisions = [run.tick(10 * (k + 1)) for k in range(200)]
    takeovers = sum(decision.reason == "takeover" for decision in decisions)
    assert decisions[0].reason == "takeover"
    assert takeovers <= 1 + 20.0 / run.settings.governor.dwell_s
    assert any("dwell" in decision.refusals for decision in decisions)
