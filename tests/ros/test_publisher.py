"""AdaptivePublisher with real rclpy and Fast DDS on this host."""

import math
import threading
import time
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64, String

from arpd import AdaptivePublisher
from arpd.apply.endpoint.writer_swap import SwapTiming
from arpd.model.plan import TopicPlan
from arpd.model.price import Price
from arpd.model.settings import Overflow
from tests.ros.announced import Announced
from tests.ros.price import FREE, TERMS, PriceSender, costing
from tests.ros.setter import Setter

pytestmark = pytest.mark.ros
TOPIC = "/swapped"
DEPTH = f"qos_overrides.{TOPIC}.publisher.depth"
RATE = f"arpd.{TOPIC}.publisher.rate"


class Reader:
    def __init__(self, node, qos=1000):
        self.received = []
        node.create_subscription(String, TOPIC, lambda message: self.received.append(int(message.data)), qos)


@pytest.fixture
def publisher(ros):
    # This host loses nothing, so readers match at once.
    return AdaptivePublisher(ros.node("talker"), String, TOPIC, 10, swap_timing=SwapTiming(settle_s=0.1))


@pytest.fixture
def configure(ros, publisher):
    return Setter(ros.node("tuner"), "/talker", TOPIC)


@pytest.fixture
def reader(ros, publisher, eventually):
    reader = Reader(ros.node("listener"))
    eventually(lambda: publisher.get_subscription_count() == 1)
    time.sleep(0.3)
    return reader


def state(publisher):
    return publisher.state(generation=0)


def publish_at(publisher, rate_hz):
    def work(stopping):
        number = 0
        while not stopping.is_set():
            publisher.publish(String(data=str(number)))
            number += 1
            time.sleep(1 / rate_hz)

    return work


def test_swap_loses_nothing(publisher, reader, configure, background, eventually):
    """Twelve swaps of depth and deadline under 200 Hz lose, double and reorder no message."""
    for k in range(13):
        assert configure(depth=500 + k, deadline=10**9 + k).successful
        eventually(lambda k=k: state(publisher).depth == 500 + k)
        if k == 0:  # from now on a busy machine may stop this process for two seconds without a loss
            background(publish_at(publisher, 200))
    # The last swap ends when its writer has proved itself, shortly after it is in force.
    eventually(lambda: sum(state(publisher).swaps_by_result.get(end, 0) for end in ("ok", "reorder_possible")) == 13)
    swaps = state(publisher).swaps_by_result
    sent = state(publisher).published
    eventually(lambda: len(reader.received) >= sent)
    assert sorted(reader.received) == list(range(len(reader.received)))
    # On a machine too busy to acknowledge in time the result says so, and only the order may suffer.
    assert "reorder_possible" in swaps or reader.received == sorted(reader.received)


def test_equal_settings_are_no_swap(publisher, reader, configure):
    """Setting the QoS in force makes no new writer."""
    assert configure(depth=10, deadline=0).successful
    time.sleep(0.3)
    assert not state(publisher).swaps_by_result


def test_pacing_conflates_and_counts(publisher, reader, configure, background, eventually):
    """A paced topic sends its newest sample at the set rate, and every sample is sent, withheld or waiting."""
    assert configure(rate=5.0).successful
    background(publish_at(publisher, 100))
    eventually(lambda: state(publisher).published >= 10)
    now = state(publisher)
    assert now.withheld > 5 * now.published
    assert now.offered == now.published + now.withheld + now.queued
    assert reader.received == sorted(set(reader.received))


@pytest.fixture
def send_price(ros, publisher, eventually):
    sender = PriceSender(ros.node("governor"))
    eventually(lambda: sender.listeners)
    return sender


def test_the_rate_follows_the_price_down_to_the_floor(publisher, configure, send_price, background, eventually):
    """A price lowers the rate to what it buys, but not below the floor, and a better one lets it return."""
    assert configure(rate=100.0, min_rate=20.0, **TERMS).successful
    background(publish_at(publisher, 200))
    for price, rate_hz in ((costing(50.0), 50.0), (costing(1.0), 20.0), (FREE, 100.0)):
        send_price(price)
        eventually(lambda rate_hz=rate_hz: state(publisher).paced_rate_hz == pytest.approx(rate_hz))
        before, since_s = state(publisher).published, time.monotonic()
        time.sleep(1.0)
        published_hz = (state(publisher).published - before) / (time.monotonic() - since_s)
        assert 0.5 * rate_hz < published_hz < 1.5 * rate_hz


