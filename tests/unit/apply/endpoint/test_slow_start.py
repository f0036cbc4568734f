"""How a topic begins before a plan covers it."""

import pytest

from arpd.apply.endpoint.flow import SLOW_START_HZ, Flow
from arpd.model.endpoints import DropCause, WriterQos
from arpd.model.settings import Overflow
from arpd.model.wire import FRAGMENT_BYTES

SOURCE_HZ = 50.0


class Writer:
    """Takes everything."""

    def __init__(self):
        self.written = 0

    def publish(self, _sample):
        self.written += 1

    def deadlines_missed(self):
        return 0


class World:
    def __init__(self, *, sample_bytes=FRAGMENT_BYTES + 1, overflow=Overflow.LATEST):
        self.now_s = 100.0
        self.sample = bytes(sample_bytes)
        self.writer = Writer()
        qos = WriterQos(depth=10, deadline_ns=0)
        self.flow = Flow(create=self.create, qos=qos, overflow=overflow, clock=lambda: self.now_s)

    def create(self, _qos):
        return self.writer

    def publish(self, seconds, *, gate):
        """Publish at 50 Hz while a daemon says the gate at 10 Hz (None = there is none); return what was written."""
        before = self.writer.written
        for number in range(round(seconds * SOURCE_HZ)):
            if number % 5 == 0:
                self.flow.set_gate(gate)
            self.flow.publish(self.sample)
            self.now_s += 1.0 / SOURCE_HZ
            self.flow.service(self.now_s)
        return self.writer.written - before


def test_large_samples_wait_for_their_first_plan_while_a_daemon_is_there():
    """Two a second leave, the newest; what gives way counts as the gate's, and the first sample leaves at once."""
    world = World()
    assert world.publish(1.0 / SOURCE_HZ, gate=1.0) == 1
    assert world.publish(2.0, gate=1.0) == pytest.approx(2.0 * SLOW_START_HZ, abs=1)
    assert world.flow.state().withheld_by_cause.keys() == {DropCause.GATE.value}


@pytest.mark.parametrize(
    ("sample_bytes", "overflow", "gate"),
    [
        (FRAGMENT_BYTES, Overflow.LATEST, 1.0),
        (FRAGMENT_BYTES + 1, Overflow.QUEUE, 1.0),
        (FRAGMENT_BYTES + 1, Overflow.LATEST, None),
    ],
    ids=["small", "nothing may be conflated", "no daemon"],
)
def test_what_need_not_wait_does_not(sample_bytes, overflow, gate):
    """Small samples, those that may not be conflated, and all where no daemon is leave as they come."""
    assert World(sample_bytes=sample_bytes, overflow=overflow).publish(2.0, gate=gate) == 100


def test_the_wait_ends_with_the_first_plan_and_never_returns():
    """From the plan on its rate holds, and after it unpaced is unpaced, whoever is there."""
    world = World()
    world.publish(1.0, gate=1.0)
    plan = world.flow.plan
    world.flow.retune(plan, qos=world.flow.qos)
    assert world.publish(2.0, gate=1.0) == pytest.approx(100, abs=1)


def test_who_is_never_planned_waits_for_four_seconds():
    """A topic that stays on its host gets no plan, and is not held for it."""
    world = World()
    world.publish(4.2, gate=1.0)
    assert world.publish(2.0, gate=1.0) == pytest.approx(100, abs=1)


def test_a_daemon_that_leaves_takes_the_wait_with_it():
    """Nobody is waited for who is not there."""
    world = World()
    world.publish(1.0, gate=1.0)
    assert world.publish(2.0, gate=None) == pytest.approx(100, abs=1)
