"""The reader swap without ROS: any interleaving of writers, readers and executor."""

from collections import deque
from typing import Any

from hypothesis import example, given
from hypothesis import strategies as st

from arpd.apply.endpoint.reader_swap import ReaderSwap, ReaderSwapState
from arpd.model.endpoints import ReaderSwapResult

WRITERS = 2


class Reader:
    """A reliable reader: it receives each writer's samples in order, from its match on."""

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
    """Writers, the readers of one swap, and the samples delivered to the application."""

    def __init__(self):
        self.now_s = 0.0
        self.readers: list[Any] = []
        self.results: list[ReaderSwapResult] = []
        self.delivered: list[Any] = []
        self.written = [0] * WRITERS
        self.swap: Any = ReaderSwap(create=self.create, on_result=self.results.append, qos=0, catch_up_s=100.0)
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
            self.delivered += self.swap.accept(reader, *taken, now_s=self.now_s)

    def step(self, after_s):
        self.now_s += after_s
        # By the settle time the old reader has all samples of a writer from which the new one has none.
        if len(self.live) == 2:
            old, new = self.live
            for writer in range(WRITERS):
                if not any(key[0] == writer for key, _ in new.arrived) and not any(
                    key[0] == writer for key in self.swap._held
                ):
                    while old.under_way[writer]:
                        old.arrive(writer)
        self.delivered += self.swap.step(self.now_s)

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
            self.swap.request(which)
        else:
            self.step(0.06)

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
            self.step(0.04)


def actions(*names):
    return st.lists(st.tuples(st.sampled_from(names), st.integers(0, 3), st.integers(0, WRITERS - 1)), max_size=30)


traffic = actions("write", "match", "arrive", "take", "step")
# One swap without a newer request, then any number that supersede each other.
scripts = st.builds(
    lambda before, during, after: [*before, ("request", 1, 0), ("step", 0, 0), *during, *after],
    actions("write", "arrive", "take"),
    traffic,
    st.one_of(st.just([]), actions("write", "match", "arrive", "take", "step", "request")),
)


def slow_old_reader(*last):
    """Return a script in which the old reader still waits for a sample that is older than those of the new one."""
    begin = [("request", 1, 0), ("step", 0, 0), ("write", 0, 0), ("match", 0, 0), ("match", 0, 1), ("write", 0, 0)]
    return [*begin, *last, ("step", 0, 0), ("step", 0, 0), ("step", 0, 0)]


@given(scripts)
@example(slow_old_reader(("arrive", 1, 0), ("take", 1, 0)))
@example(slow_old_reader(("arrive", 1, 0)))
def test_no_interleaving_loses_doubles_or_reorders(script):
    """Every sample is delivered once, and each writer's in order."""
    world = World()
    for action in script:
        world.do(*action)
    world.finish()
    assert world.swap.state is ReaderSwapState.IDLE
    assert len(world.live) == 1
    assert world.live[0] is world.swap.current
    assert world.live[0].qos == world.swap.qos
    for writer in range(WRITERS):
        got = [number for source, number in world.delivered if source == writer]
        assert got == list(range(1, world.written[writer] + 1))


def begun(world, qos=1):
    world.swap.request(qos)
    world.step(0.0)
    return world.readers[-1]


def test_a_reader_that_does_not_match_is_given_up():
    """When the writers do not match in time, the old reader goes on delivering."""
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
    """A request during a swap destroys the new reader and begins another swap."""
    world = World()
    first = begun(world, 1)
    second = begun(world, 2)
    assert first.is_destroyed
    second.writers |= {0, 1}
    world.step(1.1)
    assert world.swap.qos == 2
    assert world.results == [ReaderSwapResult.SUPERSEDED, ReaderSwapResult.OK]


def test_equal_settings_are_no_swap():
    """A request for the QoS in force, or for the one under way, makes no reader."""
    world = World()
    world.swap.request(0)
    world.step(0.0)
    assert len(world.readers) == 1
    begun(world)
    world.swap.request(1)
    world.step(0.0)
    assert len(world.readers) == 2


def test_going_back_during_a_swap_keeps_the_old_reader():
    """A request for the QoS in force during a swap leaves the old reader alone."""
    world = World()
    begun(world, 1)
    world.swap.request(0)
    world.step(0.0)
    assert world.live == [world.readers[0]]
    assert not world.swap.is_busy


def test_a_reader_the_middleware_refuses_changes_nothing():
    """An exception on creation leaves the old reader delivering, and is a result."""
    world = World()

    def refuse(_qos):
        raise RuntimeError("no resources")

    world.swap._create = refuse
    world.swap.request(1)
    world.step(0.0)
    assert world.results == [ReaderSwapResult.FAILED]
    assert not world.swap.is_busy
    assert world.swap.accept(world.readers[0], (1, 1), "x", now_s=world.now_s) == ["x"]


def test_an_old_reader_that_lost_samples_does_not_hold_up_the_switch_for_ever():
    """The switch comes after a time, and delivers the samples that only the new reader has."""
    world = World()
    new = begun(world)
    new.writers |= {0, 1}
    world.swap.accept(new, (7, 1), "only here", now_s=world.now_s)
    world.step(1.1)
    assert world.swap.state is ReaderSwapState.CATCHING_UP
    world.step(100.1)
    assert world.results == [ReaderSwapResult.INCOMPLETE]
    assert world.delivered == ["only here"]


def test_a_writer_that_does_not_know_the_new_reader_yet_keeps_the_old_one():
    """While only the old reader has a writer's samples, it delivers; the switch follows when both have them."""
    world = World()
    new = begun(world)
    new.writers.add(1)
    new.matched = lambda: WRITERS  # it has found writer 0, which has not heard of it yet
    for is_known in [False] * 10 + [True] * 5:
        if is_known:
            new.writers.add(0)
        else:
            assert world.results == []
        for writer in range(WRITERS):
            world.write(writer)
        for reader in world.live:
            for writer in range(WRITERS):
                reader.arrive(writer)
                world.take(reader)
        world.step(0.1)
    assert world.results == [ReaderSwapResult.OK]
    assert sorted(world.delivered) == [(writer, number + 1) for writer in range(WRITERS) for number in range(15)]


def test_a_new_reader_that_drops_samples_does_not_hold_up_the_switch_for_ever():
    """A shallow new reader may lack samples all the time; the switch comes after 2 s all the same."""
    world = World()
    new = begun(world)
    new.writers |= {0, 1}
    for number in range(22):
        if number == 19:
            assert world.results == []
        world.delivered += world.swap.accept(world.readers[0], (number, number), number, now_s=world.now_s)
        world.step(0.1)
    assert world.results == [ReaderSwapResult.OK]
    assert world.delivered[:20] == list(range(20))


def test_it_stops_tracking_when_no_late_double_can_come():
    """Some time after a swap samples are no longer checked, and the remembered keys are freed."""
    world = World()
    new = begun(world)
    new.writers |= {0, 1}
    world.step(1.1)
    assert world.swap.is_tracking
    world.now_s += 10.1
    assert world.swap.accept(new, (9, 9), "x", now_s=world.now_s) == ["x"]
    assert not world.swap.is_tracking
    assert not world.swap._delivered


def test_a_new_reader_that_runs_far_ahead_is_given_up():
    """Beyond the bound of held samples the new reader is destroyed, and the old one delivers."""
    world = World()
    new = begun(world)
    for number in range(1001):
        world.swap.accept(new, (number, number), number, now_s=world.now_s)
    world.step(0.1)
    assert world.results == [ReaderSwapResult.FAILED]
    assert not world.swap._held
