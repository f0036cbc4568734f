"""Who writes the samples of an AdaptivePublisher, and when: the application's thread or the node's pacing thread."""

import math
import threading
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.model.settings import Overflow
from tests.ros.clock import SkippingClock
from tests.ros.price import FREE, TERMS, costing
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.ros
LONG_S = 10.0  # a write of this length is remembered for 200 s


@pytest.fixture
def clock():
    return SkippingClock()


@pytest.fixture
def make(ros, clock, monkeypatch, eventually):
    """Make publishers of one node that keep every sample; the pacing thread has seen them, and rests."""
    node, seen, service = clock.rule(ros.node("talker")), [], AdaptivePublisher.service

    def noted(publisher, now_s):
        due_s = service(publisher, now_s)
        seen.append(publisher)
        return due_s

    def make(topic="/first", depth=100, overflow=Overflow.QUEUE):
        publisher = AdaptivePublisher(node, String, topic, depth, overflow=overflow, clock=clock)
        eventually("the pacing thread has seen the publisher", lambda: publisher in seen)
        return publisher

    monkeypatch.setattr(AdaptivePublisher, "service", noted)
    return make


@pytest.fixture
def publisher(make):
    """Return a publisher that keeps the newest ten samples."""
    return make("/newest", 10, Overflow.LATEST)


class Writer:
    """Stands for the writer: keeps samples and their threads, says how long each took, and may block."""

    def __init__(self, publisher, monkeypatch, *, took_s=lambda _sample: 0.0):
        self.written, self.threads, self._took_s = [], [], took_s
        self.may_go_on = threading.Event()
        self.may_go_on.set()
        monkeypatch.setattr(publisher._flow, "write", self.write)

    def write(self, sample):
        self.threads.append(threading.current_thread())
        self.written.append(sample)
        assert self.may_go_on.wait(timeout=PATIENCE_S)
        return self._took_s(sample)


def state(publisher):
    return publisher.state(generation=0)


def test_a_writer_that_blocks_does_not_delay_other_topics(publisher, make, clock, monkeypatch, eventually):
    """After two writes that blocked, the pacing thread writes the node's samples, until writes are quick again."""
    monkeypatch.setattr("arpd.adapters.ros.node_publishers._BLOCKED_S", math.inf)
    other = make()
    blocking = Writer(publisher, monkeypatch, took_s=lambda _sample: LONG_S)
    unblocked = Writer(other, monkeypatch)
    me = threading.current_thread()
    publisher.offer(b"0")
    other.offer(b"0")
    assert unblocked.threads == [me]  # one slow write may come from the scheduler
    publisher.offer(b"1")
    assert blocking.threads == [me, me]
    publisher.offer(b"2")
    other.offer(b"1")
    eventually("both topics go on", lambda: len(blocking.written) == 3 and len(unblocked.written) == 2)
    assert me not in (blocking.threads[2], unblocked.threads[1])
    clock.skip(100.0 * LONG_S)

    def is_written_here():
        other.offer(b"later")
        return unblocked.threads[-1] is me

    eventually("the application's thread writes again", is_written_here)


@pytest.mark.parametrize("loosen", ["rate", "price"])
def test_what_waits_leaves_without_further_offers(make, monkeypatch, eventually, loosen):
    """Every queued sample leaves in time, and soon when the rate is raised or the price falls."""
    publisher = make()
    writer = Writer(publisher, monkeypatch)
    samples = [b"%d" % number for number in range(20)]
    publisher.retune(replace(publisher.plan, rate_hz=40.0, **TERMS))
    for sample in samples:
        publisher.offer(sample)
    eventually("all samples leave in order", lambda: writer.written == samples)
    if loosen == "rate":
        publisher.retune(replace(publisher.plan, rate_hz=0.001))
    else:
        publisher.set_price(costing(0.001))
    for sample in samples:
        publisher.offer(sample)
    assert state(publisher).queued > 0
    if loosen == "rate":
        publisher.retune(replace(publisher.plan, rate_hz=math.inf))
    else:
        publisher.set_price(FREE)
    eventually("all samples leave again", lambda: writer.written == 2 * samples)
