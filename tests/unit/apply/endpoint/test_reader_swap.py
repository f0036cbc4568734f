"""The handover of a subscription's reader, without ROS: every interleaving of writers, readers and executor."""

from collections import deque
from typing import Any

from hypothesis import example, given
from hypothesis import strategies as st

from arpd.apply.endpoint.reader_swap import ReaderSwap, ReaderSwapState, ReaderSwapTiming
from arpd.model.endpoints import ReaderSwapResult

WRITERS = 2
TIMING = ReaderSwapTiming(settle_s=1.0, match_timeout_s=5.0, catch_up_s=100.0, remember_s=10.0)


class Reader:
    """A reliable reader: in order per writer, each writer's samples from the moment it is matched."""

    def __init__(self, world, qos):
        self.world, self.qos = world, qos
        self.writers = set()
        self.under_way: dict[int, deque[Any]] = {writer: deque() for writer in range(WRITERS)}
        self.arrived: deque[Any] = deque()
        self.is_destroyed = False

    def matched(self):
        return len(self.writers)

    def take(self):
        return self.arrived.popleft() if self.arrived else None

    def destroy(self):
        self.is_destroyed = True

    def arrive(self, writer):
        if self.under_way[writer]:
            self.arrived.append(self.under_way[writer].popleft())


class World:
    """Writers, the readers of one handover, and what the application was given."""

    def __init__(self):
        self.now_s = 0.0
        self.readers: list[Any] = []
        self.results: list[ReaderSwapResult] = []
        self.delivered: list[Any] = []
        self.written = [0] * WRITERS
        self.handover: Any = ReaderSwap(create=self.create, on_result=self.results.append, qos=0, timing=TIMING)
        for writer in range(WRITERS):
            self.readers[0].writers.add(writer)

    def create(self, qos):
        self.readers.append(Reader(self, qos))
        return self.readers[-1]

    @property
    def live(self):
        return [reader for reader in self.readers if not reader.is_destroyed]

    def write(self, writer):
        self.written[writer] += 1
        sample = (writer, self.written[writer])
        for reader in self.live:
            if writer in reader.writers:
                reader.under_way[writer].append((sample, sample))

    def take(self, reader):
        if (taken := reader.take()) is not None:
            self.delivered += self.handover.accept(reader, *taken, now_s=self.now_s)

    def step(self, after_s):
        self.now_s += after_s
        # What the settle time is for: of a writer the new reader has nothing from, the old one misses nothing.
        if len(self.live) == 2:
            old, new = self.live
            for writer in range(WRITERS):
                if not any(key[0] == writer for key, _ in new.arrived) and not any(
                    key[0] == writer for key in self.handover._held
                ):
                    while old.under_way[writer]:
                        old.arrive(writer)
        self.delivered += self.handover.step(self.now_s)

    def do(self, action, which, writer):
        reader = self.live[which % len(self.live)]
        if action == "write":
            self.write(writer)
        elif action == "match":
            self.live[-1].writers.add(writer)
        elif action == "arrive":
            reader.arrive(writer)
        elif action == "take":
            self.take(reader)
        elif action == "request":
            self.handover.request(which)
        else:
            self.step(0.6)

    def finish(self):
        for _ in range(60):
            for reader in self.live:
                reader.writers |= set(range(WRITERS))
                for writer in range(WRITERS):
                    while reader.under_way[writer]:
                        reader.arrive(writer)
            for reader in self.live:
                while reader.arrived:
                    self.take(reader)
            self.step(0.4)


def actions(*names):
    return st.lists(st.tuples(st.sampled_from(names), st.integers(0, 3), st.integers(0, WRITERS - 1)), max_size=30)


traffic = actions("write", "match", "arrive", "take", "step")
# One handover that nobody interrupts, then any number that supersede each other.
scripts = st.builds(
    lambda before, during, after: [*before, ("request", 1, 0), ("step", 0, 0), *during, *after],
    actions("write", "arrive", "take"),
    traffic,
    st.one_of(st.just([]), actions("write", "match", "arrive", "take", "step", "request")),
)


def slow_old_reader(*last):
    """Return a script in which the old reader still waits for a sample older than what the new one has."""
    begin = [("request", 1, 0), ("step", 0, 0), ("write", 0, 0), ("match", 0, 0), ("match", 0, 1), ("write", 0, 0)]
    return [*begin, *last, ("step", 0, 0), ("step", 0, 0), ("step", 0, 0)]


