"""The uniform policy: Eq. (4) on the capacity, the topics and the memory of the moment."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.govern.plan import make_plan
from arpd.model.allocation import AllocationStatus, Binding, Topic
from arpd.model.settings import Backend, Policy, ProgramSettings, Settings
from arpd.solve import osqp_
from arpd.solve.eq4 import Eq4Problem, solve_eq4
from arpd.solve.problem import Solved
from arpd.solve.program import Program
from tests.unit.solve.test_eq4 import TABLE_2

AMPLE = 1e12  # bytes of memory that bind nothing


def topic(name="/t", **fields):
    return Topic(
        **{"name": name, "wire_bytes": 1000.0, "packets": 1, "desired_rate_hz": 2000.0, "min_rate_hz": 1.0, **fields}
    )


def robot(count=12, **fields):
    return [topic(f"/t{i:02}", **fields) for i in range(count)]


def program(backend=Backend.EXACT, **fields):
    policy = ProgramSettings(policy=Policy.UNIFORM, backend=backend)
    return Program(**{"settings": policy, "headroom": 1.0, **fields})


def plan_of(allocation, topics):
    uniform = Settings(program=ProgramSettings(policy=Policy.UNIFORM))
    return make_plan(allocation, topics, (), previous={}, generation=1, settings=uniform)


def rates_under(allocation, topics):
    """Return the rate that each publisher computes from the price and its row of the plan."""
    return [allocation.price.rate_hz(row) for row in plan_of(allocation, topics).topics.values()]


@pytest.mark.parametrize("backend", Backend)
@pytest.mark.parametrize("row", TABLE_2, ids=str)
def test_table_2_live(backend, row):
    """A link whose Rmax is that of a row of the paper's Table 2 gives its R and D, whatever the sizes of the topics."""
    max_rate_hz, rate_floor, depth_floor, rate, depth = row
    topics = [topic(f"/t{i:02}", wire_bytes=450.0 + 100.0 * i) for i in range(12)]  # 1000 bytes on average
    solver = program(backend)
    allocation = solver.solve(1000.0 * max_rate_hz, topics, AMPLE, crossing=12)
    assert allocation.uniform.max_rate_hz == pytest.approx(max_rate_hz)
    assert math.floor(allocation.uniform.rate_hz) == rate_floor
    assert allocation.uniform.rate_hz == pytest.approx(float(rate))
    assert allocation.uniform.depth == depth_floor
    assert [answer.depth for answer in allocation.topics] == pytest.approx([float(depth)] * 12)
    assert {answer.deadline_ns for answer in allocation.topics} == {math.ceil(10**9 / rate)}
    assert (allocation.status, allocation.backend) == (AllocationStatus.OPTIMAL, backend)
    assert solver.outcomes == {(backend, "solved"): 1}


def test_the_answer_is_that_of_the_published_program():
    """The applied values are those of `arpd solve --rmax`."""
    allocation = program().solve(1e6 / 3, robot(), AMPLE, crossing=40)
    solution = solve_eq4(Eq4Problem(max_rate_hz=1e3 / 3, topics=40))
    assert {(a.deadline_ns, a.depth_applied) for a in allocation.topics} == {
        (solution.deadline_ns, solution.depth_applied)
    }


def test_the_price_gives_every_publisher_the_same_rate():
    """Publishers of small and large messages, of any weight, compute the same R from their rows of the plan."""
    topics = [topic("/imu", wire_bytes=400.0), topic("/camera", wire_bytes=35_000.0, packets=26, weight=7.0)]
    allocation = program(packet_overhead_s=2e-4).solve(1e6, topics, AMPLE, crossing=2)
    assert allocation.uniform.rate_hz > 10
    assert rates_under(allocation, topics) == pytest.approx([allocation.uniform.rate_hz] * 2)


def test_an_older_plan_gives_the_rate_of_the_newest_price():
    """When messages grow or a topic comes, publishers with the plan of before have the new R at once."""
    small, large = robot(), robot(13, wire_bytes=9000.0)
    before = program().solve(1e6, small, AMPLE, crossing=12)
    after = program().solve(1e6, large, AMPLE, crossing=13)
    rows = plan_of(before, small).topics.values()
    assert [after.price.rate_hz(row) for row in rows] == pytest.approx([after.uniform.rate_hz] * 12)


def test_packets_count_towards_rmax():
    """Rmax is 1 over the mean link time of a message, the overhead of its packets included."""
    topics = [topic("/a", packets=1), topic("/b", packets=4)]
    allocation = program().solve(1e6, topics, AMPLE, packet_overhead_s=1e-3, crossing=2)
    assert allocation.uniform.max_rate_hz == pytest.approx(1 / (2.5e-3 + 1e-3))


