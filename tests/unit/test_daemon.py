"""The daemon over a world that does what it is told, some of it late."""

from dataclasses import replace

from arpd.daemon import Daemon
from arpd.model import MemoryState, Observation
from arpd.settings import Settings
from tests.sample_publishers import publisher, reader

TOPIC = "/t"
MS = 1_000_000


class World:
    """One publisher and one reader that carry a predecessor's plan; each announces what it was told a second later."""

    def __init__(self, *, deaf=()):
        self.now_s = 0.0
        self.told = []
        self.superior = ""
        self.gates = []
        self.probes = []
        self._deaf = deaf
        self._pending = []
        self.writer = publisher("/w", TOPIC, deadline_ns=80 * MS, baseline_deadline_ns=90 * MS, depth=20, generation=7)
        self.reader = reader("/r", TOPIC, deadline_ns=120 * MS, baseline_deadline_ns=100 * MS, depth=20, generation=9)

    def observe(self, now_s):
        for at_s, change in tuple(self._pending):
            if at_s <= now_s:
                change()
                self._pending.remove((at_s, change))
        return Observation(
            now_s=now_s,
            counters=None,
            reports=(),
            publishers=(self.writer,),
            readers=(self.reader,),
            memory=MemoryState(total_bytes=2**30, available_bytes=2**29),
            sensing_topics=1,
            actuation_topics=0,
            other_daemons=(self.superior,) if self.superior else (),
            superior=self.superior,
        )

    def apply(self, transitions, *, now_s):
        for step in transitions:
            if step.node in self._deaf or (step.node, step.topics, step.readers) in self.told:
                continue
            self.told.append((step.node, step.topics, step.readers))
            self._pending.append((now_s + 1.0, lambda step=step: self._announce(step)))

    def _announce(self, step):
        for row in step.topics.values():
            self.writer = replace(
                self.writer,
                generation=step.generation,
                rate_hz=row.rate_hz,
                depth=row.depth,
                deadline_ns=row.deadline_ns,
            )
        for row in step.readers.values():
            self.reader = replace(self.reader, generation=step.generation, depth=row.depth, deadline_ns=row.deadline_ns)

    def set_gate(self, gate):
        self.gates.append(gate)

    def probe(self, request):
        self.probes.append(request)

    def reconfigure(self, graph):
        pass

    def results(self):
        return {}

    def probes_sent(self):
        return 0, 0

    def wait(self, seconds):
        self.now_s += seconds


def restored(world):
    daemon = Daemon(world, Settings(), interface="lo", clock=lambda: world.now_s)
    return daemon.restore(wait=world.wait)


def test_a_clean_stop_restores_writers_and_readers_in_order():
    """The reader relaxes only when the writer allows it, the writer only when the reader does, and all is as before."""
    world = World()
    assert restored(world) == 0
    assert (world.writer.depth, world.writer.deadline_ns) == (10, 90 * MS)
    assert (world.reader.depth, world.reader.deadline_ns) == (10, 100 * MS)
    assert world.writer.generation >= 9, "a reader refuses a plan that is older than its own"


def test_a_clean_stop_waits_for_the_reader_that_goes_first():
    """A writer whose own deadline is longer than what the reader still requests keeps it until the reader is back."""
    world = World()
    world.reader = replace(world.reader, deadline_ns=85 * MS)
    assert restored(world) == 0
    assert [node for node, *_ in world.told] == ["/r", "/w"]
    assert world.writer.deadline_ns == 90 * MS


def test_a_clean_stop_gives_up_on_a_reader_that_is_gone():
    """A reader that does not answer is counted, and its writer is left what that reader requests."""
    world = World(deaf={"/r"})
    world.reader = replace(world.reader, deadline_ns=85 * MS)
    assert restored(world) == 1
    assert (world.writer.depth, world.writer.deadline_ns) == (10, 85 * MS)


def test_a_daemon_that_stands_by_only_watches(caplog):
    """While another one drives it sets nothing, probes nothing and restores nothing, and says why; then it drives."""
    world = World()
    daemon = Daemon(world, Settings(), interface="lo", clock=lambda: world.now_s)
    world.superior = "robot-2"
    for _ in range(100):
        world.now_s += 0.1
        daemon.tick(world.now_s)
    assert (world.told, world.gates, world.probes) == ([], [], [])
    assert daemon.restore(wait=world.wait) == 0
    assert not world.told
    assert daemon.status_line() == "standing by: another arpd daemon, on robot-2, drives this robot"
    assert [record.message for record in caplog.records if "another arpd daemon" in record.message] == [
        "another arpd daemon, on robot-2, has run for longer: standing by"
    ]
    world.superior = ""
    world.now_s += 0.1
    daemon.tick(world.now_s)
    assert world.gates
    assert world.probes
