"""The relay with two ends: groups of topics, and what the daemon sees of both."""

import platform
import time

from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String, UInt8MultiArray

from arpd.model.observation import MessageKind, MessageRefusal
from arpd.model.plan import TopicPlan
from arpd.model.settings import DEFAULT_RELAY_DEPTH
from arpd.ros.names import PUBLISHERS_TOPIC
from arpd.ros.world import RosControl
from tests.ros.ends_world import BEST_EFFORT, Counter, listen
from tests.ros.world import Announced, Plans


def test_a_stereo_pair_arrives_whole_or_not_at_all(world, background, eventually):
    """Thinned to two sets a second, a group delivers whole sets alone; a topic with the group's name is refused."""
    topics = ("/left/image", "/left/camera_info", "/right/image")
    ends = world(f"groups: [{{name: /stereo, topics: [{', '.join(topics)}]}}]").start()
    camera, far = ends.side("robot").node("camera"), ends.side("base").node("planner")
    kinds = (Image, CameraInfo, Image)
    writers = [camera.create_publisher(kind, topic, 10) for kind, topic in zip(kinds, topics, strict=True)]
    stamps = {topic: [] for topic in topics}
    for kind, topic in zip(kinds, topics, strict=True):
        seen = stamps[topic]
        far.create_subscription(kind, topic, lambda message, seen=seen: seen.append(message.header.stamp.nanosec), 1000)
    camera.create_publisher(Image, "/stereo", 10)
    far.create_subscription(Image, "/stereo", lambda _message: None, 10)

    def shoot(stopping):
        for number in range(100_000):
            for kind, writer in zip(kinds, writers, strict=True):
                message = kind()
                message.header.stamp.nanosec = number
                if number % 7 or kind is Image:  # the driver itself drops some
                    writer.publish(message)
            if stopping.wait(0.01):
                return

    background(shoot)
    eventually("sets arrive", lambda: len(stamps[topics[0]]) > 50)
    relay = ends.side("link").node("planner")
    told = Announced(relay)
    eventually("it tells its depth", lambda: [each.depth for each in told.states] == [DEFAULT_RELAY_DEPTH])
    row = TopicPlan(rate_hz=2.0, max_rate_hz=2.0, min_rate_hz=0.0, deadline_ns=0, depth=10)
    Plans(relay)(1, {"/stereo": row})
    first = stamps[topics[0]]
    # Two sets a second are fewer than the camera takes on any machine.
    eventually("the group is thinned", lambda: len(first) > 5 and first[-1] - first[-5] > 8)
    common = min(map(len, stamps.values()))
    assert stamps[topics[0]][:common] == stamps[topics[1]][:common] == stamps[topics[2]][:common]
    assert all(number % 7 for number in stamps[topics[0]])
    words = f"refused /stereo: on {platform.node()}: a group of topics has"
    eventually("the other topic is named", lambda: words in ends.status["robot"])


def test_an_end_waits_for_the_other_one_and_the_daemon_sees_their_silence(world, talking, tmp_path, eventually):
    """The robot's end waits, and says who is silent and where; it alone tells the daemon, which notices its end."""
    ends = world().start("robot")
    writer = ends.side("robot").node("other").create_publisher(String, "/unread", 10)
    eventually("the end waits", lambda: "waiting for the base computer's end; 1 topics" in ends.status["robot"])
    assert writer.get_subscription_count() == 0
    ends.start("base")
    node = ends.side("link").node("arpd")
    daemon = RosControl(node, interface="lo", on_report=lambda: None, has_two_ends=True)
    talking(Counter(ends.side("robot").node("sensor"), String, "/chatter", 10))
    listen(ends.side("base").node("planner"), "/chatter")

    def seen():
        return daemon.observe(time.monotonic())

    def shows(condition):
        return (relay := seen().relay) is not None and condition(relay) and relay

    relay = eventually("the daemon sees what crosses", lambda: shows(lambda relay: relay.to_base.wanted == 1))
    assert (relay.is_reachable, relay.other_host, relay.fault) == (True, platform.node(), "")
    assert (relay.to_base.offered, relay.to_robot.offered, relay.to_base.refused) == (2, 0, {})
    eventually("the ends meet", lambda: "1 of 2 topics cross to the base computer" in ends.status["robot"])
    ends.end("base")
    eventually("the daemon sees who is silent", lambda: shows(lambda relay: not relay.is_reachable))
    eventually("the silent end is named", lambda: "the base computer's end is silent" in ends.status["robot"])
    liar = node.create_publisher(UInt8MultiArray, PUBLISHERS_TOPIC, BEST_EFFORT)

    def is_refused():
        liar.publish(UInt8MultiArray(data=b"{}"))
        return seen().refused.get((MessageKind.PUBLISHERS, MessageRefusal.MALFORMED))

    eventually("a false snapshot is refused", is_refused)
    words = "nothing heard of arpd-relay-far at 127.0.0.1 (relay.base) for 10 s"
    eventually("the log says where the silent end should be", lambda: words in (tmp_path / "robot.log").read_text())
    ends.end("robot")
    eventually("the daemon sees that the relay ended", lambda: seen().is_relay_silent)
    assert seen().relay is None
