"""A middleware for the swap's tests: it makes writers that do as they are told, and remembers them all."""

from arpd.endpoint.writer_swap import WriterSwap
from arpd.model.endpoints import WriterQos

FIRST = WriterQos(depth=10, deadline_ns=0)


class Writer:
    def __init__(self, qos, world):
        self.qos = qos
        self.log = world.log
        self.written = []
        self.is_alive = True
        self.acknowledges = True
        self.readers = world.readers
        self.loses_readers = world.loses_readers
        self.has_reliable_readers = world.has_reliable_readers
        self.missed = 0

    def publish(self, sample):
        assert self.is_alive, "wrote to a destroyed writer"
        self.written.append(sample)
        self.log.append(sample)

    def matched(self):
        assert self.is_alive, "looked at a destroyed writer"
        return self.readers

    def is_acknowledged(self):
        assert self.is_alive, "looked at a destroyed writer"
        return self.acknowledges

    def readers_acknowledge(self):
        return self.has_reliable_readers

    def disconnects_readers(self):
        return self.loses_readers

    def deadlines_missed(self):
        return self.missed

    def destroy(self):
        assert self.is_alive, "destroyed twice"
        self.is_alive = False


class World:
    """The middleware: makes writers, and remembers them all."""

    def __init__(self):
        self.readers = 1
        self.has_reliable_readers = True
        self.refuses = self.loses_readers = False
        self.writers = []
        self.results = []
        self.results_of = []  # the QoS that each result is of
        self.now_s = 0.0
        self.log = []  # what was written, by whichever writer

    def create(self, qos):
        if self.refuses:
            raise RuntimeError("no memory")
        self.writers.append(Writer(qos, self))
        return self.writers[-1]

    def note(self, result, qos):
        self.results.append(result)
        self.results_of.append(qos)

    @property
    def live(self):
        return [writer for writer in self.writers if writer.is_alive]


def make(timing=None):
    world = World()
    swap = WriterSwap(create=world.create, on_result=world.note, qos=FIRST, clock=lambda: world.now_s, timing=timing)
    return world, swap


def qos(depth):
    return WriterQos(depth=depth, deadline_ns=1000 * depth)
