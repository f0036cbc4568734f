"""Foreign traffic: exact when everything is steady, never invented by what is our own, never more than was carried."""

import math
from dataclasses import dataclass, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.estimate.cross_traffic import CrossTraffic
from arpd.model.endpoints import Direction, PublisherState
from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.observation import MemoryState, Observation
from arpd.model.probing import ProbeRequest
from arpd.model.wire import probe_wire_bytes, wire_size

TICK_S = 0.1
WINDOW_S = 3.0
CHATTER, ALLOWANCE = 40_000.0, 0.05
START_S = 700.0


@dataclass
class Source:
    """One publisher that sends steadily, and announces itself once a second at its own moment."""

    rate_hz: float = 50.0
    payload_bytes: float = 5000.0
    phase_s: float = 0.0
    readers: int = 1
    topic: str = "/t"
    direction: Direction = Direction.SENSING
    since_s: float = START_S - 100.0
    before: int = 0  # samples that count no more: of an earlier life
    heard_from_s: float = 0.0  # what it announced before that, the daemon never heard

    def sent(self, at_s):
        return max(0, math.floor((at_s - self.since_s) * self.rate_hz)) - self.before

    @property
    def bytes_per_second(self):
        is_local = self.direction is Direction.LOCAL
        size, _ = wire_size(self.payload_bytes, rate_hz=self.rate_hz)
        return 0.0 if is_local else self.rate_hz * size * max(1, self.readers)

    def announced(self, now_s):
        age_s = (now_s - self.phase_s) % 1.0
        return PublisherState(
            node="/n",
            topic=self.topic,
            type_name="t",
            direction=self.direction,
            payload_bytes=self.payload_bytes,
            source_rate_hz=self.rate_hz,
            published=self.sent(now_s - age_s),
            depth=10,
            baseline_depth=10,
            remote_readers=self.readers,
            age_s=age_s,
        )


class Robot:
    """Sources and an interface, observed every 100 ms."""

    def __init__(self, *sources):
        self.sources = list(sources)
        self.traffic = CrossTraffic()
        self.now_s = START_S
        self.carried = 5e6
        self.is_readable = True

    @property
    def own(self):
        return sum(source.bytes_per_second for source in self.sources)

    def tick(self, foreign=0.0, *, carried=None, after_s=TICK_S):
        self.now_s += after_s
        self.carried += after_s * (self.own + foreign if carried is None else carried)
        counters = LinkCounters(
            interface="w",
            rx_bytes=int(self.carried * 0.25),
            tx_bytes=int(self.carried * 0.75),
            rx_packets=0,
            tx_packets=0,
            tx_dropped=0,
            state=InterfaceState.UP,
        )
        return self.traffic.update(
            Observation(
                now_s=self.now_s,
                counters=counters if self.is_readable else None,
                reports=(),
                publishers=tuple(
                    state
                    for source in self.sources
                    if self.now_s - (state := source.announced(self.now_s)).age_s >= source.heard_from_s
                ),
                memory=MemoryState(total_bytes=1, available_bytes=1),
                sensing_topics=0,
                actuation_topics=0,
            )
        )

    def run(self, seconds, foreign=0.0, **kwargs):
        return [self.tick(foreign, **kwargs) for _ in range(round(seconds / TICK_S))]

    def expected(self, foreign):
        return max(0.0, foreign - ALLOWANCE * self.own - CHATTER)

    @property
    def grain(self):
        """What counting in whole samples may move the estimate by: two, over what ticks leave of the window."""
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


@settings(deadline=None, max_examples=60)
@given(SOURCES, st.floats(0.0, 5e6))
def test_steady_traffic_is_measured_exactly(sources, foreign):
    """Whenever the nodes announce themselves, what is foreign is found, less the allowances."""
    robot = Robot(*sources)
    settled = robot.run(8.0, foreign)[45:]
    assert settled == pytest.approx([robot.expected(foreign)] * len(settled), abs=robot.grain)


