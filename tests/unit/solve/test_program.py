"""Program per topic: (G1), (G2), degradation and rounding."""

import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.allocation import AllocationStatus, Binding, Topic
from arpd.model.plan import rate_of
from arpd.model.settings import Backend, LinkSettings, ProgramSettings, Settings
from arpd.solve import osqp_
from arpd.solve.eq4 import Eq4Problem
from arpd.solve.program import Program
from tests.examples import examples

AMPLE = 1e12  # bytes of memory that bind nothing


def topic(name="/t", **fields):
    return Topic(
        **{"name": name, "wire_bytes": 1000.0, "packets": 1, "desired_rate_hz": 50.0, "min_rate_hz": 1.0, **fields}
    )


def program(backend=Backend.CLOSED_FORM, *, headroom=0.85, packet_overhead_s=None, **fields):
    link = LinkSettings(headroom=headroom, packet_overhead_s=packet_overhead_s)
    return Program(Settings(program=ProgramSettings(backend=backend), link=link), **fields)


def solved(program, capacity, topics, memory, **link):
    return program.solve(program.on_link(capacity, topics, **link), memory)


@st.composite
def robots(draw, max_topics=10):
    count = draw(st.integers(1, max_topics))
    return [
        topic(
            f"/t{i}",
            wire_bytes=draw(st.floats(60.0, 100_000.0)),
            packets=draw(st.integers(1, 70)),
            desired_rate_hz=(desired_hz := draw(st.one_of(st.integers(1, 100), st.floats(0.1, 1e6)))),
            min_rate_hz=min(desired_hz, draw(st.one_of(st.just(0.0), st.floats(0.1, 20.0)))),
            weight=draw(st.sampled_from([0.5, 1.0, 2.0, 5.0])),
            min_depth=draw(st.integers(1, 10)),
            max_depth=draw(st.integers(10, 5000)),
            latency_budget_s=draw(st.one_of(st.none(), st.floats(0.01, 2.0))),
            slot_bytes=draw(st.floats(1.0, 1e6)),
        )
        for i in range(count)
    ]


CAPACITIES = st.floats(1e3, 1e8)
MEMORIES = st.floats(0.0, 1e9)


def cost(row, capacity, overhead=0.0):
    return row.packets * overhead + row.wire_bytes / capacity


@pytest.mark.parametrize("backend", Backend)
@pytest.mark.parametrize(("max_rate_hz", "count", "min_rate_hz"), [(100, 12, 1.0), (1000, 12, 1.0), (333.3, 7, 2.5)])
def test_identical_topics_are_eq4(backend, max_rate_hz, count, min_rate_hz):
    """With η = 1 − N·Rmin/Rmax, identical topics get the paper's R*, and sources that publish at R* its D*."""
    problem = Eq4Problem(max_rate_hz=max_rate_hz, topics=count, min_rate_hz=min_rate_hz)
    rate_hz, depth = problem.vertex()
    share = 1.0 - count * min_rate_hz / max_rate_hz
    for desired_hz in (max_rate_hz, rate_hz):
        topics = [topic(f"/t{i}", desired_rate_hz=desired_hz, min_rate_hz=min_rate_hz) for i in range(count)]
        for row in solved(program(backend), 1000.0 * max_rate_hz, topics, AMPLE, share=share).topics:
            assert row.rate_hz == pytest.approx(rate_hz, rel=1e-6)
            assert row.deadline_ns == pytest.approx(problem.applied(rate_hz)[0], rel=1e-6)
            assert row.depth == pytest.approx(4999.0 if desired_hz == max_rate_hz else depth, rel=1e-6)


