"""The thread that reads what arrives: its rounds, its floods, and what it says of a sample."""

import os
import select
import threading
import time
from pathlib import Path

import pytest
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from arpd.ros import raw_reader
from arpd.ros.raw_reader import RawReader, ReadingThread


@pytest.fixture
def thread():
    thread = ReadingThread()
    yield thread
    thread.stop()


@pytest.fixture
def connect(ros, thread, eventually):
    """Make a reader, and a publisher that it matches."""
    node = ros.node("raw_reader_check")
    readers = []

    def connect(deliver, topic="/raw_reader_check", by=thread, **more):
        qos = QoSProfile(depth=1000)
        reader = RawReader(node, String, topic, qos, deliver=deliver, thread=by, **more)
        readers.append(reader)
        publisher = ros.node("talker").create_publisher(String, topic, qos)
        eventually("the reader matches", lambda: publisher.get_subscription_count() == 1)
        return reader, publisher

    yield connect
    for reader in readers:
        reader.destroy()


def test_the_watchdogs_time_runs_for_one_sample_alone(connect, thread, eventually):
    """A sample whose function blocks finishes no round; each one after it does, although more of them wait."""
    begun, gates = [], [threading.Event() for _ in range(3)]

    def deliver(sample):
        begun.append(thread.finished_s)
        gates[len(begun) - 1].wait()

    _, publisher = connect(deliver)
    try:
        for _ in gates:
            publisher.publish(String(data="x"))
        for number, gate in enumerate(gates, 1):
            eventually(f"sample {number} is delivered", lambda number=number: len(begun) == number)
            assert thread.finished_s == begun[-1]
            gate.set()
        assert begun[0] < begun[1] < begun[2]
        eventually("the last sample is finished", lambda: thread.finished_s > begun[2])
    finally:
        for gate in gates:
            gate.set()


def test_a_sample_that_nobody_announces_is_taken_within_a_second(connect, eventually):
    """A count that is lost, or one too low, lets no sample wait for the next one."""
    is_busy, gate, taken = threading.Event(), threading.Event(), []

    def hold(_sample):
        is_busy.set()
        gate.wait()

    _, publisher = connect(hold, "/busy")
    reader, unannounced = connect(taken.append, "/unannounced")
    publisher.publish(String(data="x"))
    try:
        eventually("the thread is busy", is_busy.is_set)
        unannounced.publish(String(data="y"))
        assert select.select([reader._event], [], [], 10.0)[0]
        os.eventfd_read(reader._event)
    finally:
        gate.set()
    eventually("the sample is taken", lambda: len(taken) == 1)


def test_an_event_stays_open_while_the_thread_may_still_read_it(connect, eventually):
    """The descriptor of a destroyed reader goes to nobody before the thread has finished its round."""
    is_busy, gate = threading.Event(), threading.Event()

    def deliver(_sample):
        is_busy.set()
        gate.wait()

    _, publisher = connect(deliver, "/busy")
    other, _ = connect(deliver, "/other")
    publisher.publish(String(data="x"))
    try:
        eventually("the thread is busy", is_busy.is_set)
        other.destroy()
        new = os.eventfd(0)
        assert new != other._event
    finally:
        gate.set()
    eventually("it is closed", lambda: not os.path.lexists(f"/proc/self/fd/{other._event}"))
    os.close(new)


def test_a_reader_that_gives_one_sample_again_and_again_is_read_anew(connect, thread, eventually, monkeypatch):
    """When the middleware does not let go of a sample, its reader is replaced, and later samples arrive, each once."""
    taken = []
    reader, publisher = connect(taken.append)
    publisher.publish(String(data="one"))
    eventually("the first sample arrives", lambda: len(taken) == 1)
    before = reader.handle

    real = thread._rcl.take
    monkeypatch.setattr(thread._rcl, "take", lambda *given: 0 if reader.handle is before else real(*given))
    publisher.publish(String(data="two"))
    eventually("the reader is replaced", lambda: reader.handle is not before)
    eventually("the new reader matches alone", lambda: publisher.get_subscription_count() == 1)
    assert len(taken) == 1
    publisher.publish(String(data="three"))
    eventually("the third sample arrives", lambda: taken[-1].data.endswith(b"three\0"))
    assert len({sample.sequence for sample in taken}) == len(taken)


def waiting(reader):
    """Return how many samples were announced to a reader that the thread has not looked at yet."""
    fields = dict(line.split(":") for line in Path(f"/proc/self/fdinfo/{reader._event}").read_text().splitlines())
    return int(fields["eventfd-count"], 16) - raw_reader._ALL


@pytest.fixture
def busy(connect, eventually, monkeypatch):
    """Keep the thread busy, beyond what is late; return what ends that, once so many samples of these readers wait."""
    monkeypatch.setattr(raw_reader, "LATE_S", 0.1)
    is_busy, gate = threading.Event(), threading.Event()

    def deliver(_sample):
        is_busy.set()
        gate.wait()

    connect(deliver, "/busy")[1].publish(String(data="x"))
    eventually("the thread is busy", is_busy.is_set)

    def end(expected):
        for reader, number in expected.items():
            eventually("its samples have come", lambda reader=reader, number=number: waiting(reader) == number)
        time.sleep(0.15)
        gate.set()

    yield end
    gate.set()


@pytest.mark.parametrize(("is_kept", "expected"), [(False, 1), (True, 20)])
def test_of_what_waited_for_a_busy_computer_the_newest_of_each_writer_is_delivered(
    connect, busy, eventually, is_kept, expected
):
    """Where each counts all are; either way a sample of another writer, and one that comes later, is delivered."""
    taken = []
    reader, publisher = connect(taken.append, is_kept=is_kept)
    other = reader._node.create_publisher(String, "/raw_reader_check", QoSProfile(depth=1000))
    eventually("the reader matches", lambda: other.get_subscription_count() == 1)
    other.publish(String(data="other"))
    for number in range(20):
        publisher.publish(String(data=str(number)))
    busy({reader: 21})
    eventually("late samples are delivered", lambda: len(taken) == 1 + expected)
    publisher.publish(String(data="later"))
    eventually("a later one is, too", lambda: len(taken) == 2 + expected)
    assert [sample.data[8:-1] for sample in taken[-2:]] == [b"19", b"later"]


def test_small_samples_wait_for_one_large_one_of_a_topic_and_late_large_ones_for_nobody(
    connect, busy, eventually, caplog
):
    """A reader whose large samples came late has a smaller depth from then on, and the log says why."""
    taken = []
    reader, large = connect(taken.append, "/large", is_kept=False, most_held_bytes=10**9)
    other, small = connect(taken.append, "/small")
    for _ in range(10):
        large.publish(String(data="x" * 200_000))
    small.publish(String(data="small"))
    busy({reader: 10, other: 1})
    eventually("the small sample is taken", lambda: any(len(sample.data) < 100 for sample in taken))
    assert len(taken) <= 2
    eventually("the reader begins again", lambda: reader._qos.depth == 2)
    assert "too busy for /large" in caplog.text
