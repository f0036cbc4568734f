"""Services and actions across the link with real rclpy: two domains in one process, and a link that loses records."""

import random
import threading
import time
from contextlib import ExitStack, suppress

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("test_msgs", reason="test_msgs is not installed")

import rclpy
from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import NodeNameNonExistentError
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.srv import SetCameraInfo
from test_msgs.action import Fibonacci
from test_msgs.srv import BasicTypes, Empty

from arpd.model.settings import RelaySettings
from arpd.relay.calls import FailureReason, Kind, Record, Request, encode_record
from arpd.relay.ends import calls as calls_module
from arpd.relay.ends import services as services_module
from arpd.relay.ends.calls import Calls
from arpd.relay.ends.ghosts import GhostNodes
from arpd.relay.ends.offers import ServiceOffer
from arpd.relay.ends.services import GhostServer
from arpd.relay.ends.types import UnknownTypeError, message_class, service_class
from arpd.relay.selection import Side
from arpd.ros.raw_reader import ReadingThread
from arpd.ros.runtime import prepare_environment
from scripts.bench.child import spinning
from tests.ros.world import DOMAIN

pytestmark = pytest.mark.ros

STATE_S = 0.1
ROBOT, BASE = DOMAIN, DOMAIN + 1


class Wire:
    """The link from one end, which loses, doubles and reorders records, and its reader at the other end."""

    def __init__(self, end):
        self._end = end
        self._random = random.Random(1)
        self._held = []
        self.loss = 0.0

    def send(self, record, _source):
        for _ in range(1 + (self._random.random() < self.loss)):
            if self._random.random() >= self.loss:
                self._held.insert(self._random.randrange(len(self._held) + 1), record)
        if self._random.random() >= self.loss:
            while self._held:
                with suppress(OSError):  # its end is restarting
                    self._end.other.calls.arrived(self._end.session, self._held.pop(0))


class End:
    """One end of the relay: its participant in a local domain."""

    def __init__(self, name, domain, *, is_far=False, timeout_s=120.0, **settings):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.session = random.randrange(1, 2**32)
        self.other = None
        self.ahead_s = 0.0  # of the monotonic clock
        self.wire = Wire(self)
        self.node = rclpy.create_node(
            f"arpd_{name}", context=self.context, start_parameter_services=False, enable_rosout=False
        )
        self._nodes = GhostNodes(self.node)
        allowed = {"services": ("/**",), "actions": ("/**",), "deny": ("/**/get_type_description",)}
        self.calls = Calls(
            self.node,
            self._nodes,
            self.wire.send,
            session=self.session,
            side=Side.of(RelaySettings(**{**allowed, **settings}), is_far=is_far),
            timeout_s=timeout_s,
            clock=self.now_s,
        )

    def now_s(self):
        return time.monotonic() + self.ahead_s

    @property
    def under_way(self):
        """Calls from this side, and calls to this side."""
        return self.calls._book.waiting, self.calls._book.running

    def tell(self):
        self.other.calls.offered = self.calls.offers, self.session

    def stop(self):
        if self.context.ok():
            self.calls.close()
            self._nodes.close()
            self.node.destroy_node()
            rclpy.try_shutdown(context=self.context)


class Nodes:
    """Nodes of the application in one domain, each with an executor of its own."""

    def __init__(self, domain, stack):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        stack.callback(rclpy.try_shutdown, context=self.context)
        self._stack = stack

    def at_end(self, callback):
        """Call this before the nodes made so far are destroyed; rclpy destroys no action with its node."""
        self._stack.callback(callback)

    def idle_node(self, name, **options):
        node = rclpy.create_node(
            name, context=self.context, start_parameter_services=False, enable_rosout=False, **options
        )
        self._stack.callback(node.destroy_node)
        return node

    def node(self, name, executor=None, **options):
        node = self.idle_node(name, **options)
        executor = executor or SingleThreadedExecutor(context=self.context)
        executor.add_node(node)
        self._stack.enter_context(spinning(executor))
        return node

    def client(self, kind, name):
        return self.node("user").create_client(kind, name)