@examples(80)
@given(topics=robots(), capacity=CAPACITIES, memory=MEMORIES, overhead=st.sampled_from([0.0, 1e-4]))
def test_applied_values_are_feasible(topics, capacity, memory, overhead):
    """Periods keep the headroom, depths keep memory, caps and bounds, all to a millionth."""
    allocation = solved(program(packet_overhead_s=overhead), capacity, topics, memory)
    assert [row.name for row in allocation.topics] == [row.name for row in topics]
    answers = [*zip(topics, allocation.topics, strict=True)]
    busy = sum(cost(row, capacity, overhead) * rate_of(answer.deadline_ns) for row, answer in answers)
    assert busy <= 0.85 * (1 + 1e-6)
    held = sum(row.slot_bytes * answer.depth_applied for row, answer in answers)
    gives_depth = "memory" in allocation.degradation or "depth" in allocation.degradation
    assert held <= memory * (1 + 2e-6) or gives_depth
    for row, answer in answers:
        assert 1 <= answer.depth_applied <= row.max_depth
        assert answer.depth_applied >= row.min_depth or gives_depth
        window_s = min(row.max_depth * cost(row, capacity, overhead), row.latency_budget_s or math.inf)
        cap = window_s * row.desired_rate_hz - row.min_depth
        assert answer.depth_applied <= max(cap * (1 + 2e-6), row.min_depth)


@pytest.mark.parametrize(
    ("fields", "memory", "depth", "binding"),
    [
        ({}, AMPLE, 24, Binding.LINK),  # 5000 · 10/2000 − 1
        ({"latency_budget_s": 1.0}, AMPLE, 9, Binding.LATENCY_BUDGET),  # 1.0 · 10 − 1
        ({"latency_budget_s": 0.05}, AMPLE, 1, Binding.MINIMUM),  # 0.05 · 10 − 1 is below Dmin
        ({"min_depth": 40}, AMPLE, 40, Binding.MINIMUM),
        ({"slot_bytes": 100.0}, 1250.0, 12, Binding.MEMORY),
        ({"desired_rate_hz": 3000.0, "max_depth": 100}, AMPLE, 100, Binding.MAX_DEPTH),
    ],
)
def test_what_binds_the_depth(fields, memory, depth, binding):
    """Link share, latency budget, floor or memory stop the depth, and the binding says which."""
    allocation = solved(program(), 2e6, [topic(**{"desired_rate_hz": 10.0, **fields})], memory)
    (row,) = allocation.topics
    assert (row.depth_applied, row.depth_binding) == (depth, binding)
    assert allocation.status is AllocationStatus.OPTIMAL


@pytest.mark.parametrize("backend", Backend)
def test_weight_divides_link_and_memory(backend):
    """A topic of weight 3 gets three times the link time, or the memory, of one with 1; neither is overspent."""
    topics = [topic("/a", slot_bytes=1000.0), topic("/b", slot_bytes=1000.0, weight=3.0)]
    light, heavy = solved(program(backend), 20_000.0, topics, AMPLE).topics
    assert heavy.share == pytest.approx(3 * light.share, rel=2e-6)
    assert (light.binding, heavy.binding) == (Binding.LINK, Binding.LINK)
    short = solved(program(backend), 2e5, topics, 40_000.0)
    assert [row.depth_applied for row in short.topics] == [10, 30]
    assert short.binding is Binding.MEMORY


@pytest.mark.parametrize("backend", Backend)
def test_large_topics_have_a_part_of_a_link_that_small_ones_would_fill(backend):
    """They divide 15 % by weight, get no more than they want, and take nothing of a minimum rate that was asked for."""
    camera, clouds = {"wire_bytes": 50_000.0, "packets": 40}, {"wire_bytes": 400_000.0, "packets": 280, "weight": 2.0}
    small = [topic(f"/t{number:02}") for number in range(40)]
    large = [topic("/a", **camera, min_rate_hz=0.0), topic("/b", **clouds, min_rate_hz=0.0)]
    answer = solved(program(backend), 1e6, [*large, *small], AMPLE).topics
    assert [row.share for row in answer[:2]] == pytest.approx([0.85 * 0.05, 0.85 * 0.1], rel=1e-6)
    assert [row.binding for row in answer[:2]] == [Binding.LINK, Binding.LINK]
    assert math.fsum(row.share for row in answer) == pytest.approx(0.85, rel=1e-6)
    modest = replace(large[1], desired_rate_hz=0.1)
    answer = solved(program(backend), 1e6, [large[0], modest, *small], AMPLE).topics
    assert [row.share for row in answer[:2]] == pytest.approx([0.85 * 0.15 - 0.04, 0.04], rel=1e-6)
    asking = [replace(each, min_rate_hz=20.0) for each in small]
    answer = solved(program(backend), 1e6, [*large, *asking], AMPLE)
    assert math.fsum(row.share for row in answer.topics[:2]) == pytest.approx(0.05, rel=1e-6)
    assert not answer.degradation


