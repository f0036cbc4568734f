"""The writer swap as a state machine: its invariants hold through any sequence of events."""

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from arpd.endpoint.writer_swap import WriterSwap
from arpd.model.endpoints import SwapResult, SwapState
from tests.examples import examples
from tests.unit.swap_world import FIRST, World, qos


class SwapMachine(RuleBasedStateMachine):
    """A publisher over a middleware that may do anything; the application never stops publishing."""

    def __init__(self):
        super().__init__()
        self.world = World()
        self.events: list[tuple[SwapResult, object]] = []
        self.now_s = 0.0
        self.swap = WriterSwap(create=self.create, on_result=self.note, qos=FIRST, clock=lambda: self.now_s)
        self.samples = 0
        self.asked = [FIRST]
        self.events_at_request = 0  # number of events before the newest request
        self.in_force = 0  # the newest of the requests for what is in force
        self.is_closed = False
        self.began_s: dict[int, float] = {}  # by number of the swap

    def create(self, about):
        writer = self.world.create(about)
        publish = writer.publish

        def on_trial(sample):
            if self.swap.state is SwapState.PROVING:
                assert len(writer.written) < about.depth, "would push a sample out that is not proven to have arrived"
            publish(sample)

        writer.publish = on_trial
        return writer

    def note(self, result, about):
        self.events.append((result, about))
        if result is SwapResult.UNDELIVERED:
            return  # beside the swap's own result
        record = self.swap.last
        assert record is not None
        assert (record.result, record.depth, record.deadline_ns) == (result, about.depth, about.deadline_ns)
        lasted_s = self.now_s - self.began_s.setdefault(record.number, self.now_s)
        assert sum(record.seconds_by_phase.values()) == pytest.approx(lasted_s)
        assert all(seconds >= 0 for seconds in record.seconds_by_phase.values())

    def step(self, *samples):
        events_before = len(self.events)
        for sample in samples:
            self.swap.write(sample)
        self.swap.step(self.now_s)
        self.began_s.setdefault(self.swap.begun, self.now_s)
        for result, about in self.events[events_before:]:
            if result in {SwapResult.OK, SwapResult.REORDER_POSSIBLE}:
                assert about == self.swap.qos
                # The QoS in force may lag behind the newest request, but never goes back to an older one.
                newest = len(self.asked) - 1 - self.asked[::-1].index(about)
                assert newest >= self.in_force, "an older request undid a newer one"
                self.in_force = newest

    @precondition(lambda self: not self.is_closed)
    @rule(depth=st.integers(1, 5))
    def request(self, depth):
        self.asked.append(qos(depth))
        self.events_at_request = len(self.events)
        self.swap.request(qos(depth))

    @precondition(lambda self: not self.is_closed)
    @rule(seconds=st.sampled_from([0.005, 0.05, 0.3, 1.0, 2.0, 11.0]))
    def wait(self, seconds):
        self.now_s += seconds
        self.step()

    @precondition(lambda self: not self.is_closed)
    @rule(samples=st.integers(1, 3))
    def publish(self, samples):
        for _ in range(samples):
            self.step(self.samples)
            self.samples += 1

    @rule(data=st.data(), readers=st.integers(0, 3))
    def some_writer_sees_other_readers(self, data, readers):
        if self.world.live:
            data.draw(st.sampled_from(self.world.live)).readers = readers

    @rule(data=st.data(), acknowledges=st.booleans())
    def some_writer_is_acknowledged_or_not(self, data, acknowledges):
        if self.world.live:
            data.draw(st.sampled_from(self.world.live)).acknowledges = acknowledges

    @rule(readers=st.integers(0, 3), refuses=st.booleans())
    def the_next_writer_will_see(self, readers, refuses):
        self.world.readers, self.world.refuses = readers, refuses

    @rule(loss_ratio=st.sampled_from([None, 0.0, 0.1]))
    def the_link_loses(self, loss_ratio):
        self.swap.loss_ratio = loss_ratio

    @precondition(lambda self: self.world.live[1:])
    @rule()
    def a_reader_refuses_the_newest_writer(self):
        self.world.live[-1].loses_readers = True

    @precondition(lambda self: not self.is_closed)
    @rule()
    def the_middleware_behaves_for_a_while(self):
        """Every request then ends: the newest is in force, or has a result."""
        self.world.readers, self.world.refuses = 1, False
        for _ in range(int(50.0 / 0.1)):
            for writer in self.world.live:
                writer.readers, writer.acknowledges = 1, True
            self.now_s += 0.1
            self.step()
        assert not self.swap.is_busy
        assert self.world.live == [self.swap.current]
        wanted = self.asked[-1]
        assert self.swap.qos == wanted or wanted in [about for _, about in self.events[self.events_at_request :]]

    @precondition(lambda self: not self.is_closed)
    @rule()
    def close(self):
        self.samples -= len(self.swap.rest())  # `Flow` counts these as withheld
        self.swap.close()
        self.is_closed = True

    @rule()
    def step_again(self):
        if self.is_closed:
            self.swap.request(qos(9))
            self.swap.step(self.now_s + 1.0)

    @invariant()
    def the_current_writer_lives_and_none_is_forgotten(self):
        if self.is_closed:
            assert not self.world.live
            return
        assert self.swap.current.is_alive
        assert self.swap.current.qos == self.swap.qos
        known = [self.swap._current, self.swap._next, *(old.writer for old in self.swap._draining)]
        assert sorted(map(id, self.world.live)) == sorted(id(writer) for writer in known if writer is not None)
        assert (self.swap._next is not None) == (self.swap.state is not SwapState.IDLE)

    @invariant()
    def every_swap_that_began_has_one_result_or_is_under_way(self):
        results = sum(result is not SwapResult.UNDELIVERED for result, _ in self.events)
        if not self.is_closed:
            assert self.swap.begun == results + (self.swap.state is not SwapState.IDLE)

    @invariant()
    def every_sample_was_written_once_and_in_order(self):
        assert self.world.log + [sample for sample, _ in self.swap.held] == list(range(self.samples))


TestSwapMachine = SwapMachine.TestCase
TestSwapMachine.settings = examples(150, stateful_step_count=40)