class World:
    """A robot and a base computer, the relay between them, and nodes on either side."""

    def __init__(self, stack):
        self._stack = stack
        self.robot_nodes, self.base_nodes = (Nodes(domain, stack) for domain in (ROBOT, BASE))
        self.robot = self.base = None

    def relay(self, **options):
        self.robot = End("robot", ROBOT, **options)
        self.base = End("base", BASE, is_far=True, **options)
        self.robot.other, self.base.other = self.base, self.robot
        for end in (self.robot, self.base):
            self._stack.callback(end.stop)
        stopping = threading.Event()
        telling = threading.Thread(target=self._tell, args=(stopping,))
        telling.start()
        self._stack.callback(telling.join)
        self._stack.callback(stopping.set)

    def _tell(self, stopping):
        while not stopping.wait(STATE_S):
            self.robot.tell()
            self.base.tell()

    def other_base_nodes(self):
        return Nodes(BASE, self._stack)

    def restart_robot(self):
        old, new = self.robot, End("robot", ROBOT)
        old.stop()
        new.other, self.base.other = self.base, new
        self.robot = new
        self._stack.callback(new.stop)

    def lose(self, share):
        self.robot.wire.loss = self.base.wire.loss = share

    def pass_time(self, seconds, eventually):
        """Let both ends' clocks jump ahead, and the ends see it."""
        before_s = time.monotonic()
        for end in (self.robot, self.base):
            end.ahead_s += seconds
        eventually(
            "both have looked twice",
            lambda: all(end.calls._look_s > before_s + seconds + 3 * STATE_S for end in (self.robot, self.base)),
        )


@pytest.fixture
def world(monkeypatch):
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setattr(calls_module, "_LOOK_S", STATE_S)
    prepare_environment()
    with ExitStack() as stack:
        yield World(stack)


class Doubler:
    """Counts its calls, and answers with twice the number."""

    def __init__(self, node, name="/double"):
        self.node = node
        self.runs = []
        self.service = node.create_service(BasicTypes, name, self._answer)

    def _answer(self, request, response):
        self.runs.append(request.int32_value)
        response.int32_value = 2 * request.int32_value
        return response


def silent_server(node, type_name, name):
    """Serve a service that never answers; returns the requests and the server."""
    requests, offer = [], ServiceOffer(type_name=type_name, node="")
    thread = ReadingThread.of(node.context)
    return requests, GhostServer(node, offer, name, thread, lambda request, _header: requests.append(request))


def finished(eventually, future):
    eventually("the call ends", future.done)
    return future.result()


def test_a_service_is_called_across_a_bad_link(world, eventually):
    """Each of many calls at once gets its own answer, and runs once, although every third record is lost."""
    doubler = Doubler(world.robot_nodes.node("calculator", namespace="/tools"))
    world.relay()
    client = world.base_nodes.client(BasicTypes, "/double")
    eventually("the service crosses", client.service_is_ready)
    looker = world.base_nodes.node("looker")
    eventually("the ghost has its name", lambda: serves(looker, "/tools/calculator", "/double"))
    world.lose(0.3)
    for first in (0, 8, 16):  # a client of ROS has room for ten responses
        futures = [client.call_async(BasicTypes.Request(int32_value=first + number)) for number in range(8)]
        answers = [finished(eventually, future).int32_value for future in futures]
        assert answers == [2 * (first + number) for number in range(8)]
    assert sorted(doubler.runs) == list(range(24))
    world.lose(0.0)
    eventually("no call is left", lambda: world.base.under_way == world.robot.under_way[::-1] == (0, 0))
    assert not world.base.calls.failures
    assert not world.base.calls.offers  # its own ghost is no service of its side


def serves(node, name, service):
    """Return whether the graph shows a node with this name and service, as another node sees it."""
    namespace, _, base = name.rpartition("/")
    try:
        return service in dict(node.get_service_names_and_types_by_node(base, namespace or "/"))
    except NodeNameNonExistentError:
        return False


def test_a_call_under_way_delays_no_other(world, eventually):
    """While a call waits, other calls go on; both ends forget it when it has waited too long, or its server is gone."""
    requests, server = silent_server(world.robot_nodes.idle_node("slow"), "test_msgs/srv/BasicTypes", "/slow")
    Doubler(world.robot_nodes.node("calculator"))
    world.relay()
    slow, fast = world.base_nodes.client(BasicTypes, "/slow"), world.base_nodes.client(BasicTypes, "/double")
    eventually("both services cross", lambda: slow.service_is_ready() and fast.service_is_ready())
    waiting = slow.call_async(BasicTypes.Request())
    eventually("the call reaches its server", lambda: requests)
    assert finished(eventually, fast.call_async(BasicTypes.Request(int32_value=4))).int32_value == 8
    assert not waiting.done()
    world.pass_time(130.0, eventually)
    eventually("both ends forget it", lambda: world.base.under_way == world.robot.under_way == (0, 0))
    assert all(client.is_idle for client in world.robot.calls._clients.values())
    slow.call_async(BasicTypes.Request())
    eventually("the call reaches its server", lambda: len(requests) == 2)
    server.destroy()
    eventually("both ends forget it", lambda: world.base.under_way == world.robot.under_way == (0, 0))
    assert world.base.calls.failures == {"timeout": 1, "no_server": 1}