@settings(deadline=None, max_examples=60)
@given(SOURCES, st.floats(0.0, 1.0))
def test_a_daemon_that_starts_beside_running_publishers_invents_nothing(sources, deaf_s):
    """The first announcements it hears tell what was sent before them."""
    robot = Robot(*sources)
    for source in sources:
        source.heard_from_s = START_S + deaf_s
    assert max(robot.run(6.0)) <= robot.grain


EVENTS = st.lists(
    st.fixed_dictionaries(
        {
            "foreign": st.floats(0.0, 1e7),
            "carried": st.none() | st.floats(0.0, 1e7),
            "after_s": st.sampled_from([0.02, 0.1, 0.1, 0.1, 1.5]),
            "what": st.sampled_from(["nothing"] * 20 + ["restart", "new interface", "no interface", "come", "go"]),
        }
    ),
    max_size=120,
)


@settings(deadline=None, max_examples=100)
@given(SOURCES, EVENTS)
def test_whatever_comes_it_is_between_nothing_and_what_was_carried(sources, events):
    """Restarts, a new interface, publishers that come and go, late ticks: never negative, never more than carried."""
    robot = Robot(*sources)
    carried = []
    for number, event in enumerate(events):
        robot.is_readable = event["what"] != "no interface"
        if event["what"] == "restart" and robot.sources:
            source = robot.sources[0]
            source.before += max(0, source.sent(robot.now_s))
        elif event["what"] == "new interface":
            robot.carried = 0.0
        elif event["what"] == "come":
            robot.sources.append(Source(topic=f"/new{number}", since_s=robot.now_s))
        elif event["what"] == "go" and robot.sources:
            robot.sources.pop()
        before = robot.carried
        estimate = robot.tick(event["foreign"], carried=event["carried"], after_s=event["after_s"])
        carried.append((robot.now_s, robot.carried - before))
        recent = sum(size for at_s, size in carried if at_s > robot.now_s - WINDOW_S - 1.0 - event["after_s"] - 1.5)
        assert 0.0 <= estimate <= (recent + 10.0) / WINDOW_S


def test_before_a_window_has_passed_nothing_is_foreign():
    """Three seconds of counters are needed before anything is said."""
    assert max(Robot().run(2.9, 1e6)) == 0.0


def test_a_flow_is_found_and_forgotten_within_its_window():
    """Four seconds after it starts it is known whole, four seconds after it ends it is gone."""
    robot = Robot(Source(phase_s=0.3), Source(topic="/u", phase_s=0.8))
    robot.run(10.0)
    assert robot.run(4.1, 1e6)[-1] == pytest.approx(robot.expected(1e6), abs=robot.grain)
    assert robot.run(4.1)[-1] <= robot.grain


def test_what_stays_on_the_robot_explains_nothing_on_the_link():
    """A topic without a reader on the other host puts nothing on the link, however much it publishes."""
    robot = Robot(Source(direction=Direction.LOCAL))
    assert robot.run(8.0, 1e6)[-1] == pytest.approx(1e6 - CHATTER, abs=10.0)


def test_every_reader_gets_its_copy():
    """A second remote reader doubles what the link carries, and is not foreign."""
    robot = Robot(Source(readers=2))
    assert max(robot.run(8.0)) <= robot.grain


def test_a_reader_the_graph_learns_of_late_is_not_foreign():
    """A copy crosses the link up to a second before the graph tells of its reader: not a moment of it is foreign."""
    robot = Robot(Source(readers=1, phase_s=0.9), Source(topic="/u", direction=Direction.LOCAL, phase_s=0.9))
    robot.run(6.0)
    first, second = robot.sources
    now = (
        robot.own + first.bytes_per_second + wire_size(second.payload_bytes, rate_hz=second.rate_hz)[0] * second.rate_hz
    )
    robot.run(0.8, carried=now)
    first.readers, second.direction = 2, Direction.SENSING
    assert max(robot.run(6.0)) <= robot.grain


def test_a_reader_that_left_had_its_copies():
    """What a reader got before it left stays explained."""
    robot = Robot(Source(readers=2, phase_s=0.4))
    robot.run(6.0)
    robot.sources[0].readers = 1
    assert max(robot.run(6.0)) <= robot.grain


