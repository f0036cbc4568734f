"""The thread that writes, and the locks around it."""

import math
import threading
import time
from contextlib import suppress
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.endpoint import writing_thread
from arpd.endpoint.lane import SMALL_BYTES, Lane
from arpd.endpoint.queue import PacedQueue
from arpd.endpoint.writing_thread import WritingThread
from arpd.model.endpoints import WithheldCause
from arpd.model.price import Price
from arpd.ros.rcl import InvalidHandle
from tests.waiting import eventually

LONG_S = 5.0
LARGE = bytes(SMALL_BYTES)  # behind a first byte


def make(warn=print, **options):
    return WritingThread(PacedQueue(), name="writing", warn=warn, **options)


def test_a_turn_that_finds_its_lane_taken_waits_until_it_is_free():
    """While a thread blocks inside a write, nobody wakes up for the swap of its topic; the end of the write does."""
    thread, lane, calls = make(), Lane(lambda _sample: None), []

    class Swap:
        def service(self, _now_s):
            calls.append(thread.claim(lane, self))
            return math.inf

    assert thread.claim(lane, Swap())
    thread.start()
    thread.wake(Swap())
    eventually("it has its turn", lambda: calls)
    time.sleep(0.05)
    thread.release(lane)
    eventually("it has another one", lambda: calls == [False, True])
    thread.stop()


def test_a_price_for_many_lanes_wakes_the_thread_and_asks_nobody(monkeypatch):
    """To ask all lanes that wait at each of a thousand would take a second at every price."""
    thread, asked = make(), []
    monkeypatch.setattr(thread._queue, "due_s", lambda now_s: asked.append(now_s) or now_s + LONG_S)
    lanes = [Lane(lambda _sample: None) for _ in range(100)]
    for lane in lanes:
        thread._queue.offer(lane, b"sample", 0.0)
    thread._next_s = math.inf
    for lane in lanes:
        thread.retune(lane, lane.plan, None)
    assert (thread._next_s, asked) == (0.0, [])


def test_who_publishes_all_the_time_cannot_keep_a_lane():
    """Destroying a publisher waits for one write at most, and a later publish raises InvalidHandle."""
    thread, lane = make(), Lane(lambda _sample: time.sleep(0.001))
    thread.add(lane)

    def publish():
        with suppress(InvalidHandle):
            while True:
                thread.publish(lane, b"sample")

    publishing = [threading.Thread(target=publish, daemon=True) for _ in range(2)]
    for each in publishing:
        each.start()
    thread.remove(lane)
    for each in publishing:
        each.join(LONG_S)
        assert not each.is_alive()


FAST = Price(share_per_weight=math.inf, capacity_bytes_per_second=1e9)


@pytest.mark.parametrize(("publish", "price"), [(WritingThread.publish, FAST), (WritingThread.pass_on, None)])
def test_a_link_that_is_full_of_a_picture_holds_no_caller(publish, price):
    """Under a price a large sample is written in arpd's thread: a camera's callback goes on while it leaves.

    What is passed on is, without a price, too.
    """
    written, writers, is_free = [], set(), threading.Event()

    def write(sample):
        writers.add(threading.get_ident())
        written.append(sample[:1])
        is_free.wait(LONG_S)

    thread, lane = make(), Lane(write)
    thread.add(lane)
    thread.retune(lane, lane.plan, price)
    thread.start()
    for number in b"abc":
        publish(thread, lane, bytes([number]) + LARGE)
        eventually("the first one leaves", lambda: written)
    is_free.set()
    eventually("the newest one follows", lambda: written == [b"a", b"c"])
    assert threading.get_ident() not in writers
    thread.remove(lane)
    with pytest.raises(InvalidHandle):
        publish(thread, lane, LARGE + b"d")
    thread.stop()