def test_a_rate_set_by_hand_has_no_price(publisher, configure, send_price, eventually):
    """Without a weight the rate is what was set, whatever the price; with the weight it follows the last price."""
    assert configure(rate=100.0).successful
    send_price(costing(5.0))
    eventually(lambda: publisher._flow._price)
    assert state(publisher).paced_rate_hz == 100.0
    assert configure(**TERMS).successful
    assert state(publisher).paced_rate_hz == pytest.approx(5.0)


def test_large_samples_of_two_nodes_cross_one_at_a_time(ros, publisher, send_price, monkeypatch, eventually):
    """Of two large samples of a process that leave together the second waits until the first has crossed the link."""
    monkeypatch.setattr("arpd.apply.endpoint.link_clock._UNSTEADY_S", 0.0)
    monkeypatch.setattr("arpd.adapters.ros.node_publishers._BLOCKED_S", math.inf)  # this machine may be slow
    other = AdaptivePublisher(ros.node("second"), String, "/other", 10)
    row = TopicPlan(rate_hz=2.0, min_rate_hz=0.0, deadline_ns=0, depth=10, weight=1.0, wire_bytes=30_000.0, packets=20)
    for one in (publisher, other):
        one.retune(row)
    send_price(Price(share_per_weight=math.inf, capacity_bytes_per_second=100_000.0))
    eventually(lambda: publisher._flow._price and other._flow._price)
    before_s = time.monotonic()
    publisher.offer(String(data="first"))
    other.offer(String(data="second"))
    assert time.monotonic() - before_s > 0.25 or state(other).published == 0
    eventually(lambda: state(other).published == 1)
    assert time.monotonic() - before_s >= 0.29
    assert state(publisher).published == 1


def test_what_is_no_price_changes_nothing(publisher, configure, send_price, eventually):
    """Malformed messages are ignored, and the next price counts."""
    assert configure(rate=100.0, **TERMS).successful
    send_price(costing(5.0))
    eventually(lambda: state(publisher).paced_rate_hz == pytest.approx(5.0))
    for numbers in ([], [1.0, math.nan, *[0.0] * 5], [7.0] * 7, [1.0] * 500):
        send_price.send(numbers)
        time.sleep(0.1)
    assert state(publisher).paced_rate_hz == pytest.approx(5.0)
    send_price(costing(6.0))
    eventually(lambda: state(publisher).paced_rate_hz == pytest.approx(6.0))


def test_a_later_publisher_has_the_last_price_at_once(ros, send_price, eventually):
    """A publisher that is made after the price was sent follows it from the beginning."""
    settings = {"rate": 100.0, **TERMS}
    overrides = [Parameter(f"arpd.{TOPIC}.publisher.{name}", value=value) for name, value in settings.items()]
    node = ros.node("latecomer", parameter_overrides=overrides)
    first = AdaptivePublisher(node, String, "/first", 10)
    eventually(lambda: send_price.listeners == 2)
    send_price(costing(5.0))
    eventually(lambda: first._flow._price)
    assert state(AdaptivePublisher(node, String, TOPIC, 10)).paced_rate_hz == pytest.approx(5.0)


def test_silence_ends_a_slow_start_and_no_price(publisher, configure, send_price, monkeypatch, eventually):
    """After some seconds without a price no new topic waits for a plan, and a topic with a plan keeps the price."""
    monkeypatch.setattr("arpd.adapters.ros.node_publishers._SILENT_S", 0.5)
    planned = AdaptivePublisher(publisher._node, String, "/planned", 10)
    planned.retune(replace(planned.plan, rate_hz=100.0, **TERMS))
    slow_start = publisher._flow._slow_start
    send_price(costing(5.0))
    eventually(lambda: slow_start.has_daemon)
    eventually(lambda: not slow_start.has_daemon)
    assert state(planned).paced_rate_hz == pytest.approx(5.0)
    assert configure(rate=100.0, **TERMS).successful
    assert state(publisher).paced_rate_hz == pytest.approx(5.0), "a plan finds the last price"


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"depth": 0}, "outside 1..5000"),
        ({"depth": 5001}, "outside 1..5000"),
        ({"depth": "ten"}, "Wrong parameter type"),
        ({"deadline": -1}, "negative"),
        ({"rate": -1.0}, "not a rate"),
        ({"rate": float("nan")}, "not a rate"),
        ({"rate": 5}, "Wrong parameter type"),
        ({"min_rate": float("inf")}, "not a floor"),
        ({"weight": -1.0}, "not a weight"),
        ({"wire_bytes": 1e-9}, "not a size"),
        ({"packets": -1}, "outside 0..1000000000"),
    ],
)
def test_nonsense_is_refused_with_a_reason(publisher, configure, values, reason):
    """A bad value is refused with a reason, and no other value of the call is applied."""
    before = publisher.plan
    result = configure(**{"rate": 7.0, **values})
    assert not result.successful
    assert reason in result.reason
    assert publisher.plan == before