def test_the_heaviest_is_cut_last(monkeypatch):
    """As the link fails, floors are cut class by class in ascending weight, and named; no solver is asked."""
    monkeypatch.setattr(osqp_, "level", lambda *_: pytest.fail("asked"))
    topics = [topic(f"/w{w}", weight=w, min_rate_hz=10.0) for w in (1.0, 2.0, 5.0)]
    solver = program(Backend.OSQP)
    for capacity in (34_000.0, 30_000.0, 23_000.0, 18_000.0, 11_000.0, 5_000.0, 100.0):
        allocation = solved(solver, capacity, topics, AMPLE)
        rates = [row.rate_hz for row in allocation.topics]
        assert (allocation.status, allocation.binding) == (AllocationStatus.DEGRADED, Binding.LINK)
        for light, heavy in itertools.pairwise(rates):
            assert light == 0.0 or heavy == 10.0
        assert [not row.deadline_ns for row in allocation.topics] == [not rate_hz for rate_hz in rates]
        assert math.fsum(rates) == pytest.approx(0.85 * capacity / 1000.0)
        given_up = [f"minimum rate of weight {weight} given up" for weight in (1, 2, 5)][: rates.count(0.0)]
        assert allocation.degradation.split("; ")[:-1] == given_up


def test_memory_below_the_depth_floors_degrades():
    """Depth floors that memory cannot hold shrink by ascending weight, down to one sample and no further."""
    topics = [topic("/a", min_depth=10), topic("/b", min_depth=10, weight=2.0)]
    allocation = solved(program(), 1e6, topics, 12_000.0)
    assert [row.depth_applied for row in allocation.topics] == [2, 10]
    assert allocation.status is AllocationStatus.DEGRADED
    nothing = solved(program(), 1e6, topics, 0.0)
    assert [row.depth_applied for row in nothing.topics] == [1, 1]
    assert "below one sample" in nothing.degradation


@pytest.mark.parametrize("backend", Backend)
def test_no_capacity_pauses_everything(backend):
    """A link without capacity pauses every topic; its history is that of a very slow link."""
    rows = [topic("/a", latency_budget_s=1.0), topic("/b", min_depth=3, max_depth=3, min_rate_hz=0.0)]
    allocation = solved(program(backend), 0.0, rows, AMPLE)
    assert [(row.rate_hz, row.deadline_ns, row.depth_applied) for row in allocation.topics] == [(0, 0, 49), (0, 0, 3)]
    assert (allocation.status, allocation.binding) == (AllocationStatus.DEGRADED, Binding.LINK)


def test_the_answer_of_a_solver_is_used(monkeypatch):
    """Rate, DEADLINE and price are those of the back end's ν, to its last digit."""
    monkeypatch.setattr(osqp_, "level", lambda *_: 0.85 * (1 - 5e-7))
    allocation = solved(program(Backend.OSQP), 10_000.0, [topic()], AMPLE)
    (row,) = allocation.topics
    assert row.rate_hz == pytest.approx(8.5 * (1 - 5e-7), rel=1e-12)
    assert row.deadline_ns == math.ceil(1e9 / row.rate_hz)
    assert (allocation.price.share_per_weight, allocation.backend) == (0.85 * (1 - 5e-7), Backend.OSQP)
