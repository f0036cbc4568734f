"""The uniform policy: Eq. (4) on the capacity, the topics and the memory of the moment."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.govern.plan import Wanted
from arpd.model.allocation import AllocationStatus
from arpd.model.settings import LinkSettings, Policy, ProgramSettings, Settings
from arpd.solve.program import Program
from tests.examples import examples
from tests.unit.solve import test_program
from tests.unit.solve.test_program import AMPLE, solved, topic


def robot(count=12, **fields):
    return [topic(f"/t{i:02}", **{"desired_rate_hz": 2000.0, **fields}) for i in range(count)]


def program(**link):
    policy = ProgramSettings(policy=Policy.UNIFORM)
    return Program(Settings(program=policy, link=LinkSettings(headroom=1.0, **link)))


def rates_under(allocation, topics):
    """Return the rate that each publisher computes from the price and its row of the plan."""
    uniform = Settings(program=ProgramSettings(policy=Policy.UNIFORM))
    rows = Wanted(allocation, topics, (), previous={}, settings=uniform).rows
    return [allocation.price.rate_hz(row) for row in rows.values()]


@pytest.mark.parametrize(
    ("max_rate_hz", "rate_hz", "words"),
    [
        (24.0, 1.0, ""),
        (18.0, 1.0, "rate reserve cut to 50%"),
        (12.0, 1.0, "rate reserve given up"),
        (6.0, 0.5, "rate reserve given up; minimum rate cut to 50%"),
    ],
)
def test_a_link_that_cannot_carry_rmin(max_rate_hz, rate_hz, words):
    """Where (2) cannot be met, the reserve gives way, then Rmin, and the words say how much is left."""
    topics = robot()
    allocation = solved(program(), 1000.0 * max_rate_hz, topics, AMPLE, crossing=12)
    assert allocation.uniform.rate_hz == pytest.approx(rate_hz)
    assert allocation.degradation == words
    assert (allocation.status is AllocationStatus.DEGRADED) == bool(words)
    assert rates_under(allocation, topics) == pytest.approx([rate_hz] * 12)


@st.composite
def robots(draw):
    """Draw topics of any cost with the same preferences."""
    first, *others = draw(test_program.robots())
    names = ("min_rate_hz", "weight", "min_depth", "max_depth", "latency_budget_s")
    alike = {name: getattr(first, name) for name in names}
    return [first, *(replace(t, **alike, desired_rate_hz=max(t.desired_rate_hz, first.min_rate_hz)) for t in others)]


@examples(200)
@given(
    topics=robots(),
    capacity=st.one_of(st.just(0.0), st.floats(1e2, 1e8)),
    share=st.floats(0.0, 1.0),
    memory=st.floats(1e3, 1e9),
    crossing=st.integers(0, 40),
)
def test_link_and_memory_always_carry_it(topics, capacity, share, memory, crossing):
    """All rates fit the divided part of the link, all histories the memory; between two plans the price is the same."""
    solver = program(packet_overhead_s=2e-4)
    allocation = solved(solver, capacity, topics, memory, share=share, crossing=crossing)
    assert allocation.price == solver.on_link(capacity, topics, share=share, crossing=crossing).price()
    assert sum(each.share for each in allocation.topics) <= share * (1 + 1e-9)
    depth = allocation.uniform.depth
    assert depth == 1 or sum(each.slot_bytes for each in topics) * depth <= memory * (1 + 1e-6)
    assert 1 <= depth <= topics[0].max_depth
    assert depth >= topics[0].min_depth or allocation.status is AllocationStatus.DEGRADED
    assert len({each.depth_applied for each in allocation.topics}) == 1
    answers = zip(rates_under(allocation, topics), allocation.topics, topics, strict=True)
    assert all(rate_hz >= answer.rate_hz * (1 - 1e-9) for rate_hz, answer, _ in answers)