def test_headroom_lowers_rmax():
    """The budgeted part of the link is all that Rmax knows."""
    allocation = program().solve(1e6, robot(), AMPLE, share=0.6, crossing=12)
    assert allocation.uniform.max_rate_hz == pytest.approx(600.0)


@pytest.mark.parametrize(("crossing", "count"), [(0, 12), (5, 12), (12, 12), (30, 30)])
def test_every_topic_on_the_link_counts(crossing, count):
    """N is what the graph shows, managed or not, and at least the topics that are planned for."""
    allocation = program().solve(1e6, robot(), AMPLE, crossing=crossing)
    assert allocation.uniform.topics == count
    assert allocation.uniform.rate_hz == pytest.approx(1000.0 / count - 1.0)


def test_a_slower_source_keeps_its_period():
    """A source below R is offered a DEADLINE of its own, and nobody gets what it leaves."""
    topics = [*robot(11), topic("/slow", desired_rate_hz=3.0)]
    allocation = program().solve(1e6, topics, AMPLE, crossing=12)
    *fast, slow = allocation.topics
    assert (slow.rate_hz, slow.deadline_ns, slow.binding) == (3.0, 333_333_334, Binding.DESIRED_RATE)
    assert {(each.rate_hz, each.binding) for each in fast} == {(allocation.uniform.rate_hz, Binding.LINK)}
    assert allocation.uniform.rate_hz == pytest.approx(1000.0 / 12 - 1.0)
    assert slow.depth_applied == fast[0].depth_applied == allocation.uniform.depth


@pytest.mark.parametrize(
    ("max_rate_hz", "rate_hz", "words"),
    [
        (24.0, 1.0, ""),
        (18.0, 1.0, "rate reserve cut to 50%"),
        (12.0, 1.0, "rate reserve given up"),
        (6.0, 0.5, "rate reserve given up; rate floor cut to 50%"),
    ],
)
def test_a_link_that_cannot_carry_rmin(max_rate_hz, rate_hz, words):
    """Where (2) cannot be met, the reserve gives way, then Rmin, and the words say how much is left."""
    topics = robot()
    allocation = program().solve(1000.0 * max_rate_hz, topics, AMPLE, crossing=12)
    assert allocation.uniform.rate_hz == pytest.approx(rate_hz)
    assert allocation.degradation == words
    assert (allocation.status is AllocationStatus.DEGRADED) == bool(words)
    assert rates_under(allocation, topics) == pytest.approx([rate_hz] * 12)


@pytest.mark.parametrize(("capacity", "share"), [(0.0, 1.0), (1e6, 0.0)])
def test_nothing_flows_without_capacity(capacity, share):
    """A link without capacity pauses every topic, and the depth is Dmin."""
    topics = robot(min_depth=3)
    allocation = program().solve(capacity, topics, AMPLE, share=share, crossing=12)
    assert {(each.rate_hz, each.deadline_ns, each.depth_applied) for each in allocation.topics} == {(0.0, 0, 3)}
    assert (allocation.status, allocation.uniform.rate_hz) == (AllocationStatus.DEGRADED, 0.0)
    assert rates_under(allocation, topics) == [0.0] * 12


def test_without_topics_there_is_nothing_to_share():
    """No topic gives an empty answer, as with the other policy."""
    assert program().solve(1e6, (), AMPLE, crossing=12).status is AllocationStatus.EMPTY


def test_the_latency_budget_limits_the_depth():
    """A full history stands for at most the latency budget."""
    allocation = program().solve(1e6, robot(latency_budget_s=0.5), AMPLE, crossing=12)
    assert {(each.depth_applied, each.depth_binding) for each in allocation.topics} == {(41, Binding.LATENCY_BUDGET)}


def test_a_depth_out_of_reach_is_dmin():
    """Where (3) cannot be met, the depth is Dmin; every slow topic meets that, so the answer is not degraded."""
    allocation = program().solve(1e5, robot(min_depth=200), AMPLE, crossing=12)
    assert {(each.depth_applied, each.depth_binding) for each in allocation.topics} == {(200, Binding.FLOOR)}
    assert allocation.status is AllocationStatus.OPTIMAL


@pytest.mark.parametrize(
    ("memory_bytes", "depth", "words"),
    [
        (12 * 50 * 1000.0, 50, ""),
        (12 * 2 * 1000.0, 2, "depth floor cut to 2"),
        (100.0, 1, "memory budget below one sample per topic"),
    ],
)
def test_all_histories_fit_into_the_memory(memory_bytes, depth, words):
    """Memory gives every topic the same, smaller depth; below Dmin the words say so."""
    allocation = program().solve(1e6, robot(min_depth=4), memory_bytes, crossing=12)
    assert {(each.depth_applied, each.depth_binding) for each in allocation.topics} == {(depth, Binding.MEMORY)}
    assert allocation.degradation == words


