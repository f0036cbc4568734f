"""The reader swap without ROS: any interleaving of writers, readers and executor."""

from collections import deque
from typing import Any

from hypothesis import example, given
from hypothesis import strategies as st

from arpd.apply.endpoint.reader_swap import ReaderSwap, ReaderSwapState

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
        self.results: list[Any] = []
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