def test_who_serves_many_topics_waits_for_no_second_write_that_blocks():
    """After a write that blocked, the thread writes all that is passed on, until writes are quick."""
    skipped_s, me, blocking, quick = [0.0], threading.get_ident(), [], []
    thread = make(clock=lambda: time.monotonic() + sum(skipped_s))
    slow = Lane(lambda _sample: blocking.append(threading.get_ident()) or skipped_s.append(LONG_S))
    other = Lane(lambda _sample: quick.append(threading.get_ident()))
    for lane in (slow, other):
        thread.add(lane)
    thread.start()
    for lane in (other, slow):
        thread.pass_on(lane, b"0")
    assert [*quick, *blocking] == [me, me]
    for lane in (slow, other):
        thread.pass_on(lane, b"1")
    eventually("both topics go on", lambda: len(blocking) == len(quick) == 2)
    assert me not in (blocking[1], quick[1])
    skipped_s.append(100.0 * LONG_S)
    thread.pass_on(other, b"later")
    assert quick[-1] == me
    thread.stop()


def test_publish_waits_for_the_write_before_it_as_rclpy_does():
    """A plain publisher loses nothing when several threads publish and its writer blocks."""
    thread, written = make(), []
    thread.add(lane := Lane(lambda sample: written.append(sample) or time.sleep(0.01)))
    thread.start()

    def publish(who):
        for number in range(10):
            thread.publish(lane, bytes([who, number]))

    publishing = [threading.Thread(target=publish, args=(who,)) for who in b"abc"]
    for each in publishing:
        each.start()
    for each in publishing:
        each.join()
    assert all([sample[1] for sample in written if sample[0] == who] == [*range(10)] for who in b"abc")
    thread.stop()


@pytest.mark.parametrize("interrupted", ["first_s", "begin", "admit"])
def test_who_publishes_in_the_middle_of_a_decision_has_to_wait(monkeypatch, interrupted):
    """A signal or a finalizer interrupts a thread anywhere, also in the queue; its own sample leaves all the same."""
    written, thread = [], make()
    lanes = [Lane(written.append, depth=9) for _ in range(3)]
    decide, ideas = getattr(lanes[0], interrupted), [b"of a signal"]

    def interrupt(*arguments, **options):
        if ideas:
            thread.publish(lanes[1], ideas.pop())
            thread.remove(lanes[2])
        return decide(*arguments, **options)

    monkeypatch.setattr(lanes[0], interrupted, interrupt)
    for lane in lanes:
        thread.add(lane)
    if interrupted == "admit":
        thread.publish(lanes[0], b"first")
    else:
        thread.offer(lanes[2], b"lost")
        thread.offer(lanes[0], b"first")
    thread.start()
    eventually("both leave", lambda: {b"first", b"of a signal"} <= {*written})
    assert thread.topics == 2
    thread.stop()


def test_who_destroys_a_publisher_in_the_middle_of_a_decision_waits_for_no_write(monkeypatch):
    """Nobody else could decide anything meanwhile, and the thread would end with a RecursionError."""
    written, may_end = [], threading.Event()
    thread, lane = make(), Lane(written.append)
    written_to = Lane(lambda sample: written.append(sample) or may_end.wait(LONG_S))
    for each in (lane, written_to):
        thread.add(each)
    thread.start()
    thread.offer(written_to, b"a")
    eventually("it is being written", lambda: written)
    admit = lane.admit

    def interrupt(*arguments):
        with pytest.raises(RuntimeError):
            thread.rest_of(written_to)
        thread.remove(written_to)
        return admit(*arguments)

    monkeypatch.setattr(lane, "admit", interrupt)
    thread.publish(lane, b"b")
    assert (written, thread.topics) == ([b"a", b"b"], 1)
    may_end.set()
    thread.offer(lane, b"c")
    eventually("the thread goes on", lambda: written[-1] == b"c")
    thread.stop()


def test_who_publishes_after_the_end_waits_for_nobody():
    """A function of `atexit` may stop the robot when the thread has ended, and no thread would write what waits."""
    thread, written = make(), []
    thread.add(lane := Lane(written.append))
    thread.retune(lane, replace(lane.plan, rate_hz=1e-3), None)
    thread.start()
    for sample in (b"go", b"go", b"go", b"wait"):
        thread.publish(lane, sample)
    thread.stop()
    before = len(written)
    thread.publish(lane, b"stop")
    assert written[before:] == [b"stop"]