def test_what_comes_from_the_link_waits_for_no_node_here(world, monkeypatch):
    """While calls wait for a node, records are taken from the link: the other end awaits their receipts."""
    world.relay()
    is_waiting, gate = threading.Event(), threading.Event()
    monkeypatch.setattr(world.robot.calls._book, "receive", lambda *_record: (is_waiting.set(), gate.wait()))
    record = encode_record(Record(Kind.WAITING, world.robot.session, 1))
    for _ in range(2):
        taking = threading.Thread(target=world.robot.calls.arrived, args=(world.base.session, record), daemon=True)
        taking.start()
        taking.join(5.0)
        assert not taking.is_alive()
    assert is_waiting.wait(5.0)
    gate.set()


def test_names_on_the_base_have_the_namespace(world, eventually):
    """The robot's services are under the namespace, the base computer's cross without it, and others do not cross."""
    up = Doubler(world.robot_nodes.node("calculator"), "/double")
    down = Doubler(world.base_nodes.node("planner", namespace="/spot"), "/spot/plan")
    Doubler(world.base_nodes.node("alien"), "/alien")
    world.relay(namespace="/spot")
    to_robot, to_base = (
        world.base_nodes.client(BasicTypes, "/spot/double"),
        world.robot_nodes.client(BasicTypes, "/plan"),
    )
    eventually("both services cross", lambda: to_robot.service_is_ready() and to_base.service_is_ready())
    finished(eventually, to_robot.call_async(BasicTypes.Request(int32_value=1)))
    finished(eventually, to_base.call_async(BasicTypes.Request(int32_value=2)))
    assert (up.runs, down.runs) == ([1], [2])
    here, there = world.base_nodes.node("looker"), world.robot_nodes.node("looker")
    eventually("the ghost has its name", lambda: serves(here, "/spot/calculator", "/spot/double"))
    eventually("the ghost has its name", lambda: serves(there, "/planner", "/plan"))
    assert set(world.base.calls.offers) == {"/plan"}


def test_only_allowed_services_cross(world, eventually):
    """A service that the configuration does not name is neither offered nor called."""
    Doubler(world.robot_nodes.node("calculator"), "/double")
    secret = Doubler(world.robot_nodes.node("safe"), "/secret")
    world.relay(services=("/double",))
    client = world.base_nodes.client(BasicTypes, "/double")
    eventually("the service crosses", client.service_is_ready)
    assert set(world.robot.calls.offers) == {"/double"}
    answers = forged_call(world, "/secret")
    eventually("the forged call ends", lambda: answers)
    assert answers[0].reason is FailureReason.NO_SERVER
    assert not secret.runs


def forged_call(world, service, type_name="test_msgs/srv/BasicTypes", body=b""):
    """Call from the base computer what its own end would not call; returns the outcomes."""
    outcomes = []
    request = Request(service, type_name, body or serialize_message(BasicTypes.Request()))
    world.base.calls._book.call(request, timeout_s=10.0, now_s=time.monotonic(), on_end=outcomes.append)
    return outcomes


def test_an_action_crosses_a_bad_link(world, eventually):
    """An action client gets acceptance, feedback and result of a server on the other side."""
    serve_fibonacci(world.robot_nodes)
    world.relay()
    client, feedback = action_client(world, eventually), []
    world.lose(0.2)
    goal = client.send_goal_async(
        Fibonacci.Goal(order=6), feedback_callback=lambda message: feedback.append(message.feedback)
    )
    handle = finished(eventually, goal)
    assert handle.accepted
    result = finished(eventually, handle.get_result_async())
    assert result.status == GoalStatus.STATUS_SUCCEEDED
    assert list(result.result.sequence) == [0, 1, 1, 2, 3, 5]
    eventually("feedback arrives", lambda: feedback)
    assert handle.status == GoalStatus.STATUS_SUCCEEDED


def test_an_action_is_cancelled_across_the_link(world, eventually):
    """Cancelling a goal reaches the server, and the result says so; it comes long after the time-out of calls."""
    serve_fibonacci(world.robot_nodes, step_s=0.2)
    world.relay(timeout_s=60.0)
    client = action_client(world, eventually)
    handle = finished(eventually, client.send_goal_async(Fibonacci.Goal(order=1000)))
    result = handle.get_result_async()
    eventually("the robot's end has the call", lambda: world.robot.under_way == (0, 1))
    assert world.base.under_way == (1, 0)
    world.pass_time(70.0, eventually)
    assert not result.done()
    cancelled = finished(eventually, handle.cancel_goal_async())
    assert cancelled.return_code == CancelGoal.Response.ERROR_NONE
    assert finished(eventually, result).status == GoalStatus.STATUS_CANCELED