def test_deadline_is_clamped_to_the_tightest_reader(ros, publisher, configure, background, eventually):
    """An offered deadline longer than a reader requests is clamped, so no reader is lost."""
    assert configure(deadline=100_000_000).successful
    eventually(lambda: state(publisher).deadline_ns == 100_000_000)
    demanding = Reader(ros.node("demanding"), QoSProfile(depth=10, deadline=Duration(nanoseconds=500_000_000)))
    eventually(lambda: publisher.get_subscription_count() == 1)
    assert configure(deadline=900_000_000, depth=30).successful
    eventually(lambda: state(publisher).depth == 30)
    assert state(publisher).deadline_ns == 500_000_000
    background(publish_at(publisher, 50))
    eventually(lambda: len(demanding.received) > 5)


def test_it_announces_itself(ros, publisher, reader, eventually):
    """The announcement has the settings in force and the counters."""
    watcher = Announced(ros.node("watcher"))
    eventually(lambda: watcher.last)
    publisher.publish(String(data="0"))
    eventually(lambda: watcher.shows(published=1))
    announced = watcher.last
    assert (announced.node, announced.topic, announced.depth) == ("/talker", TOPIC, 10)
    assert announced.type_name == "std_msgs/msg/String"


def test_two_publishers_of_one_topic_in_one_node_are_refused(publisher):
    """A second AdaptivePublisher of a topic in one node is refused, and leaves no writer."""
    with pytest.raises(ValueError, match="already has an AdaptivePublisher"):
        AdaptivePublisher(publisher._node, String, TOPIC, 10)
    assert len(publisher._node.get_publishers_info_by_topic(TOPIC)) == 1


def test_destroy_frees_name_and_writers(publisher, ros):
    """A destroyed publisher leaves no writer and no parameter behind."""
    node = publisher._node
    publisher.destroy()
    assert not node.has_parameter(DEPTH)
    assert not node.get_publishers_info_by_topic(TOPIC)
    AdaptivePublisher(node, String, TOPIC, 10).destroy()


def test_wrong_type_is_refused(publisher):
    """Publishing another type raises TypeError, as rclpy does."""
    with pytest.raises(TypeError):
        publisher.publish(Float64())


def test_one_failing_topic_does_not_stop_the_others(publisher, configure, background, monkeypatch, eventually):
    """A publisher that raises is logged and tried again, and the node's other topics are paced."""
    other = AdaptivePublisher(publisher._node, String, "/other", 10)

    def fail(_now_s):
        raise RuntimeError("the middleware is out of resources")

    monkeypatch.setattr(other, "service", fail)
    assert configure(rate=20.0).successful
    background(publish_at(publisher, 100))
    before = state(publisher).published
    eventually(lambda: state(publisher).published >= before + 20)


def test_the_pacing_thread_ends_with_its_node(ros, eventually):
    """Destroying the node ends the thread that served its publishers."""
    node = ros.node("short_lived")
    thread = AdaptivePublisher(node, String, TOPIC, 10)._shared._thread
    node.destroy_node()
    eventually(lambda: not thread.is_alive())


def test_overrides_given_at_the_start_are_in_force(ros, eventually):
    """Depth and rate from --ros-args overrides are in force."""
    overrides = [Parameter(DEPTH, value=77), Parameter(RATE, value=5.0)]
    publisher = AdaptivePublisher(ros.node("overridden", parameter_overrides=overrides), String, TOPIC, 10)
    eventually(lambda: state(publisher).depth == 77)
    assert publisher.plan.rate_hz == 5.0


class SlowWriter:
    """A writer that keeps its samples and their threads, and may block as on a full link."""

    def __init__(self, publisher, monkeypatch, *, takes_s=0.0):
        self.written, self.threads, self.takes_s = [], [], takes_s
        self.may_go_on = threading.Event()
        self.may_go_on.set()
        monkeypatch.setattr(publisher._flow, "write", self.write)

    def write(self, sample):
        begun_s = time.monotonic()
        self.threads.append(threading.current_thread())
        self.written.append(sample)
        time.sleep(self.takes_s)
        self.may_go_on.wait(timeout=20)
        return time.monotonic() - begun_s


