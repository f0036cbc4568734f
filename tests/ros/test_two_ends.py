"""The relay with two ends: real processes, a domain on each side and one between them, on this host."""

import platform
import threading
from contextlib import ExitStack
from itertools import count

import pytest
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSLivelinessPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64, String, UInt8MultiArray
from test_msgs.srv import BasicTypes

from arpd.model.plan import TopicPlan
from arpd.relay.ends.end import NOBODY
from arpd.relay.ends.offers import VERSION, ServiceOffer, TopicOffer, WriterOffer, decode_state
from arpd.relay.envelope import Record, pack, writer_key
from arpd.ros.names import on_link
from tests.ros.ends_world import (
    BEST_EFFORT,
    RELIABLE,
    ROBOT,
    Counter,
    Stranger,
    TwoEnds,
    is_whole,
    latched,
    listen,
    numbers,
)
from tests.ros.world import TERMS, Plans
from tests.waiting import eventually as insist

# A busy machine holds the link up for a second; other topics keep the newest sample then, and by default a queue ten.
QUEUE = "overflow: queue, depth: 1000"
ORDERED = ("topics:", *(f"- {{name: {name}, {QUEUE}}}" for name in ("/chatter", "/tf", "/mixed", "/planned")))


class Running:
    """Both ends, started once for several tests; each test has nodes and topics of its own."""

    def __init__(self, folder):
        self._folder, self._stack, self._ends = folder, ExitStack(), None

    def ends(self):
        if self._ends is None:
            ends = TwoEnds(self._folder, self._stack, ORDERED).start()
            try:
                insist("the ends meet", lambda: all("topics cross" in status for status in ends.status.values()))
            except AssertionError as fault:
                self.stop()  # the next test starts a pair of its own
                raise AssertionError(f"{fault}: {ends.status}") from fault
            self._ends = ends
        return self._ends

    def stop(self):
        self._stack.close()
        self._ends = None


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    running = Running(tmp_path_factory.mktemp("ends"))
    yield running
    running.stop()


@pytest.fixture
def ends(ros, running):
    """Both ends, which keep all samples of some topics."""
    ends = running.ends()
    with ExitStack() as ends.nodes:
        yield ends


@pytest.fixture
def world(running, world):
    """Leave no other ends in the domains."""
    running.stop()
    return world


def test_a_topic_keeps_its_name_and_is_read_only_while_it_is_wanted(ends, talking, eventually):
    """A topic crosses under its own name while somebody reads it there, and the robot's writer has no reader before."""
    writer = Counter(ends.side("robot").node("sensor"), String, "/chatter", RELIABLE)
    talking(writer)
    far = ends.side("base").node("planner")
    eventually("the topic shows", lambda: "/chatter" in dict(far.get_topic_names_and_types()))
    assert writer.publisher.get_subscription_count() == 0
    received = []
    reader = far.create_subscription(String, "/chatter", lambda message: received.append(message.data), RELIABLE)
    eventually("samples arrive", lambda: len(received) > 50)
    assert is_whole(received, "sensor")
    eventually(
        "the status counts it", lambda: ends.status["robot"].startswith("1 of 1 topics cross to the base computer")
    )
    far.destroy_subscription(reader)
    eventually("it is read no more", lambda: writer.publisher.get_subscription_count() == 0)


def test_the_far_side_looks_as_the_robot(ends, eventually):
    """Nodes, topics, types and the QoS of every writer look on the far side as on the robot."""
    robot = ends.side("robot")
    profile = QoSProfile(
        depth=7,
        reliability=QoSReliabilityPolicy.BEST_EFFORT,
        deadline=Duration(seconds=2),
        lifespan=Duration(seconds=5),
        liveliness=QoSLivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=Duration(seconds=3),
    )
    sensor = robot.node("sensor", namespace="/left")
    sensor.create_publisher(String, "/looks", profile)
    robot.node("other").create_publisher(String, "/looks", latched(3))
    far = ends.side("base").node("rqt")
    eventually("both writers show", lambda: far.count_publishers("/looks") == 2)

    kept = ("reliability", "durability", "deadline", "lifespan", "liveliness", "liveliness_lease_duration")

    def shown(node):
        return {
            f"{info.node_namespace}/{info.node_name}": (
                info.topic_type,
                [getattr(info.qos_profile, name) for name in kept],
            )
            for info in node.get_publishers_info_by_topic("/looks")
        }

    eventually("both sides look the same", lambda: shown(far) == shown(sensor))
    nodes = {("sensor", "/left"), ("other", "/")}
    eventually("the nodes show", lambda: nodes <= set(far.get_node_names_and_namespaces()))


