"""The process of one end: its watchdog, its stop, and what it refuses."""

import array
import resource
import signal
import time
from contextlib import closing
from types import SimpleNamespace
from typing import ClassVar

import psutil
from std_msgs.msg import String, UInt8MultiArray
from test_msgs.srv import BasicTypes

from arpd.model.settings import RelaySettings
from arpd.relay.ends.end import End
from arpd.relay.main import check_deaf_to_itself
from arpd.ros.names import on_link
from tests.ros.ends_world import LINK, RELIABLE, ROBOT, Counter, Stranger, latched, listen

PROFILE = """<?xml version="1.0"?>
<profiles xmlns="http://www.eprosima.com"><participant profile_name="own" is_default_profile="true"/></profiles>
"""


def test_a_profile_that_lets_an_end_hear_itself_is_named_by_its_variable(world, tmp_path):
    """An end that starts with such a profile ends at once, and says what to add or to unset."""
    (tmp_path / "own.xml").write_text(PROFILE)
    ends = world().start("robot", FASTRTPS_DEFAULT_PROFILES_FILE=tmp_path / "own.xml")
    assert ends.processes["robot"].wait(60) > 0
    log = (tmp_path / "robot.log").read_text()
    assert "fastdds.ignore_local_endpoints=true" in log
    assert log.rstrip().endswith("or unset FASTRTPS_DEFAULT_PROFILES_FILE")


class Named:
    """A node of one name among others of it, whose readers are seen at once, but not by the writers of its own."""

    readers: ClassVar = []

    def create_subscription(self, _type, topic, _callback, _depth):
        self.readers.append((topic, self))

    def create_publisher(self, _type, topic, _depth):
        others = [reader for reader in self.readers if reader[0] == topic and reader[1] is not self]
        return SimpleNamespace(get_subscription_count=lambda: len(others))

    def destroy_subscription(self, _subscription):
        """Leave it, as an end that starts at the same moment does."""

    destroy_publisher = destroy_subscription


def test_ends_that_start_at_once_on_one_host_do_not_take_each_other_for_themselves():
    """The far ends of several robots have the name of their host, and start together when it boots."""
    for _end in range(3):
        check_deaf_to_itself(Named())


def test_large_samples_that_have_crossed_leave_no_memory_behind(world, eventually):
    """Thirty samples of 2 MB add less than eight of them to the memory of either end, after the first few."""
    ends = world().start()
    writer, heard, sizes = ends.side("robot").node("map").create_publisher(UInt8MultiArray, "/map", 10), [], []
    ends.side("base").node("planner").create_subscription(UInt8MultiArray, "/map", lambda _map: heard.append(1), 10)
    sample = UInt8MultiArray(data=array.array("B", bytes(2_000_000)))

    def has_heard(samples):
        if len(heard) < samples:
            writer.publish(sample)
        return len(heard) >= samples

    for samples in (10, 40):
        eventually(f"{samples} samples have crossed", lambda samples=samples: has_heard(samples))
        sizes.append([psutil.Process(end.pid).memory_info().rss for end in ends.processes.values()])
    assert all(after - before < 16e6 for before, after in zip(*sizes, strict=True)), sizes


def test_an_end_that_calls_and_carries_feeds_its_watchdog_and_stops_without_a_fault(
    world, tmp_path, background, eventually
):
    """SIGTERM ends both ends with status 0 and no traceback, although calls and samples arrive meanwhile."""
    ends = world("services: [/add]").start(WATCHDOG_USEC="20000000")
    robot, base = ends.side("robot").node("server"), ends.side("base").node("client")
    robot.create_service(BasicTypes, "/add", lambda _request, response: response)
    talker, heard = robot.create_publisher(String, "/talk", 10), []
    base.create_subscription(String, "/talk", heard.append, 10)
    client = base.create_client(BasicTypes, "/add")
    eventually("the service crosses", client.service_is_ready)
    answers = []

    def use(stopping):
        while not stopping.wait(0.005):
            talker.publish(String(data="x"))
            answers.append(client.call_async(BasicTypes.Request()))

    background(use)
    eventually("samples cross", lambda: len(heard) > 10)
    eventually("a call is answered", lambda: any(answer.done() for answer in answers))
    # The parts would be stale after five seconds.
    eventually("both feed the watchdog", lambda: min(ends.pings.values()) >= 7)
    assert [ends.end(end, signal.SIGTERM) for end in ("base", "robot")] == [0, 0]
    logs = [(tmp_path / f"{end}.log").read_text() for end in ("base", "robot")]
    assert not [log for log in logs if "Traceback" in log or "Error" in log], logs