def test_a_publisher_that_comes_is_not_foreign():
    """What it sent before its first announcement was heard is its own, too, as soon as that is heard."""
    robot = Robot(Source(phase_s=0.1))
    robot.run(6.0)
    robot.sources.append(Source(topic="/new", rate_hz=200.0, since_s=robot.now_s, heard_from_s=robot.now_s + 0.7))
    robot.run(1.8)
    assert max(robot.run(5.0)) <= robot.grain


def test_a_restarted_node_is_not_foreign():
    """A counter that starts over at zero is a new life of the same publisher."""
    robot = Robot(Source(phase_s=0.5))
    robot.run(6.0)
    robot.sources[0].before = robot.sources[0].sent(robot.now_s)
    # What the old life sent after its last announcement nobody has counted: half a second of its traffic.
    assert max(robot.run(6.0)) <= robot.own * 0.5 / WINDOW_S - CHATTER + robot.grain
    assert robot.run(1.0)[-1] <= robot.grain


def test_a_node_that_leaves_takes_nothing_back():
    """What a publisher sent before it left stays explained."""
    robot = Robot(Source(phase_s=0.05), Source(topic="/u", phase_s=0.05))
    robot.run(6.1)
    robot.sources.pop()
    assert max(robot.run(5.0)) <= robot.grain
    assert robot.run(1.0)[-1] <= robot.grain


def test_a_late_tick_does_not_matter():
    """Counters that are read late are compared with what was sent in the same time."""
    robot = Robot(Source(phase_s=0.4))
    robot.run(6.0, 1e6)
    after = [robot.tick(1e6, after_s=1.7), *robot.run(4.0, 1e6)]
    assert after == pytest.approx([robot.expected(1e6)] * len(after), abs=robot.grain)


def test_a_new_interface_is_measured_anew():
    """Counters that went back, or cannot be read, say nothing until a window has passed."""
    robot = Robot(Source())
    assert robot.run(6.0, 1e6)[-1] > 0.0
    robot.carried = 0.0
    assert max(robot.run(2.5, 1e6)) == 0.0
    assert robot.run(2.5, 1e6)[-1] == pytest.approx(robot.expected(1e6), abs=robot.grain)
    robot.is_readable = False
    assert robot.tick(1e6) == 0.0
    robot.is_readable = True
    assert max(robot.run(2.5, 1e6)) == 0.0
    assert robot.run(2.5, 1e6)[-1] == pytest.approx(robot.expected(1e6), abs=robot.grain)


def test_resends_after_an_overload_are_not_foreign():
    """What was published and not carried is carried later, out of a queue or as a resend."""
    robot = Robot(Source(rate_hz=100.0))
    robot.run(6.0)
    robot.run(2.0, carried=0.4 * robot.own)
    # All of it comes again, at half as much as the topic itself.
    assert max(robot.run(2.4, 0.5 * robot.own)) <= robot.grain


def test_an_overload_does_not_hide_foreign_traffic_for_long():
    """What was not sent again within ten seconds is gone, and what comes then is foreign."""
    robot = Robot(Source(rate_hz=100.0))
    robot.run(6.0)
    robot.run(3.0, carried=0.0)
    assert robot.run(13.5, 1e5)[-1] == pytest.approx(robot.expected(1e5), abs=robot.grain)


def test_what_was_sent_into_an_outage_may_come_again():
    """A writer resends what nobody received, although the interface had carried it."""
    robot = Robot(Source(rate_hz=100.0))
    robot.run(8.0)
    robot.traffic.note_outage(robot.now_s - 2.0, robot.now_s)
    assert max(robot.run(2.0, robot.own)) <= robot.grain
    assert robot.run(5.0, robot.own)[-1] > 0.5 * robot.own


@pytest.mark.parametrize("peers", [1, 2])
def test_probes_are_ours(peers):
    """A train goes to every peer once, and is not foreign."""
    robot = Robot()
    request = ProbeRequest(packets=30, packet_bytes=1300)
    size = peers * 30 * probe_wire_bytes(1300)
    estimates = []
    for _ in range(40):
        robot.traffic.note_probe(request, robot.now_s, peers=peers)
        estimates.append(robot.tick(carried=size / TICK_S))
    assert max(estimates) <= 10.0