def serve_fibonacci(side, step_s=0.02):
    """Serve an action that takes one step per number."""
    node = side.node("math", MultiThreadedExecutor(num_threads=3, context=side.context))

    def execute(goal):
        sequence = [0, 1]
        while len(sequence) < goal.request.order:
            if goal.is_cancel_requested:
                goal.canceled()
                return Fibonacci.Result(sequence=sequence)
            sequence.append(sequence[-1] + sequence[-2] if sequence[-1] < 10**8 else 0)
            goal.publish_feedback(Fibonacci.Feedback(sequence=sequence))
            time.sleep(step_s)
        goal.succeed()
        return Fibonacci.Result(sequence=sequence)

    server = ActionServer(
        node,
        Fibonacci,
        "/fibonacci",
        execute,
        cancel_callback=lambda _goal: CancelResponse.ACCEPT,
        callback_group=ReentrantCallbackGroup(),
    )
    side.at_end(server.destroy)


def action_client(world, eventually):
    """Return a client on the base computer that sees the whole action, whose two topics the test carries."""
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    carrier, math = world.robot_nodes.node("carrier"), world.base_nodes.node("math_topics")
    for part, qos, type_name in (
        ("feedback", 10, "test_msgs/action/Fibonacci_FeedbackMessage"),
        ("status", latched, "action_msgs/msg/GoalStatusArray"),
    ):
        kind = message_class(type_name)
        publisher = math.create_publisher(kind, f"/fibonacci/_action/{part}", qos)
        carrier.create_subscription(kind, f"/fibonacci/_action/{part}", publisher.publish, qos, raw=True)
    client = ActionClient(world.base_nodes.node("user"), Fibonacci, "/fibonacci")
    world.base_nodes.at_end(client.destroy)
    eventually("the service crosses", client.server_is_ready)
    return client


def test_a_restarted_end_fails_calls_and_serves_again(world, eventually):
    """A call that was under way with an end that restarted fails and does not run again; the next one is answered."""
    requests, _ = silent_server(
        world.robot_nodes.idle_node("camera"), "sensor_msgs/srv/SetCameraInfo", "/set_camera_info"
    )
    doubler = Doubler(world.robot_nodes.node("calculator"))
    world.relay()
    client = world.base_nodes.client(SetCameraInfo, "/set_camera_info")
    eventually("the service crosses", client.service_is_ready)
    future = client.call_async(SetCameraInfo.Request())
    eventually("the call reaches its server", lambda: requests)
    world.restart_robot()
    assert "restarted" in finished(eventually, future).status_message
    other = world.base_nodes.client(BasicTypes, "/double")
    eventually("the service crosses", other.service_is_ready)
    assert finished(eventually, other.call_async(BasicTypes.Request(int32_value=4))).int32_value == 8
    assert (len(requests), doubler.runs) == (1, [4])
    assert world.base.calls.failures == {"restarted": 1}


def test_a_service_that_both_sides_serve_is_refused(world, eventually):
    """The server on the own side answers; without it, calls cross the link."""
    far = Doubler(world.robot_nodes.node("far"))
    near = Doubler(world.other_base_nodes().node("near"))
    world.relay()
    eventually("both ends refuse it", lambda: all("/double" in end.calls.refused for end in (world.base, world.robot)))
    client = world.base_nodes.client(BasicTypes, "/double")
    eventually("the service crosses", client.service_is_ready)
    finished(eventually, client.call_async(BasicTypes.Request(int32_value=1)))
    near.node.destroy_service(near.service)
    eventually("it is refused no more", lambda: not world.base.calls.refused)
    eventually("the service crosses", client.service_is_ready)
    finished(eventually, client.call_async(BasicTypes.Request(int32_value=2)))
    assert (near.runs, far.runs) == ([1], [2])


def test_a_type_that_is_not_installed_here_is_named(world, eventually, monkeypatch):
    """A service whose type is missing on the calling side is refused, and the others go on."""
    monkeypatch.setattr(services_module, "service_class", missing)
    Doubler(world.robot_nodes.node("calculator"))
    world.robot_nodes.node("empty").create_service(Empty, "/empty", lambda _request, response: response)
    world.relay()
    client = world.base_nodes.client(BasicTypes, "/double")
    eventually("the service crosses", client.service_is_ready)
    eventually("the other one is named", lambda: "not installed" in world.base.calls.refused.get("/empty", ""))
    assert set(world.base.calls.refused) == {"/empty"}


def missing(type_name):
    if type_name == "test_msgs/srv/Empty":
        raise UnknownTypeError(f"{type_name} is not installed here")
    return service_class(type_name)
