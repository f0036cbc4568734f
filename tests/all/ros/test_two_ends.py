"""The relay with two ends: many topics, a third end, and calls after a restart."""

import threading
import time
from contextlib import ExitStack
from statistics import median

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from std_msgs.msg import String
from test_msgs.srv import BasicTypes

from tests.ros.ends_world import Counter, TwoEnds

pytestmark = pytest.mark.ros


@pytest.fixture
def world(ros, tmp_path):
    """Make a world with these lines under ``relay:``."""
    with ExitStack() as stack:
        yield lambda *relay: TwoEnds(tmp_path, stack, relay)


def test_two_hundred_topics_are_wanted_at_once(world, background, eventually):
    """When a reader of 200 topics comes, each of them arrives."""
    ends = world().start()
    robot = ends.side("robot").node("robot")
    writers = [Counter(robot, String, f"/many/t{k}", 10) for k in range(200)]
    far, received = ends.side("base").node("rviz"), {}
    eventually("the topics show", lambda: far.count_publishers("/many/t199") == 1)
    for writer in writers:
        topic = writer.publisher.topic_name
        heard = received[topic] = []
        far.create_subscription(String, topic, heard.append, 10)

    def talk(stopping):
        while not stopping.wait(0.5):
            for writer in writers:
                writer.publish()

    background(talk)
    eventually("each topic arrives", lambda: all(received.values()))


def test_a_second_far_end_is_ignored_and_named(world, eventually):
    """Of two ends on the far side the first one stays in force, and the robot's end names the other one's host."""
    ends = world().start()
    eventually("the ends meet", lambda: "topics cross" in ends.status["robot"])
    first = ends.processes["base"]
    ends.start("base")
    eventually("the second one is named", lambda: "ignored another base computer's end on" in ends.status["robot"])
    first.kill()
    first.wait()
    eventually("the second one takes over", lambda: "ignored" not in ends.status["robot"])


def called(world, eventually):
    """Return both ends, and a client on one side whose server is on the other."""
    ends = world("services: [/add]").start()
    server, planner = ends.side("robot").node("server"), ends.side("base").node("planner")
    server.create_service(BasicTypes, "/add", lambda request, response: response)
    client = planner.create_client(BasicTypes, "/add")
    eventually("the service crosses", client.service_is_ready)
    return ends, client


def test_a_call_wakes_both_ends(world, eventually):
    """The median call across both ends takes less than half of one of their ticks, of 20 ms."""
    _, client = called(world, eventually)

    def duration_s():
        began_s, answered = time.monotonic(), threading.Event()
        client.call_async(BasicTypes.Request()).add_done_callback(lambda _: answered.set())
        assert answered.wait(30.0)
        return time.monotonic() - began_s

    duration_s()  # it waits for the client at the other end to match
    assert median(duration_s() for _ in range(50)) < 0.01


def test_a_restarted_far_end_serves_again(world, eventually):
    """Calls work again after a kill -9 of the far end, although its ghosts stay in the graph for a while."""
    ends, client = called(world, eventually)
    ends.end("base")
    ends.start("base")
    calls = []

    def is_answered():
        calls.append(client.call_async(BasicTypes.Request()))
        return any(call.done() for call in calls)

    eventually("a call is answered", is_answered)