def test_a_ghost_lives_while_its_original_asserts_its_liveliness(ends, background, eventually):
    """A reader on the far side notices when a node there still exists but asserts no more, and when it does again."""
    profile = QoSProfile(
        depth=10,
        liveliness=QoSLivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(seconds=1),
    )
    writer = ends.side("robot").node("motor").create_publisher(String, "/motor", profile)
    asserts, alive = threading.Event(), []
    asserts.set()

    def live(stopping):
        while not stopping.wait(0.2):
            if asserts.is_set():
                writer.assert_liveliness()

    background(live)
    callbacks = SubscriptionEventCallbacks(liveliness=lambda event: alive.append(event.alive_count))
    far = ends.side("base").node("planner")
    far.create_subscription(String, "/motor", lambda _message: None, profile, event_callbacks=callbacks)
    eventually("the ghost lives", lambda: alive and alive[-1] == 1)
    asserts.clear()
    eventually("the ghost lives no more", lambda: alive[-1] == 0)
    assert far.count_publishers("/motor") == 1
    asserts.set()
    eventually("the ghost lives again", lambda: alive[-1] == 1)


def test_every_latched_writer_keeps_its_own_history(ends, eventually):
    """A late reader gets the one sample of a quiet latched writer beside the last ones of a busy one."""
    robot, base = ends.side("robot"), ends.side("base")
    quiet = Counter(robot.node("quiet"), String, "/tf_static", latched(1))
    busy = Counter(robot.node("busy"), String, "/tf_static", latched(1))
    quiet.publish()
    busy.publish(50)
    first = listen(base.node("first"), "/tf_static", latched(100))
    eventually("each one's last sample arrives", lambda: set(first) == {"quiet 0", "busy 49"})
    busy.publish(300)
    eventually("the newest sample arrives", lambda: first[-1] == "busy 349")
    assert numbers(first, "busy") == sorted(set(numbers(first, "busy")))
    late = listen(base.node("late"), "/tf_static", latched(1000))
    eventually("a late reader gets both", lambda: {"quiet 0", "busy 349"} <= set(late))


def test_writers_on_both_sides_of_one_topic_are_heard_once_on_both(ends, talking, eventually):
    """With writers and readers of /tf on both sides, each reader gets every sample once, and none circles."""
    robot, base = ends.side("robot"), ends.side("base")
    here = [listen(robot.node("robot_reader"), "/tf"), listen(base.node("base_reader"), "/tf")]
    talking(
        *(Counter(robot.node(name), String, "/tf", RELIABLE) for name in ("odom", "arm")),
        Counter(base.node("slam"), String, "/tf", RELIABLE),
    )
    for received in here:
        for name in ("odom", "arm", "slam"):
            eventually(f"{name} is heard", lambda heard=received, name=name: len(numbers(heard, name)) > 50)
            assert is_whole(received, name)


def test_a_reliable_writer_stays_reliable_beside_a_best_effort_one(ends, talking, eventually):
    """A reliable reader hears the reliable writer only, a best-effort one both, as on the robot."""
    robot, base = ends.side("robot"), ends.side("base")
    strict, loose = listen(base.node("strict"), "/mixed"), listen(base.node("loose"), "/mixed", BEST_EFFORT)
    talking(
        Counter(robot.node("sure"), String, "/mixed", RELIABLE),
        Counter(robot.node("maybe"), String, "/mixed", BEST_EFFORT),
    )
    for received, name in ((loose, "sure"), (loose, "maybe"), (strict, "sure")):
        eventually(f"{name} is heard", lambda heard=received, name=name: len(numbers(heard, name)) > 30)
    assert is_whole(strict, "sure")
    assert not numbers(strict, "maybe")


def test_a_ghost_offers_the_deadline_that_is_planned_for_the_link(ends, talking, eventually):
    """A plan for a topic on the link reaches the far side's ghost, whose reader hears every sample once meanwhile."""
    talking(Counter(ends.side("robot").node("sensor"), String, "/planned", RELIABLE))
    far = ends.side("base").node("planner")
    received = listen(far, "/planned")
    eventually("samples arrive", lambda: len(received) > 20)
    daemon = ends.side("link").node("daemon")
    row = TopicPlan(rate_hz=1000.0, min_rate_hz=1.0, deadline_ns=400_000_000, depth=400, **TERMS)
    Plans(daemon)(1, {"/planned": row})

    def offered():
        return [info.qos_profile.deadline.nanoseconds for info in far.get_publishers_info_by_topic("/planned")]

    eventually("the plan alone is offered", lambda: offered() == [400_000_000])
    before = len(received)
    eventually("samples go on", lambda: len(received) > before + 50)
    assert is_whole(received, "sensor")


def test_types_that_differ_between_the_sides_are_named(ends, eventually):
    """A topic that has another type on the far side is named with both types."""
    ends.side("robot").node("sensor").create_publisher(String, "/two_types", 10)
    listen(ends.side("base").node("planner"), "/two_types", msg_type=Float64)
    host, differ = platform.node(), "it is std_msgs/msg/String there and std_msgs/msg/Float64 here"
    words = f"/two_types: on {host}: nodes here do not hear it: {differ}"
    eventually("both types are named", lambda: words in ends.status["base"])


