"""Who writes the samples of an AdaptivePublisher, and when: the application's thread or the participant's."""

import threading
import time

import pytest
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.model.endpoints import Overflow
from tests.ros.world import retune
from tests.waiting import PATIENCE_S

LONG_S = 10.0  # a write of this length is remembered for 200 s


@pytest.fixture
def make(ros, clock):
    """Make publishers of one node that keep every sample."""
    node = clock.rule(ros.node("talker"))

    def make(topic="/first", depth=100, overflow=Overflow.QUEUE):
        return AdaptivePublisher(node, String, topic, depth, overflow=overflow, clock=clock)

    return make


class Writer:
    """Stands for the writer: keeps samples and their threads, and may take long."""

    def __init__(self, publisher, monkeypatch, *, act=lambda: None):
        self.written, self.threads, self._act = [], [], act
        monkeypatch.setattr(publisher._flow.lane, "write", self.write)

    def write(self, sample):
        self.threads.append(threading.current_thread())
        self.written.append(sample)
        self._act()


def test_who_serves_many_topics_waits_for_no_second_write_that_blocks(make, clock, monkeypatch, eventually):
    """After a write that blocked, the participant's thread writes all that is passed on, until writes are quick."""
    publisher, other = make("/newest", 10, Overflow.LATEST), make()
    blocking = Writer(publisher, monkeypatch, act=lambda: clock.skip(LONG_S))
    unblocked = Writer(other, monkeypatch)
    me = threading.current_thread()
    other.pass_on(b"0")
    publisher.pass_on(b"0")
    assert [*unblocked.threads, *blocking.threads] == [me, me]
    publisher.pass_on(b"1")
    other.pass_on(b"1")
    eventually("both topics go on", lambda: len(blocking.written) == len(unblocked.written) == 2)
    assert me not in (blocking.threads[1], unblocked.threads[1])
    clock.skip(100.0 * LONG_S)
    other.pass_on(b"later")
    assert unblocked.threads[-1] is me


def test_a_large_sample_that_is_passed_on_is_left_to_the_thread(make, monkeypatch, eventually):
    """A picture blocks nobody who passes it on; meanwhile the thread's topic takes another sample without waiting."""
    publisher, may_go_on = make("/camera", 10, Overflow.LATEST), threading.Event()
    writer = Writer(publisher, monkeypatch, act=lambda: may_go_on.wait(PATIENCE_S))
    publisher.pass_on(bytes(100_000))
    eventually("it is being written", lambda: writer.written)
    publisher.pass_on(b"newer")
    publisher.pass_on(b"newest")
    may_go_on.set()
    eventually("what came meanwhile follows", lambda: writer.written[1:] == [b"newer", b"newest"])
    assert threading.current_thread() not in writer.threads[:2]


def test_the_newest_of_each_source_that_is_passed_on_is_written(make, monkeypatch, eventually):
    """A relay passes on what several nodes publish on one topic; where its rate is lower, none crowds another out."""
    publisher = make("/tf_static", 10, Overflow.LATEST)
    retune(publisher, rate_hz=20.0)
    writer = Writer(publisher, monkeypatch)
    for number in range(16):
        publisher.pass_on(b"%02d" % number, source=number % 8)
    eventually("each is heard", lambda: {int(sample) % 8 for sample in writer.written} == {*range(8)})


def test_publish_waits_for_the_write_before_it_as_rclpy_does(make, monkeypatch, background, eventually):
    """A plain publisher loses nothing when several threads publish and its writer blocks."""
    publisher = make("/plain", 1, Overflow.LATEST)
    writer = Writer(publisher, monkeypatch, act=lambda: time.sleep(0.02))
    for thread in b"abc":
        background(lambda _stopping, thread=thread: [publisher.publish(bytes([thread, k])) for k in range(10)])
    eventually("all is written", lambda: len(writer.written) == 30)
    assert all([sample[1] for sample in writer.written if sample[0] == thread] == [*range(10)] for thread in b"abc")
