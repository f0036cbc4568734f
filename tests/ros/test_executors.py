"""AdaptivePublisher under every executor and from many threads, during continual swaps."""

import gc
import inspect
import threading
import time
from contextlib import ExitStack
from itertools import count
from pathlib import Path

import pytest
import rclpy
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.model.endpoints import SwapTiming
from tests.ros.world import DOMAIN, Ros, retune

EXECUTORS = [SingleThreadedExecutor, MultiThreadedExecutor, EventsExecutor]
TOPIC = "/busy"
# This host loses nothing, so readers match at once; and no swap gives up, however busy the machine is.
QUICK = SwapTiming(settle_s=0.1, match_timeout_s=60.0, patience_s=60.0, drain_s=60.0)
HELLO = "hello"


def os_threads():
    """Count the threads of this process, also the middleware's, but not MultiThreadedExecutor's pool."""
    pooled = sum(thread.name.startswith("ThreadPoolExecutor") for thread in threading.enumerate())
    return len(list(Path("/proc/self/task").iterdir())) - pooled


@pytest.fixture(params=EXECUTORS, ids=lambda executor: executor.__name__)
def talker(ros, request):
    return ros.node("talker", executor=request.param(context=ros.context))


def listen(ros, eventually, publisher):
    """Return what arrives from now on, once the reader's side has matched, too."""
    greeted, received = [], []

    def hear(message):
        (greeted if message.data == HELLO else received).append(message.data)

    ros.node("listener").create_subscription(String, TOPIC, hear, 5000)
    eventually("the reader matches", lambda: publisher.publish(String(data=HELLO)) or greeted)
    return received


def swap_all_the_time(publisher):
    """Request another depth every 100 ms, about the time of a swap."""

    def work(stopping):
        depth = 1000
        while not stopping.wait(0.1):
            depth += 1
            retune(publisher, depth=depth)

    return work


def test_swaps_under_fire_lose_nothing(ros, talker, background, eventually):
    """Under each executor, continual swaps lose, double and reorder nothing, and leave no thread."""
    publisher = AdaptivePublisher(talker, String, TOPIC, 1000, swap_timing=QUICK)
    received = listen(ros, eventually, publisher)
    before = os_threads()
    stopping = threading.Event()
    swapping = threading.Thread(target=swap_all_the_time(publisher), args=(stopping,))
    swapping.start()
    numbers = count()

    def five_have_ended():
        publisher.publish(String(data=str(next(numbers))))
        done = publisher.state().swaps_by_result
        return done.get("ok", 0) + done.get("reorder_possible", 0) >= 5

    eventually("five swaps end under fire", five_have_ended)
    stopping.set()
    swapping.join()
    number = next(numbers)
    eventually("every message arrives", lambda: len(received) >= number)
    assert received == list(map(str, range(number)))
    eventually("no thread is left", lambda: os_threads() <= before)
    eventually("one writer is left", lambda: len(talker.get_publishers_info_by_topic(TOPIC)) == 1)


def test_many_threads_publish_at_once(ros, background, eventually):
    """Messages of several threads, typed and raw, arrive once and in each thread's order, through swaps."""
    publisher = AdaptivePublisher(ros.node("talker"), String, TOPIC, 5000, swap_timing=QUICK)
    received = listen(ros, eventually, publisher)
    background(swap_all_the_time(publisher))
    per_thread, threads = 100, 4

    def publish(thread):
        for number in range(per_thread):
            message = String(data=f"{thread} {number}")
            send = publisher.pass_on if number % 3 else publisher.publish
            send(serialize_message(message) if number % 2 else message)
            time.sleep(0.01)

    workers = [threading.Thread(target=publish, args=(thread,)) for thread in range(threads)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    eventually("every message arrives", lambda: len(received) >= per_thread * threads)
    for thread in range(threads):
        mine = [data for data in received if data.startswith(f"{thread} ")]
        assert mine == [f"{thread} {number}" for number in range(per_thread)]


def test_pacing_and_swaps_do_not_wait_for_simulated_time(ros, background, eventually):
    """With use_sim_time and a paused clock, messages are paced and writers swapped."""
    talker = ros.node("talker")
    talker.set_parameters([Parameter("use_sim_time", value=True)])
    clock = ros.node("simulator").create_publisher(Clock, "/clock", 1)
    clock.publish(Clock())
    publisher = AdaptivePublisher(talker, String, TOPIC, 10)
    received = listen(ros, eventually, publisher)
    retune(publisher, rate_hz=20.0, depth=30)

    def talk(stopping):
        while not stopping.wait(0.01):
            publisher.publish(String(data="x"))

    background(talk)
    eventually("the writer is swapped", lambda: publisher.state().depth == 30)
    eventually("messages arrive", lambda: len(received) > 20)
    assert publisher.state().withheld > 0


def test_it_stays_in_the_context_of_its_node(ros, eventually):
    """The publisher of a node in another context and domain is not visible here."""
    node = ros.elsewhere(DOMAIN + 1).idle_node("elsewhere")
    publisher = AdaptivePublisher(node, String, TOPIC, 10)
    for each in (ros.node("here"), node):
        each.create_subscription(String, TOPIC, lambda _message: None, 10)
    eventually("the reader there matches alone", lambda: publisher.get_subscription_count() == 1)
    retune(publisher, depth=30)
    eventually("the writer is swapped", lambda: publisher.state().depth == 30)


def shut_down_as_a_signal(context):
    context.handle.shutdown()  # and rclpy calls none of the functions given to `on_shutdown`


@pytest.mark.parametrize("is_destroyed_first", [False, True])
@pytest.mark.parametrize("shut_down", [rclpy.Context.shutdown, shut_down_as_a_signal])
def test_nothing_of_a_participant_outlives_its_node_and_its_context(
    environment, eventually, is_destroyed_first, shut_down
):
    """Both may go in any order: no thread waits for Python's collector, and nobody waits for a thread of arpd's."""
    with ExitStack() as stack:
        Ros(stack, DOMAIN + 1).idle_node("first")  # the first one leaves threads in any process
    before = os_threads()
    gc.disable()
    try:
        with ExitStack() as stack:
            ros = Ros(stack, DOMAIN + 1)
            node = ros.idle_node("short_lived")
            AdaptivePublisher(node, String, TOPIC, 10)
            if is_destroyed_first:
                node.destroy_node()
            shut_down(ros.context)
        eventually("its threads end", lambda: os_threads() <= before)
    finally:
        gc.enable()


def test_the_signature_is_that_of_create_publisher(ros):
    """An AdaptivePublisher takes the arguments of `Node.create_publisher` in order, except publisher_class."""
    theirs = inspect.signature(rclpy.node.Node.create_publisher).parameters
    ours = inspect.signature(AdaptivePublisher.__init__).parameters
    positional = [name for name, p in theirs.items() if p.kind is p.POSITIONAL_OR_KEYWORD]
    taken = [name for name, p in ours.items() if p.kind is p.POSITIONAL_OR_KEYWORD]
    assert taken == ["self", "node", *positional[1:]]
    assert set(theirs) - set(ours) == {"publisher_class"}
    publisher = AdaptivePublisher(ros.node("talker"), String, TOPIC, 1)
    assert all(hasattr(publisher, name) for name in vars(rclpy.publisher.Publisher) if not name.startswith("_"))