def test_an_end_may_open_more_files_than_a_shell_or_systemd_lets_it_by_default(world, stack, eventually):
    """Each topic and service takes one: an end of 1024 carried nothing new any more where 130 nodes have parameters."""
    soft, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    stack.callback(resource.setrlimit, resource.RLIMIT_NOFILE, (soft, most))
    resource.setrlimit(resource.RLIMIT_NOFILE, (most // 2, most))
    ends = world().start("robot")
    robot = psutil.Process(ends.processes["robot"].pid)
    eventually("it may open all", lambda: robot.rlimit(resource.RLIMIT_NOFILE) == (most, most))


class Another(Stranger):
    session = 2


def test_an_end_that_was_held_up_stays_with_the_other_one(ros, monkeypatch, eventually):
    """Of two ends that speak it does not take the one whose sign of life happened to be its last before the pause."""
    now_s = [100.0]
    monkeypatch.setattr("arpd.relay.ends.end.lasting_s", lambda: now_s[0])
    nodes, others = [ros.elsewhere(domain).idle_node("end") for domain in (ROBOT, LINK)], ros.elsewhere(LINK)
    settings = RelaySettings(link_domain=LINK, robot="127.0.0.1")
    with closing(End(*nodes, settings, is_far=False, on_change=lambda _status: None)) as end:
        first = Stranger(others.node("first"), host="first")
        eventually("it follows the first", lambda: first.live() or end.tick() or end._there.session == 1)
        time.sleep(0.2)
        end.tick()  # its last sign of life was now
        now_s[0] += 0.6
        second = Another(others.node("second"), host="second")
        eventually("it knows the second", lambda: end.tick() or end._partner.others(now_s[0]) == ["second"])
        now_s[0] += 1.2
        for each in (first, second):
            each.live()
        eventually("both have spoken", lambda: {1, 2} <= {*end._arrived})
        end.tick()
        assert end._there.session == 1


def test_an_end_of_another_robot_condemns_none_that_works(ros, eventually):
    """Its message is named only while there is no other end."""
    nodes, others = [ros.elsewhere(domain).idle_node("end") for domain in (ROBOT, LINK)], ros.elsewhere(LINK)
    settings = RelaySettings(link_domain=LINK, robot="127.0.0.1")
    with closing(End(*nodes, settings, is_far=False, on_change=lambda _status: None)) as end:

        def fault():
            end.tick()
            return end._summary(time.monotonic()).fault

        _stranger = Stranger(others.node("stranger"), namespace="/robot2")
        eventually("the stranger is named", lambda: "/robot2" in fault())
        first = Another(others.node("first"))
        eventually("the right one works", lambda: first.live() or not fault())
        _stranger_again = Stranger(others.node("again"), namespace="/robot3")
        eventually("its message has come", lambda: first.live() or fault() or "/robot3" in end._fault)
        assert not fault()


def test_an_end_that_slept_sends_its_histories_again(ros, monkeypatch, eventually):
    """The other end took that for an outage, and has forgotten what it got; late readers there would lack the map."""
    monkeypatch.setattr("arpd.relay.partner._GONE_S", 1.0)
    nodes = [ros.elsewhere(domain).idle_node("end") for domain in (ROBOT, LINK)]
    still = Counter(ros.elsewhere(ROBOT).node("map_server"), String, "/map", latched(1))
    still.publish()
    other = ros.elsewhere(LINK).node("other")
    heard = listen(other, on_link("/map"), RELIABLE, UInt8MultiArray)
    settings = RelaySettings(link_domain=LINK, robot="127.0.0.1")
    with closing(End(*nodes, settings, is_far=False, on_change=lambda _status: None)) as end:
        stranger = Stranger(other, wants=frozenset({"/map"}))

        def crosses(times):
            stranger.live()
            end.tick()
            return len(heard) >= times

        eventually("the map crosses", lambda: crosses(1))
        before = len(heard)
        time.sleep(1.2)
        stranger.live()
        time.sleep(0.2)  # what arrives meanwhile waits in the socket of an end that was stopped
        eventually("it crosses again", lambda: crosses(before + 1))
