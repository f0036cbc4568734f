"""Large samples of a process cross the link one at a time, and neither small ones nor rates suffer."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.apply.endpoint.flow import Flow
from arpd.apply.endpoint.link_clock import LinkClock
from arpd.model.endpoints import WriterQos
from arpd.model.plan import TopicPlan
from arpd.model.price import Price
from arpd.model.settings import Overflow
from tests.examples import examples
from tests.unit import swap_world

CAPACITY = 100_000.0  # bytes/s
START_S = 100.0
STEADY_S = START_S + 10.0
STEP_S = 0.002


def price(rate_hz=math.inf, capacity=CAPACITY):
    """Return the price at which a topic of weight 1 with samples of 5,000 bytes gets this rate."""
    return Price(share_per_weight=rate_hz * 5_000.0 / CAPACITY, capacity_bytes_per_second=capacity)


def plan(rate_hz=math.inf, *, packets=11, wire_bytes=5_000.0, weight=1.0):
    return TopicPlan(
        rate_hz=rate_hz,
        min_rate_hz=0.0,
        deadline_ns=0,
        depth=10,
        weight=weight,
        wire_bytes=wire_bytes,
        packets=packets,
    )


LARGE, SMALL = plan(10.0), plan(10.0, packets=10)


@pytest.fixture
def link():
    """Return the clock of a link whose capacity has not changed for ten seconds."""
    link = LinkClock()
    link.set_price(price(), START_S)
    return link


def wait_s(link, row=LARGE, now_s=STEADY_S):
    """Return how long a sample that pacing releases now must wait."""
    return max(0.0, link.turn_s(row, ready_s=now_s, now_s=now_s) - now_s)


def test_a_large_sample_waits_until_all_that_left_has_crossed(link):
    """Small samples count for it, and none of them waits."""
    assert wait_s(link) == 0.0
    link.occupy(LARGE, STEADY_S)
    link.occupy(plan(packets=1, wire_bytes=1_000.0), STEADY_S)
    assert wait_s(link) == pytest.approx(0.06, abs=0.001)
    assert wait_s(link, SMALL) == 0.0
    assert wait_s(link, now_s=STEADY_S + 0.04) == pytest.approx(0.02, abs=0.001)
    assert wait_s(link, now_s=STEADY_S + 0.06) == 0.0


def test_where_no_price_applies_none_waits(link):
    """Without a daemon, and at a rate that somebody set by hand, samples leave at once."""
    link.occupy(LARGE, STEADY_S)
    assert wait_s(link, plan(10.0, weight=0.0)) == 0.0
    unpriced = LinkClock()
    unpriced.occupy(LARGE, STEADY_S)
    assert wait_s(unpriced) == 0.0


@pytest.mark.parametrize(("factor", "waits"), [(0.45, False), (0.6, True), (1.8, True), (2.2, False)])
def test_while_the_capacity_changes_much_none_waits(link, factor, waits):
    """After a step to half or double nobody waits for five seconds; a smaller one changes nothing."""
    link.set_price(price(capacity=factor * CAPACITY), STEADY_S)
    link.occupy(LARGE, STEADY_S)
    assert (wait_s(link) > 0.0) is waits
    link.set_price(price(capacity=factor * CAPACITY), STEADY_S + 4.0)
    link.occupy(LARGE, STEADY_S + 6.0)
    assert wait_s(link, now_s=STEADY_S + 6.0) > 0.0


class Robot(swap_world.World):
    """Flows of one process; every departure is kept with its time."""

    def __init__(self):
        super().__init__()
        self.now_s = STEADY_S
        self.link = LinkClock()
        self.link.set_price(price(), START_S)

    def flow(self, row):
        flow = Flow(
            create=self.create,
            qos=WriterQos(depth=10, deadline_ns=0),
            overflow=Overflow.LATEST,
            clock=lambda: self.now_s,
            link=self.link,
        )
        flow.retune(row, qos=WriterQos(depth=row.depth, deadline_ns=row.deadline_ns))
        return flow

    def play(self, flows, seconds):
        """Let every flow's source publish at its rate; return the departures (flow, time, age)."""
        due_s = dict.fromkeys(flows, self.now_s)
        departures = []
        for _ in range(round(seconds / STEP_S)):
            for flow, source_hz in flows.items():
                before = len(self.log)
                if self.now_s >= due_s[flow]:
                    due_s[flow] += 1.0 / source_hz
                    flow.publish(b"%r" % self.now_s)
                flow.service(self.now_s)
                departures += [(flow, self.now_s, self.now_s - float(sample)) for sample in self.log[before:]]
            self.now_s += STEP_S
        return departures


def test_cameras_that_coincide_leave_one_by_one_and_fresh():
    """Three samples of 50 ms each leave 50 ms apart; a newer sample replaces one that waits."""
    robot = Robot()
    departures = robot.play({robot.flow(plan(5.0)): 20.0 for _ in range(3)}, 4.0)
    times = [at_s for _, at_s, _ in departures if at_s > STEADY_S + 1.0]  # each source begins with a burst of two
    gaps = [after - before for before, after in pairwise(times)]
    assert min(gaps) >= 0.048
    assert max(age_s for _, _, age_s in departures) <= 0.06 + 2 * STEP_S


@examples(25)
@given(st.lists(st.tuples(st.floats(1.0, 15.0), st.floats(2.0, 30.0)), min_size=1, max_size=4))
def test_no_topic_loses_rate_to_its_turn(topics):
    """Each topic keeps its rate where the link carries them all, and most of it where it does not."""
    robot = Robot()
    flows = {robot.flow(plan(rate_hz)): source_hz for rate_hz, source_hz in topics}
    load = sum(5_000.0 / CAPACITY * min(each) for each in topics)
    departures = [flow for flow, _, _ in robot.play(flows, 6.0)]
    for flow, source_hz in flows.items():
        expected = 6.0 * min(flow.plan.rate_hz, source_hz)
        assert departures.count(flow) >= (0.97 if load < 0.9 else 0.6) * expected - 2