def test_offer_writes_at_once_where_nothing_blocks(publisher, monkeypatch):
    """A sample leaves in the thread that offers it, and the pacing thread is not woken."""
    writer = SlowWriter(publisher, monkeypatch)
    monkeypatch.setattr(publisher, "service", pytest.fail)
    for number in range(10):
        publisher.offer(b"%d" % number)
    assert writer.written == [b"%d" % number for number in range(10)]
    assert set(writer.threads) == {threading.current_thread()}


def test_offer_does_not_wait_for_a_writer_that_blocks(publisher, monkeypatch, eventually):
    """While a write blocks, offers return and conflate, and the newest sample leaves next."""
    writer = SlowWriter(publisher, monkeypatch)
    writer.may_go_on.clear()
    publisher.retune(replace(publisher.plan, rate_hz=25.0))
    threading.Thread(target=publisher.offer, args=(b"first",), daemon=True).start()
    eventually(lambda: writer.written == [b"first"])
    for number in range(100):
        publisher.offer(b"%d" % number)  # would block if it wrote, or waited for the write
    assert writer.written == [b"first"]
    writer.may_go_on.set()
    eventually(lambda: writer.written[-1] == b"99")
    assert len(writer.written) < 5


def test_one_long_write_is_enough_to_hand_over(publisher, monkeypatch, eventually):
    """After a write longer than any scheduling delay the pacing thread writes the next sample."""
    writer = SlowWriter(publisher, monkeypatch, takes_s=0.1)
    publisher.offer(b"0")
    publisher.offer(b"1")
    eventually(lambda: len(writer.threads) == 2)
    assert writer.threads[0] is threading.current_thread() is not writer.threads[1]


def test_a_writer_that_blocks_does_not_delay_other_topics(publisher, monkeypatch, eventually):
    """After writes that blocked, the pacing thread writes the node's samples, until writes are quick again."""
    monkeypatch.setattr("arpd.adapters.ros.node_publishers._BLOCKED_S", math.inf)  # this machine may be slow
    other = AdaptivePublisher(publisher._node, String, "/other", 10)
    blocking, unblocked = SlowWriter(publisher, monkeypatch, takes_s=0.1), SlowWriter(other, monkeypatch)
    me = threading.current_thread()
    publisher.offer(b"0")
    other.offer(b"0")
    assert unblocked.threads == [me]  # one slow write may come from the scheduler
    publisher.offer(b"1")
    publisher.offer(b"2")
    other.offer(b"1")
    eventually(lambda: len(blocking.written) == 3 and len(unblocked.written) == 2)
    assert blocking.threads[:2] == [me, me]
    assert me not in (blocking.threads[2], unblocked.threads[1])

    def is_written_here():
        other.offer(b"later")
        return unblocked.threads[-1] is me

    eventually(is_written_here)


def test_a_small_sample_waits_for_one_large_one_at_most(publisher, monkeypatch, eventually):
    """A small sample that comes while a large one is written leaves before all other large ones, of any topic."""
    cameras = [
        AdaptivePublisher(publisher._node, String, f"/camera{k}", 100, overflow=Overflow.QUEUE) for k in range(2)
    ]
    small = publisher
    small._shared.quick_from_s = math.inf  # every write is the pacing thread's
    order = []

    def write_large(_sample):
        small.offer(b"small")
        order.append("large")
        time.sleep(0.02)
        return 0.02

    def write_small(_sample):
        order.append("small")
        return 0.0

    monkeypatch.setattr(small._flow, "write", write_small)
    for camera in cameras:
        monkeypatch.setattr(camera._flow, "write", write_large)
        with camera._lock:
            for _ in range(5):
                camera.offer(b"a large sample" * 1000)
    eventually(lambda: len(order) == 20)
    assert order == ["large", "small"] * 10


def test_only_due_publishers_are_served(ros, monkeypatch, eventually):
    """The pacing thread does not serve publishers whose samples left at once, while another topic is busy."""
    publisher = AdaptivePublisher(ros.node("queued"), String, TOPIC, 100, overflow=Overflow.QUEUE)
    idle = [AdaptivePublisher(publisher._node, String, f"/idle{k}", 10) for k in range(5)]
    calls = dict.fromkeys((publisher, *idle), 0)

    def counted(one, service):
        def count(now_s):
            calls[one] += 1
            return service(now_s)

        return count

    for one in calls:
        monkeypatch.setattr(one, "service", counted(one, one.service))
    publisher.retune(replace(publisher.plan, rate_hz=50.0))
    for _ in range(3):
        publisher.offer(b"paced")
    eventually(lambda: state(publisher).published == 3)  # the thread has seen the new publishers
    for one in idle:
        one.offer(b"at once")
    for _ in range(20):
        publisher.offer(b"paced")
    eventually(lambda: state(publisher).published == 23)
    assert calls[publisher] >= 5
    assert all(calls[one] <= 1 for one in idle)  # at its creation