def test_what_fails_in_a_shutdown_is_no_fault():
    """A write that fails because the participant has just gone is not logged; any other one is."""
    alive, said, failed = [True], [], []

    def write(sample):
        alive[0] = sample == b"before"
        failed.append(sample)
        raise RuntimeError(f"{sample} fails")

    thread, lane = make(said.append, is_alive=lambda: alive[0]), Lane(write)
    thread.add(lane)
    thread.start()
    for sample in (b"before", b"after"):
        thread.offer(lane, sample)
        eventually("it fails", lambda sample=sample: failed[-1:] == [sample])
    eventually("the thread ends", lambda: not thread._thread.is_alive())
    assert said == ["b'before' fails; the next sample follows (logged once a minute)"]


@pytest.mark.parametrize("faulty", ["first_s", "behind_s", "begin", "due_s"])
def test_a_lane_that_fails_at_its_turn_costs_no_other(monkeypatch, faulty):
    """What waits of a topic that cannot tell its turn is withheld, and said; all others go on, and it does later."""
    written, said = [], []
    thread = make(said.append)
    bad, good = Lane(written.append), Lane(written.append)

    def fail(*_arguments):
        raise ZeroDivisionError("no rate")

    for lane in (bad, good):
        thread.add(lane)
        thread.retune(lane, lane.plan, FAST)
    for lane in (bad, good):
        thread._queue.offer(lane, LARGE + b"1", 0.0)
    failing = property(fail) if isinstance(vars(Lane)[faulty], property) else fail
    with monkeypatch.context() as patch:
        patch.setattr(bad, "__class__", type("Faulty", (Lane,), {faulty: failing}))
        thread.start()
        eventually("the other one leaves", lambda: written == [LARGE + b"1"])
        eventually("that is said", lambda: said)
        thread.publish(good, b"2")
        eventually("the caller goes on", lambda: written[-1] == b"2")
    thread.publish(bad, b"3")
    eventually("it goes on, too", lambda: written[-1] == b"3")
    assert said == ["no rate; the next sample follows (logged once a minute)"]
    assert +bad.withheld == {WithheldCause.FAILED: 1}
    thread.stop()


def test_a_stop_between_two_turns_is_not_missed(monkeypatch):
    """A thread that is stopped before it waits does not wait: the shutdown of a context would take a second longer."""
    monkeypatch.setattr(writing_thread, "_IDLE_S", 100.0 * LONG_S)
    asked, may_go = threading.Event(), threading.Event()

    def is_alive():
        asked.set()
        return may_go.wait(LONG_S)

    thread = make(is_alive=is_alive)
    thread.start()
    assert asked.wait(LONG_S)
    stopping = threading.Thread(target=thread.stop, daemon=True)
    stopping.start()
    eventually("it is stopped", lambda: thread._is_stopping)
    may_go.set()
    thread._thread.join(LONG_S)
    assert not thread._thread.is_alive()
    stopping.join(LONG_S)


def test_every_fault_is_said_and_none_again_and_again():
    """Topics and writes that fail are each named, once a minute however often they are tried again."""
    words, tries, skipped_s = [], [], 0.0
    thread = make(words.append, clock=lambda: time.monotonic() + skipped_s)

    class Broken:
        def __init__(self, topic):
            self.topic_name = topic

        def service(self, _now_s):
            tries.append(self.topic_name)
            raise RuntimeError("out of resources")

        def finish(self):
            self.service(math.inf)

    def write(_sample):
        raise RuntimeError("/c: publishing failed")

    lane = Lane(write)
    thread.add(lane)
    thread.offer(lane, b"")
    for topic in ("/a", "/b"):
        thread.wake(Broken(topic))
    thread.start()
    eventually("they are tried again", lambda: len(tries) > 6)
    assert sorted(each.split(";")[0] for each in words) == [
        "/a: out of resources",
        "/b: out of resources",
        "/c: publishing failed",
    ]
    skipped_s = 60.0
    eventually("all are said again", lambda: len(words) == 5)
    thread.stop()