def test_a_killed_end_returns_and_doubles_nothing(world, talking, eventually):
    """After a kill -9 of either end its topics go on, no reader gets a sample twice, and a late one the history."""
    ends = world(*ORDERED).start()
    robot, base = ends.side("robot"), ends.side("base")
    still = Counter(robot.node("map_server"), String, "/map", latched(1))
    still.publish()
    talking(Counter(robot.node("sensor"), String, "/chatter", RELIABLE))
    planner = base.node("planner")
    maps, received = listen(planner, "/map", latched(10)), listen(planner, "/chatter")
    eventually("the map and samples arrive", lambda: maps and len(received) > 20)
    for end, enough in (("robot", 50), ("base", 300)):  # the robot's end has taken note by then
        ends.end(end)
        before = len(received)
        ends.start(end)
        eventually("samples go on", lambda before=before, enough=enough: len(received) > before + enough)
        assert end == "base" or maps == ["map_server 0"]
    assert is_whole(received[before:], "sensor")
    found = numbers(received, "sensor")
    assert found == sorted(set(found))
    late = listen(base.node("late"), "/map", latched(10))
    eventually("a late reader gets the map", lambda: late == ["map_server 0"])


def test_a_history_waits_for_the_reader_of_the_living_process(world, eventually):
    """A reader on the link of a process that was killed matches for some seconds; no history is read for it alone."""
    ends = world().start("robot")
    node = ends.side("robot").node("map_server")
    still, other = Counter(node, String, "/map", latched(1)), Counter(node, String, "/other", RELIABLE)
    still.publish()
    dead, living = ends.side("link").node("dead"), ends.side("link").node("living")
    listen(dead, on_link("/map"), RELIABLE, UInt8MultiArray)
    listen(living, on_link("/other"), RELIABLE, UInt8MultiArray)
    heard = listen(living, "/arpd/relay/robot/small", RELIABLE, UInt8MultiArray)
    end = Stranger(living, wants=frozenset({"/map", "/other"}))

    def lives(condition):
        end.live()
        other.publish()
        return condition()

    eventually("the end writes the topic", lambda: lives(lambda: dead.count_publishers(on_link("/map")) == 1))
    eventually("what the living process reads crosses", lambda: lives(lambda: heard))
    assert still.publisher.get_subscription_count() == 0
    received = listen(living, on_link("/map"), RELIABLE, UInt8MultiArray)
    eventually("the living reader gets the map", lambda: lives(lambda: len(received) == 1))


def test_an_end_of_another_version_is_named(world, eventually, monkeypatch):
    """An end that speaks another version is named with both versions, and nothing crosses."""
    monkeypatch.setattr("arpd.relay.ends.offers.VERSION", 99)
    ends = world().start("robot")
    Stranger(ends.side("link").node("stranger"), arpd="9.9")
    words = f"it speaks version 99 (arpd 9.9), this end version {VERSION}"
    eventually("both versions are named", lambda: words in ends.status["robot"])


def test_a_robot_that_is_left_out_says_so_in_its_log_once(world, tmp_path, eventually):
    """The base computer's end of its link domain serves another robot; the status line and the log have the fix."""
    ends, said = world().start("robot"), "serves another robot's end; give each robot a relay.link_domain of its own"
    stranger = Stranger(ends.side("link").node("stranger"), host="base", follows="010f0002" + 16 * "0")
    for _again in range(2):
        eventually("it is left out", lambda: stranger.live() or said in ends.status["robot"])
        eventually("the other end is gone", lambda: "waiting for" in ends.status["robot"])
    assert (tmp_path / "robot.log").read_text().count(said) == 1


def test_what_was_on_its_way_longer_than_its_lifespan_is_not_delivered(world, eventually):
    """A command that a stalled link holds for longer than its LIFESPAN never runs; without LIFESPAN the newest does."""
    ends = world().start("robot")
    robot = ends.side("robot").node("motor")
    lifespans_ns = {"/short": 200_000_000, "/endless": 0}
    topics = {
        name: TopicOffer(
            type_name="std_msgs/msg/String",
            writers=(WriterOffer(node="/planner", gid=name.encode().ljust(16).hex(), lifespan_ns=lifespan_ns),),
            link_name=name,
        )
        for name, lifespan_ns in lifespans_ns.items()
    }
    stranger = Stranger(ends.side("link").node("stranger"), topics=topics)
    writers = {name: stranger.node.create_publisher(UInt8MultiArray, on_link(name), RELIABLE) for name in topics}
    heard, samples = {name: listen(robot, name) for name in topics}, count(1)

    def send(text, late_s):
        for name, writer in writers.items():
            key = writer_key(topics[name].writers[0].gid)
            record = Record(key, next(samples), bytes(serialize_message(String(data=text))))
            stranger.send(writer, pack([record]), late_s=late_s)

    def is_heard():
        stranger.live()
        send("fresh", 0.0)
        return all("fresh" in texts for texts in heard.values())

    eventually("both topics cross", is_heard)
    send("late", 3.0)
    eventually("the newest is delivered", lambda: "late" in heard["/endless"])
    send("then", 0.0)
    eventually("samples go on", lambda: all("then" in texts for texts in heard.values()))
    assert "late" not in heard["/short"]