def test_what_waits_leaves_without_further_offers(ros, monkeypatch, eventually):
    """Every queued sample leaves in time, and all at once when the rate is raised."""
    publisher = AdaptivePublisher(ros.node("queued"), String, TOPIC, 100, overflow=Overflow.QUEUE)
    writer = SlowWriter(publisher, monkeypatch)
    samples = [b"%d" % number for number in range(20)]
    publisher.retune(replace(publisher.plan, rate_hz=40.0))
    for sample in samples:
        publisher.offer(sample)
    eventually(lambda: writer.written == samples)
    publisher.retune(replace(publisher.plan, rate_hz=0.001))
    for sample in samples:
        publisher.offer(sample)
    assert state(publisher).queued > 0
    publisher.retune(replace(publisher.plan, rate_hz=float("inf")))
    eventually(lambda: writer.written == 2 * samples)


def test_a_better_price_lets_out_what_waits(ros, monkeypatch, eventually):
    """Samples that a price holds leave when it allows more, without a further offer."""
    publisher = AdaptivePublisher(ros.node("slowed"), String, TOPIC, 100, overflow=Overflow.QUEUE)
    writer = SlowWriter(publisher, monkeypatch)
    publisher.retune(replace(publisher.plan, rate_hz=100.0, **TERMS))
    publisher.set_price(costing(1e-4))
    for number in range(10):
        publisher.offer(b"%d" % number)
    assert state(publisher).queued > 0
    publisher.set_price(FREE)
    eventually(lambda: len(writer.written) == 10)


def test_what_waits_behind_a_failed_write_leaves(ros, monkeypatch, eventually):
    """A failed write raises in `offer`, and the samples behind it leave without a further offer."""
    publisher = AdaptivePublisher(ros.node("failing"), String, TOPIC, 100, overflow=Overflow.QUEUE)
    writer = SlowWriter(publisher, monkeypatch)

    def fail(_sample):
        publisher._flow.offer(b"behind it")  # as another thread does meanwhile
        monkeypatch.setattr(publisher._flow, "write", writer.write)
        raise RuntimeError("the middleware is out of resources")

    monkeypatch.setattr(publisher._flow, "write", fail)
    with pytest.raises(RuntimeError, match="out of resources"):
        publisher.offer(b"lost")
    eventually(lambda: writer.written == [b"behind it"])


def test_a_destroyed_publisher_is_not_served(publisher, monkeypatch, eventually):
    """A publisher that is destroyed while its samples wait is no longer served; the others are."""
    other = AdaptivePublisher(publisher._node, String, "/other", 100, overflow=Overflow.QUEUE)
    writer = SlowWriter(other, monkeypatch)
    publisher.retune(replace(publisher.plan, rate_hz=10.0))
    for _ in range(5):
        publisher.offer(b"waits")
    assert state(publisher).queued > 0
    publisher.destroy()
    served = []
    monkeypatch.setattr(publisher, "service", lambda now_s: served.append(None) or now_s + 1.0)
    other.retune(replace(other.plan, rate_hz=40.0))
    for _ in range(20):
        other.offer(b"paced")
    eventually(lambda: len(writer.written) == 20)  # 0.5 s, in which the destroyed one would have been due
    assert not served


def test_offers_of_many_threads_keep_their_order(ros, monkeypatch, eventually):
    """Offers, the pacing thread and blocking writes keep the order of each thread's samples."""
    publisher = AdaptivePublisher(ros.node("busy"), String, TOPIC, 5000, overflow=Overflow.QUEUE)
    writer = SlowWriter(publisher, monkeypatch)
    threads, each = 4, 400

    def offer(thread):
        for number in range(each):
            if number % 100 == 0:
                rate_hz = 2000.0 if number % 200 else float("inf")
                publisher.retune(replace(publisher.plan, rate_hz=rate_hz))
                writer.takes_s = 0.006 if thread == 0 else 0.0  # some writes block
            publisher.offer(b"%d %d" % (thread, number))

    workers = [threading.Thread(target=offer, args=(thread,)) for thread in range(threads)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    writer.takes_s = 0.0
    eventually(lambda: len(writer.written) == threads * each)
    for thread in range(threads):
        mine = [int(sample.split()[1]) for sample in writer.written if sample.startswith(b"%d " % thread)]
        assert mine == list(range(each))
    assert publisher._shared._thread in writer.threads
