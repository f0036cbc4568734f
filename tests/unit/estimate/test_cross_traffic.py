"""Cross traffic: never our own traffic, never more than was carried; the simulation has what others send."""

import math
from dataclasses import dataclass, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate.cross_traffic import CrossTraffic
from arpd.model.endpoints import Direction
from arpd.model.relay import RelaySummary
from arpd.model.wire import wire_size
from tests.examples import examples
from tests.sample_link import INTERFACE, observation
from tests.sample_publishers import publisher
from tests.unit.estimate.test_estimator import FIRST, Link

TICK_S = 0.1
WINDOW_S = 3.0
CHATTER, ALLOWANCE = 40_000.0, 0.05
START_S = 700.0


@dataclass
class Source:
    """One publisher that sends steadily, and announces itself once a second at its own time."""

    rate_hz: float = 50.0
    payload_bytes: float = 5000.0
    phase_s: float = 0.0
    readers: int = 1
    topic: str = "/t"
    direction: Direction = Direction.SENSING
    since_s: float = START_S - 100.0
    before: int = 0  # samples of an earlier life, which do not count

    def sent(self, at_s):
        return max(0, math.floor((at_s - self.since_s) * self.rate_hz)) - self.before

    @property
    def bytes_per_second(self):
        is_local = self.direction is Direction.LOCAL
        size, _ = wire_size(self.payload_bytes, rate_hz=self.rate_hz)
        return 0.0 if is_local else self.rate_hz * size * max(1, self.readers)

    def announced(self, now_s):
        age_s = (now_s - self.phase_s) % 1.0
        return publisher(
            "/n",
            self.topic,
            direction=self.direction,
            payload_bytes=self.payload_bytes,
            source_rate_hz=self.rate_hz,
            published=self.sent(now_s - age_s),
            remote_readers=self.readers,
            announced_at_s=now_s - age_s,
        )


class Robot:
    """Sources and an interface, observed every 100 ms."""

    def __init__(self, *sources):
        self.sources = list(sources)
        self.traffic = CrossTraffic()
        self.now_s = START_S
        self.carried = 5e6
        self.is_readable = True
        self.heard_from_s = 0.0  # it misses earlier announcements

    @property
    def own(self):
        return sum(source.bytes_per_second for source in self.sources)

    def tick(self, cross_traffic=0.0, *, carried=None, after_s=TICK_S):
        self.now_s += after_s
        self.carried += after_s * (self.own + cross_traffic if carried is None else carried)
        counters = replace(INTERFACE, rx_bytes=int(self.carried * 0.25), tx_bytes=int(self.carried * 0.75))
        told = (source.announced(self.now_s) for source in self.sources)
        seen = {
            "counters": counters if self.is_readable else None,
            "publishers": tuple(each for each in told if each.announced_at_s >= self.heard_from_s),
        }
        return self.traffic.update(observation(self.now_s, **seen))

    def run(self, seconds, **kwargs):
        return [self.tick(**kwargs) for _ in range(round(seconds / TICK_S))]

    @property
    def grain(self):
        """Error of counting in whole samples: two of each source, over the part of the window that ticks cover."""
        return sum(2.5 * source.bytes_per_second / source.rate_hz / WINDOW_S for source in self.sources) + 10.0


SOURCES = st.lists(
    st.builds(
        Source,
        rate_hz=st.floats(1.0, 200.0),
        payload_bytes=st.floats(10.0, 50_000.0),
        phase_s=st.floats(0.0, 1.0),
        readers=st.integers(0, 3),
        direction=st.sampled_from(Direction),
    ),
    max_size=5,
).map(lambda sources: [replace(source, topic=f"/t{i}") for i, source in enumerate(sources)])


@examples(60)
@given(SOURCES, st.floats(0.0, 1.0))
def test_a_daemon_that_starts_beside_running_publishers_invents_nothing(sources, deaf_s):
    """The first announcements explain what was sent before them."""
    robot = Robot(*sources)
    robot.heard_from_s = START_S + deaf_s
    assert max(robot.run(6.0)) <= robot.grain


EVENTS = st.lists(
    st.fixed_dictionaries(
        {
            "cross_traffic": st.floats(0.0, 1e7),
            "carried": st.none() | st.floats(0.0, 1e7),
            "after_s": st.sampled_from([0.02, 0.1, 0.1, 0.1, 1.5]),
            "what": st.sampled_from(["nothing"] * 20 + ["restart", "no interface", "come", "go"]),
        }
    ),
    max_size=120,
)


@examples(100)
@given(SOURCES, EVENTS)
def test_it_is_between_nothing_and_what_was_carried(sources, events):
    """Restarts, no interface, publishers that come and go, late ticks: never negative, never more than carried."""
    robot = Robot(*sources)
    carried = []
    for number, event in enumerate(events):
        robot.is_readable = event["what"] != "no interface"
        if event["what"] == "restart" and robot.sources:
            source = robot.sources[0]
            source.before += max(0, source.sent(robot.now_s))
        elif event["what"] == "come":
            robot.sources.append(Source(topic=f"/new{number}", since_s=robot.now_s))
        elif event["what"] == "go" and robot.sources:
            robot.sources.pop()
        before = robot.carried
        estimate = robot.tick(event["cross_traffic"], carried=event["carried"], after_s=event["after_s"])
        carried.append((robot.now_s, robot.carried - before))
        recent = sum(size for at_s, size in carried if at_s > robot.now_s - WINDOW_S - 1.0 - event["after_s"] - 1.5)
        assert 0.0 <= estimate <= (recent + 10.0) / WINDOW_S


def test_a_reader_that_the_graph_shows_late_is_no_cross_traffic():
    """Copies cross the link up to a second before the graph shows their reader, and still count as our own."""
    robot = Robot(Source(readers=1, phase_s=0.9), Source(topic="/u", direction=Direction.LOCAL, phase_s=0.9))
    robot.run(6.0)
    first, second = robot.sources
    size, _ = wire_size(second.payload_bytes, rate_hz=second.rate_hz)
    robot.run(0.8, carried=robot.own + first.bytes_per_second + size * second.rate_hz)
    first.readers, second.direction = 2, Direction.SENSING
    assert max(robot.run(6.0)) <= robot.grain


@pytest.mark.parametrize("cross_traffic", [0.0, 1e6])
def test_what_a_relay_sends_is_its_own(cross_traffic):
    """Of a relay's two ends the bytes they count are no cross traffic, before a map has crossed whole, and in calls."""
    traffic, measured, own = CrossTraffic(), [], 600e3
    summary = RelaySummary()
    for tick in range(100):
        now_s = START_S + tick * TICK_S
        if tick % 10 == 3:  # it tells once a second
            summary = RelaySummary(link_bytes=int(own * (tick * TICK_S)))
        counters = replace(INTERFACE, tx_bytes=int((own + cross_traffic) * tick * TICK_S))
        measured.append(traffic.update(observation(now_s, counters=counters, relay=summary)))
    expected = max(0.0, cross_traffic - ALLOWANCE * own - CHATTER)
    assert measured[60:] == pytest.approx([expected] * 40, abs=0.03 * own)


def test_what_is_dropped_before_the_link_is_not_on_it():
    """Behind an access point that drops most of what leaves this host, cross traffic is the whole link at most."""
    estimate = Link().measured().ticks(60, sent=8 * FIRST)
    assert 0.0 < estimate.cross_traffic_bytes_per_second <= estimate.capacity_bytes_per_second