def test_topics_without_a_floor_have_one_rate_all_the_same():
    """With min_rate_hz 0 the reserve is nothing, and Rmax is divided evenly."""
    allocation = program().solve(1e6, robot(min_rate_hz=0.0), AMPLE, crossing=12)
    assert allocation.uniform.rate_hz == pytest.approx(1000.0 / 12)
    assert not allocation.degradation


@pytest.mark.parametrize("kind", ["wrong", "raises"])
def test_a_back_end_that_fails_is_overruled(monkeypatch, kind):
    """The exact vertex replaces an answer that differs, and an exception; both are counted."""

    def fail(_problem):
        if kind == "raises":
            raise RuntimeError("broken")
        return Solved(values=(5.0, 200.0))

    monkeypatch.setattr(osqp_, "solve_eq4", fail)
    solver = program(Backend.OSQP)
    allocation = solver.solve(1e5, robot(), AMPLE, crossing=12)
    assert (allocation.uniform.depth, allocation.backend) == (365, Backend.EXACT)
    assert solver.outcomes == {(Backend.OSQP, "failed"): 1, (Backend.EXACT, "solved"): 1}


@st.composite
def robots(draw):
    low = draw(st.integers(1, 20))
    fields = {
        "min_rate_hz": draw(st.one_of(st.just(0.0), st.floats(0.01, 50.0))),
        "min_depth": low,
        "max_depth": draw(st.integers(low, 5000)),
        "latency_budget_s": draw(st.one_of(st.none(), st.floats(0.01, 5.0))),
    }
    return [
        topic(
            f"/t{i}",
            wire_bytes=draw(st.floats(60.0, 1e5)),
            packets=draw(st.integers(1, 70)),
            desired_rate_hz=draw(st.one_of(st.just(math.inf), st.floats(0.1, 1000.0))),
            slot_bytes=draw(st.floats(0.0, 1e5)),
            **fields,
        )
        for i in range(draw(st.integers(1, 12)))
    ]


@settings(deadline=None, max_examples=200)
@given(
    topics=robots(),
    capacity=st.floats(1e2, 1e8),
    share=st.floats(0.01, 1.0),
    memory=st.floats(1e3, 1e9),
    crossing=st.integers(0, 40),
)
def test_link_and_memory_always_carry_it(topics, capacity, share, memory, crossing):
    """All rates together fit the divided part of the link, all histories fit the memory, and depths are in bounds."""
    solver = program(packet_overhead_s=2e-4)
    allocation = solver.solve(capacity, topics, memory, share=share, crossing=crossing)
    assert sum(each.share for each in allocation.topics) <= share * (1 + 1e-9)
    depth = Fraction(allocation.uniform.depth)
    assert depth == 1 or sum(Fraction(each.slot_bytes) for each in topics) * depth <= Fraction(memory) * (1 + 10**-9)
    assert 1 <= depth <= topics[0].max_depth
    assert depth >= topics[0].min_depth or allocation.status is AllocationStatus.DEGRADED
    assert len({each.depth_applied for each in allocation.topics}) == 1
    answers = zip(rates_under(allocation, topics), allocation.topics, topics, strict=True)
    assert all(rate_hz >= answer.rate_hz * (1 - 1e-9) for rate_hz, answer, _ in answers)


@settings(deadline=None, max_examples=100)
@given(topics=robots(), capacity=st.floats(1e2, 1e8), factor=st.floats(0.1, 1.0), crossing=st.integers(0, 40))
def test_no_rate_rises_while_the_capacity_falls(topics, capacity, factor, crossing):
    """R never rises with a lower capacity or with one topic more."""
    high, low, crowded = (
        program().solve(c, topics, AMPLE, crossing=n).uniform.rate_hz
        for c, n in ((capacity, crossing), (capacity * factor, crossing), (capacity, max(crossing, len(topics)) + 1))
    )
    assert low <= high * (1 + 1e-9)
    assert crowded <= high * (1 + 1e-9)


def test_per_topic_knows_nothing_of_it():
    """The other policy has no common rate, and its rows keep the terms of their topics."""
    topics = [topic("/a", wire_bytes=500.0, weight=3.0)]
    allocation = Program(settings=ProgramSettings(backend=Backend.EXACT), headroom=1.0).solve(1e6, topics, AMPLE)
    assert allocation.uniform is None
    row = plan_of(allocation, topics).topics["/a"]
    assert (row.weight, row.wire_bytes, row.packets) == (3.0, 500.0, 1)
