"""The quick price against the program's, over all that a configuration and a link can ask for."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.allocation import Topic
from arpd.model.plan import TopicPlan
from arpd.model.settings import Backend, Settings
from arpd.solve.level import WaterLevel
from arpd.solve.program import Program

PROGRAM = Program.of(replace(Settings(), program=replace(Settings().program, backend=Backend.EXACT)))


def topics_of(rng):
    """Draw topics with ties in weight, floors at ceilings, unknown rates and wishes that no link carries."""
    return tuple(
        Topic(
            name=f"/t{k}",
            wire_bytes=round(10 ** rng.uniform(1.5, 5.5)),
            packets=rng.randint(1, 30),
            desired_rate_hz=rng.choice([0.0, 1.0, 30.0, round(10 ** rng.uniform(-1, 3), 3), float("inf")]),
            min_rate_hz=rng.choice([0.0, 0.5, 1.0, round(10 ** rng.uniform(-1, 2), 3)]),
            weight=rng.choice([1.0, 1.0, 2.0, 5.0, 0.1]),
            min_depth=1,
            max_depth=100,
            latency_budget_s=0.5,
            slot_bytes=1000.0,
        )
        for k in range(rng.choice([1, 2, 5, 12, 40]))
    )


def rates(price, topics):
    """Return the rates that publishers compute from a price."""
    return [
        price.rate_hz(
            TopicPlan(
                rate_hz=topic.desired_rate_hz or topic.min_rate_hz,
                min_rate_hz=min(topic.min_rate_hz, topic.desired_rate_hz or topic.min_rate_hz),
                deadline_ns=0,
                depth=1,
                weight=topic.weight,
                wire_bytes=topic.wire_bytes,
                packets=topic.packets,
            )
        )
        for topic in topics
    ]


@given(st.integers(0, 2**32), st.floats(3.0, 8.0), st.sampled_from([0.0, 1e-5, 4e-4]), st.floats(0.01, 1.0))
def test_the_quick_price_gives_the_rates_of_the_program(seed, magnitude, overhead_s, share):
    """Every publisher computes the same rate from either price, also where floors give way."""
    topics, capacity, share = topics_of(random.Random(seed)), float(round(10**magnitude)), round(share, 6)
    exact = PROGRAM.solve(capacity, topics, 1e9, packet_overhead_s=overhead_s, share=share).price
    quick = WaterLevel(topics).price(capacity, packet_overhead_s=overhead_s, share=share)
    assert rates(quick, topics) == pytest.approx(rates(exact, topics), rel=1e-6, abs=1e-9)


def test_on_a_link_that_carries_nothing_everybody_pauses():
    """Without a capacity both prices give nobody a rate."""
    topics = topics_of(random.Random(1))
    quick = WaterLevel(topics).price(0.0, packet_overhead_s=0.0, share=0.9)
    assert (
        rates(quick, topics) == rates(PROGRAM.solve(0.0, topics, 1e9, share=0.9).price, topics) == [0.0] * len(topics)
    )