def test_a_type_with_another_definition_is_refused_by_name(world, eventually):
    """Of two topics and two services of one type those of another definition do not enter, nor one of an unknown."""
    ends = world("services: [/**]").start("robot")
    robot, link = ends.side("robot").node("sensor"), ends.side("link")
    Counter(robot, String, "/chatter", RELIABLE)
    told = listen(link.node("watcher"), "/arpd/relay/robot", latched(1), UInt8MultiArray)
    robot.create_service(BasicTypes, "/double", lambda _request, response: response)

    def offered():
        state = decode_state(bytes(told[-1])) if told else NOBODY
        return state.topics.get("/chatter"), state.services.get("/double")

    eventually("the end tells what it offers", lambda: all(offered()))
    same, (asked, answered) = offered()[0].type_hash, offered()[1].type_hashes
    assert len({same[:7], asked[:7], answered[:7], "RIHS01_"}) == 1
    writer = WriterOffer(node="/planner", gid="00" * 16)
    topics = {
        name: TopicOffer(type_name="std_msgs/msg/String", writers=(writer,), link_name=name, type_hash=type_hash)
        for name, type_hash in (("/same", same), ("/other", f"RIHS01_{'0' * 64}"))
    }
    services = {"/unknown": ServiceOffer(type_name="nowhere/srv/Thing", node="/planner")} | {
        name: ServiceOffer(type_name="test_msgs/srv/BasicTypes", node="/planner", type_hashes=hashes)
        for name, hashes in (("/ask", (asked, answered)), ("/unlike", (asked, same)))
    }
    stranger = Stranger(link.node("stranger"), topics=topics, services=services)

    def is_refused():
        stranger.live()
        words = f"refused /other: on {platform.node()}: std_msgs/msg/String has another definition here"
        return words in ends.status["robot"] and ends.status["robot"].endswith("; also /unknown, /unlike")

    eventually("the other definition is refused", is_refused)
    assert [robot.count_publishers(name) for name in topics] == [1, 0]
    assert [robot.count_services(name) for name in services] == [0, 1, 0]


def test_two_ends_in_one_domain_say_so_and_carry_nothing(world, talking, eventually):
    """Where both ends see each other in one domain, both say so, and a reader hears the writer itself, once."""
    ends = world(domains=(ROBOT, ROBOT)).start()
    robot = ends.side("robot")
    talking(Counter(robot.node("sensor"), String, "/chatter", RELIABLE))
    received = listen(robot.node("planner"), "/chatter")
    for end in ("robot", "base"):
        eventually(f"the {end} end says so", lambda end=end: "both ends are in one ROS domain" in ends.status[end])
    before = len(received) + 50  # what was under way has arrived
    eventually("samples go on", lambda: len(received) > before + 50)
    assert is_whole(received[before:], "sensor")


def test_only_what_the_configuration_lets_out_crosses(world, eventually):
    """Patterns and deny decide what crosses, and the namespace stands before the robot's names on the base computer."""
    ends = world("namespace: /r1", 'to_base: ["/camera/**"]', 'to_robot: ["/goal"]', 'deny: ["/camera/raw"]').start()
    robot, base = ends.side("robot"), ends.side("base")
    node = robot.node("camera")
    for topic in ("/camera/image", "/camera/raw", "/secret"):
        node.create_publisher(String, topic, 10)
    far = base.node("planner", namespace="/r1")
    goals = listen(robot.node("base"), "/goal")
    goal = Counter(far, String, "/r1/goal", 10)
    far.create_publisher(String, "/goal", 10)
    eventually("the image shows", lambda: "/r1/camera/image" in dict(far.get_topic_names_and_types()))
    eventually("the goal is wanted", lambda: goal.publisher.get_subscription_count() == 1)
    goal.publish()
    eventually("the goal arrives", lambda: goals == ["planner 0"])
    eventually("the camera shows", lambda: ("camera", "/r1") in far.get_node_names_and_namespaces())
    eventually("the planner shows", lambda: ("planner", "/") in node.get_node_names_and_namespaces())
    topics = dict(far.get_topic_names_and_types())
    assert not {"/r1/camera/raw", "/r1/secret", "/camera/image"} & topics.keys()