@given(scripts)
@example(slow_old_reader(("arrive", 1, 0), ("take", 1, 0)))
@example(slow_old_reader(("arrive", 1, 0)))
def test_no_interleaving_loses_doubles_or_reorders(script):
    """Whatever arrives where and when, every sample is delivered once, each writer's in order."""
    world = World()
    for action in script:
        world.do(*action)
    world.finish()
    assert world.handover.state is ReaderSwapState.IDLE
    assert len(world.live) == 1
    assert world.live[0] is world.handover.current
    assert world.live[0].qos == world.handover.qos
    for writer in range(WRITERS):
        got = [number for source, number in world.delivered if source == writer]
        assert got == list(range(1, world.written[writer] + 1))


def begun(world, qos=1):
    world.handover.request(qos)
    world.step(0.0)
    return world.readers[-1]


def test_a_reader_that_does_not_match_is_given_up():
    """When the writers do not match in time, the old reader stays and goes on delivering."""
    world = World()
    new = begun(world)
    world.step(5.1)
    assert world.results == [ReaderSwapResult.UNMATCHED]
    assert new.is_destroyed
    world.write(0)
    world.readers[0].arrive(0)
    world.take(world.readers[0])
    assert world.delivered == [(0, 1)]


def test_the_newest_request_supersedes():
    """A request during a handover destroys the reader under way and begins anew."""
    world = World()
    first = begun(world, 1)
    second = begun(world, 2)
    assert first.is_destroyed
    second.writers |= {0, 1}
    world.step(1.1)
    assert world.handover.qos == 2
    assert world.results == [ReaderSwapResult.SUPERSEDED, ReaderSwapResult.OK]


def test_equal_settings_are_no_handover():
    """A request for what is in force, or for what is under way, makes no reader."""
    world = World()
    world.handover.request(0)
    world.step(0.0)
    assert len(world.readers) == 1
    begun(world)
    world.handover.request(1)
    world.step(0.0)
    assert len(world.readers) == 2


def test_going_back_during_a_handover_keeps_the_old_reader():
    """Asking for what is in force while another reader is under way ends with the old one alone."""
    world = World()
    begun(world, 1)
    world.handover.request(0)
    world.step(0.0)
    assert world.live == [world.readers[0]]
    assert not world.handover.is_busy


def test_a_reader_the_middleware_refuses_changes_nothing():
    """An exception on creation leaves the old reader delivering and is told as a result."""
    world = World()

    def refuse(_qos):
        raise RuntimeError("no resources")

    world.handover._create = refuse
    world.handover.request(1)
    world.step(0.0)
    assert world.results == [ReaderSwapResult.FAILED]
    assert not world.handover.is_busy
    assert world.handover.accept(world.readers[0], (1, 1), "x", now_s=world.now_s) == ["x"]


def test_an_old_reader_that_lost_samples_does_not_hold_up_the_switch_for_ever():
    """With a best-effort reader that lost what the new one has, the switch comes after a time, and brings it."""
    world = World()
    new = begun(world)
    new.writers |= {0, 1}
    world.handover.accept(new, (7, 1), "only here", now_s=world.now_s)
    world.step(1.1)
    assert world.handover.state is ReaderSwapState.CATCHING_UP
    world.step(100.1)
    assert world.results == [ReaderSwapResult.INCOMPLETE]
    assert world.delivered == ["only here"]


def test_it_stops_tracking_when_no_late_double_can_come():
    """Some time after a handover samples pass unlooked at again, and what was remembered is freed."""
    world = World()
    new = begun(world)
    new.writers |= {0, 1}
    world.step(1.1)
    assert world.handover.is_tracking
    world.now_s += 10.1
    assert world.handover.accept(new, (9, 9), "x", now_s=world.now_s) == ["x"]
    assert not world.handover.is_tracking
    assert not world.handover._delivered


def test_a_new_reader_that_runs_far_ahead_is_given_up():
    """What is held is bounded: beyond it the new reader goes, and the old one delivers."""
    world = World()
    new = begun(world)
    for number in range(1001):
        world.handover.accept(new, (number, number), number, now_s=world.now_s)
    world.step(0.1)
    assert world.results == [ReaderSwapResult.FAILED]
    assert not world.handover._held
