"""Services and actions across the link with real rclpy: two domains in one process, and a link that loses records."""

import random
import threading
import time
from contextlib import ExitStack

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("test_msgs", reason="test_msgs is not installed")

import rclpy
from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.node import NodeNameNonExistentError
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosidl_generator_py.import_type_support_impl import UnsupportedTypeSupport
from sensor_msgs.srv import SetCameraInfo
from test_msgs.action import Fibonacci
from test_msgs.srv import BasicTypes, Empty

from arpd.adapters.ros.ends import calls as calls_module
from arpd.adapters.ros.ends import served_calls as served_calls_module
from arpd.adapters.ros.ends.calls import Calls
from arpd.adapters.ros.ends.ghost_service import GhostService, failed_response
from arpd.adapters.ros.ends.served_calls import ServedCalls
from arpd.adapters.ros.ends.types import UnknownTypeError, message_class, service_class
from arpd.adapters.ros.runtime import prepare_environment, spinning
from arpd.apply.relay.call_records import Answer, FailureReason, Record, Request, encode_record
from arpd.apply.relay.offers import ServiceOffer
from tests.chaos.world import free_domain
from tests.ros.domain import DOMAIN

pytestmark = pytest.mark.ros

BOTH_EXECUTORS = pytest.mark.parametrize("executor", [SingleThreadedExecutor, EventsExecutor])
STATE_S = 0.1


class End:
    """One end of the relay: its participant in a local domain, and the thread of its executor."""

    def __init__(self, name, domain, executor, *, allows=lambda _name: True, timeout_s=20.0, namespace=""):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.session = f"{name}-{random.randrange(10**9)}"
        self.inbox = []
        self.offered = {}
        self.other = None
        self.is_reachable = True
        self.loss = 0.0
        self.turns = 0
        self.ahead_s = 0.0  # of the monotonic clock
        self._random = random.Random(1)
        self._nodes = {}
        self._executor = executor(context=self.context)
        self._stopping = threading.Event()
        self.node = self.ghost_node(f"/arpd_{name}", enable_rosout=False)
        self.calls = Calls(
            self.node,
            send=self.send,
            ghost_node=self.ghost_node,
            allows=lambda name: not name.endswith("/get_type_description") and allows(name),
            timeout_s=timeout_s,
            session=self.session,
            namespace=namespace,
            clock=self.now_s,
        )
        self._thread = threading.Thread(target=self._work, daemon=True)

    def now_s(self):
        return time.monotonic() + self.ahead_s

    def start(self, other):
        self.other = other
        self._thread.start()

    def stop(self):
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(timeout=10)
        self.calls.destroy()
        for node in self._nodes.values():
            node.destroy_node()
        self._executor.shutdown()
        rclpy.try_shutdown(context=self.context)

    def ghost_node(self, name, **options):
        if name not in self._nodes:
            namespace, _, base = name.rpartition("/")
            node = rclpy.create_node(
                base, namespace=namespace or "/", context=self.context, start_parameter_services=False, **options
            )
            self._executor.add_node(node)
            self._nodes[name] = node
        return self._nodes[name]

    def send(self, data):
        """Write to the link, which loses, doubles and reorders."""
        if not self.is_reachable:
            return
        for _ in range(1 + (self._random.random() < self.loss)):
            if self._random.random() >= self.loss:
                inbox = self.other.inbox
                inbox.insert(self._random.randrange(len(inbox) + 1) if self.loss else len(inbox), data)

    def _work(self):
        next_state_s = 0.0
        while not self._stopping.is_set():
            now_s = self.now_s()
            if now_s >= next_state_s:
                next_state_s = now_s + STATE_S
                self.offered = self.calls.offers()
                other = self.other if self.is_reachable else None
                self.calls.follow(other.offered if other else {}, session=other.session if other else None)
            while self.inbox:
                self.calls.receive(self.inbox.pop(0))
            self.calls.step(now_s)
            self._executor.spin_once(timeout_sec=0.02)
            self.turns += 1


class Side:
    """Nodes of the application in one domain, each with an executor of its own."""

    def __init__(self, domain, stack):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        stack.callback(rclpy.try_shutdown, context=self.context)
        self._stack = stack

    def node(self, name, executor=None, **options):
        node = rclpy.create_node(
            name, context=self.context, start_parameter_services=False, enable_rosout=False, **options
        )
        self._stack.callback(node.destroy_node)
        executor = executor or SingleThreadedExecutor(context=self.context)
        executor.add_node(node)
        self._stack.enter_context(spinning(executor))
        return node

    def client(self, kind, name):
        return self.node("user").create_client(kind, name)


class World:
    """A robot and a CEDDP, the relay between them, and nodes on either side."""

    def __init__(self, domains, stack):
        self._domains = domains
        self._stack = stack
        self.robot_nodes, self.ceddp_nodes = (Side(domain, stack) for domain in domains)
        self.robot = self.ceddp = None

    def relay(self, executor=EventsExecutor, *, namespace="", **options):
        self.robot = End("robot", self._domains[0], executor, **options)
        self.ceddp = End("ceddp", self._domains[1], executor, namespace=namespace, **options)
        for end, other in ((self.robot, self.ceddp), (self.ceddp, self.robot)):
            self._stack.callback(end.stop)
            end.start(other)

    def other_robot_nodes(self):
        """Return another participant: one has only one type for one name."""
        return Side(self._domains[0], self._stack)

    def other_ceddp_nodes(self):
        return Side(self._domains[1], self._stack)

    def restart_robot(self):
        self.robot.stop()
        self.robot = End("robot", self._domains[0], EventsExecutor)
        self._stack.callback(self.robot.stop)
        self.robot.start(self.ceddp)
        self.ceddp.other = self.robot

    def lose(self, share):
        self.robot.loss = self.ceddp.loss = share

    def pass_time(self, seconds):
        """Let both ends' clocks jump ahead."""
        for end in (self.robot, self.ceddp):
            end.ahead_s += seconds

    def cut(self):
        self.robot.is_reachable = self.ceddp.is_reachable = False

    def mend(self):
        self.robot.is_reachable = self.ceddp.is_reachable = True


@pytest.fixture(scope="module")
def domains():
    """Return this worker's domain, and one that nobody uses: DOMAIN + 46 may belong to tests/chaos."""
    return DOMAIN, free_domain()


@pytest.fixture
def world(monkeypatch, domains):
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    prepare_environment()
    with ExitStack() as stack:
        yield World(domains, stack)


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


def silent_server(node, kind, name):
    """Serve a service that never answers; returns the requests and the server."""
    requests = []
    return requests, GhostService(node, kind, name, on_request=lambda request, _header: requests.append(request))


def finished(eventually, future, timeout_s=20.0):
    eventually(future.done, timeout_s)
    return future.result()


@BOTH_EXECUTORS
def test_a_service_is_called_across_a_bad_link(world, eventually, executor):
    """Each of many calls at once gets its own answer, and runs once, although every third record is lost."""
    doubler = Doubler(world.robot_nodes.node("calculator", namespace="/tools"))
    world.relay(executor)
    client = world.ceddp_nodes.client(BasicTypes, "/double")
    eventually(client.service_is_ready)
    looker = world.ceddp_nodes.node("looker")
    eventually(lambda: serves(looker, "/tools/calculator", "/double"))
    world.lose(0.3)
    for first in (0, 8, 16):  # a client of ROS has room for ten responses
        futures = [client.call_async(BasicTypes.Request(int32_value=first + number)) for number in range(8)]
        answers = [finished(eventually, future).int32_value for future in futures]
        assert answers == [2 * (first + number) for number in range(8)]
    assert sorted(doubler.runs) == list(range(24))
    world.lose(0.0)
    eventually(lambda: world.ceddp.calls.under_way == world.robot.calls.under_way[::-1] == (0, 0))
    assert not world.ceddp.calls.failures
    assert not world.ceddp.offered  # its own ghost is no service of its side


def serves(node, name, service):
    """Return whether the graph shows a node with this name and service, as another node sees it."""
    namespace, _, base = name.rpartition("/")
    try:
        return service in dict(node.get_service_names_and_types_by_node(base, namespace or "/"))
    except NodeNameNonExistentError:
        return False


@BOTH_EXECUTORS
def test_a_call_under_way_leaves_the_processor_alone(world, eventually, executor):
    """While a call waits for its answer, other calls go on, and neither executor turns in a circle."""
    requests, _ = silent_server(world.robot_nodes.node("slow"), BasicTypes, "/slow")
    Doubler(world.robot_nodes.node("calculator"))
    world.relay(executor)
    slow, fast = world.ceddp_nodes.client(BasicTypes, "/slow"), world.ceddp_nodes.client(BasicTypes, "/double")
    eventually(lambda: slow.service_is_ready() and fast.service_is_ready())
    slow.call_async(BasicTypes.Request())
    eventually(lambda: requests)
    assert finished(eventually, fast.call_async(BasicTypes.Request(int32_value=4))).int32_value == 8
    turns = world.ceddp.turns
    time.sleep(2.0)
    assert world.ceddp.turns - turns < 400  # 100 at 0.02 s each


def test_calls_go_in_both_directions(world, eventually):
    """A node on the robot calls a service of the CEDDP as well."""
    doubler = Doubler(world.ceddp_nodes.node("calculator"))
    world.relay()
    client = world.robot_nodes.client(BasicTypes, "/double")
    eventually(client.service_is_ready)
    assert finished(eventually, client.call_async(BasicTypes.Request(int32_value=7))).int32_value == 14
    assert doubler.runs == [7]


def test_names_on_the_ceddp_have_the_namespace(world, eventually):
    """The robot's services are under the namespace, the CEDDP's own ones cross without it, and others do not cross."""
    up = Doubler(world.robot_nodes.node("calculator"), "/double")
    down = Doubler(world.ceddp_nodes.node("planner", namespace="/spot"), "/spot/plan")
    Doubler(world.ceddp_nodes.node("alien"), "/alien")
    world.relay(namespace="/spot")
    to_robot, to_ceddp = (
        world.ceddp_nodes.client(BasicTypes, "/spot/double"),
        world.robot_nodes.client(BasicTypes, "/plan"),
    )
    eventually(lambda: to_robot.service_is_ready() and to_ceddp.service_is_ready())
    finished(eventually, to_robot.call_async(BasicTypes.Request(int32_value=1)))
    finished(eventually, to_ceddp.call_async(BasicTypes.Request(int32_value=2)))
    assert (up.runs, down.runs) == ([1], [2])
    here, there = world.ceddp_nodes.node("looker"), world.robot_nodes.node("looker")
    eventually(lambda: serves(here, "/spot/calculator", "/spot/double"))
    eventually(lambda: serves(there, "/planner", "/plan"))
    assert set(world.ceddp.offered) == {"/plan"}


def test_only_allowed_services_cross(world, eventually):
    """A service that the configuration does not name is neither offered nor called."""
    Doubler(world.robot_nodes.node("calculator"), "/double")
    secret = Doubler(world.robot_nodes.node("safe"), "/secret")
    world.relay(allows=lambda name: name == "/double")
    client = world.ceddp_nodes.client(BasicTypes, "/double")
    eventually(client.service_is_ready)
    assert set(world.robot.offered) == {"/double"}
    answers = forged_call(world, "/secret")
    eventually(lambda: answers)
    assert answers[0].reason is FailureReason.NO_SERVER
    assert not secret.runs


def forged_call(world, service, type_name="test_msgs/srv/BasicTypes", body=b""):
    """Call from the CEDDP what its own end would not call; returns the outcomes."""
    outcomes = []
    request = Request(service=service, type_name=type_name, body=body or serialize_message(BasicTypes.Request()))
    caller = world.ceddp.calls._caller
    caller.call(request, timeout_s=10.0, now_s=time.monotonic(), on_end=outcomes.append)
    return outcomes


@BOTH_EXECUTORS
def test_an_action_crosses_a_bad_link(world, eventually, executor):
    """An action client gets acceptance, feedback and result of a server on the other side."""
    serve_fibonacci(world.robot_nodes)
    world.relay(executor)
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
    eventually(lambda: feedback)
    assert handle.status == GoalStatus.STATUS_SUCCEEDED


def test_an_action_is_cancelled_across_the_link(world, eventually):
    """Cancelling a goal reaches the server, and the result says so; it comes long after the time-out of calls."""
    serve_fibonacci(world.robot_nodes, step_s=0.2)
    world.relay(timeout_s=20.0)
    client = action_client(world, eventually)
    handle = finished(eventually, client.send_goal_async(Fibonacci.Goal(order=1000)))
    result = handle.get_result_async()
    eventually(lambda: world.ceddp.calls.under_way == (1, 0) and world.robot.calls.under_way == (0, 1))
    world.pass_time(30.0)
    turns = world.ceddp.turns
    eventually(lambda: world.ceddp.turns > turns + 10)
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

    return ActionServer(
        node,
        Fibonacci,
        "/fibonacci",
        execute,
        cancel_callback=lambda _goal: CancelResponse.ACCEPT,
        callback_group=ReentrantCallbackGroup(),
    )


def action_client(world, eventually):
    """Return a client on the CEDDP that sees the whole action; its two topics are carried by the test itself."""
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    carrier, math = world.robot_nodes.node("carrier"), world.ceddp_nodes.node("math_topics")
    for part, qos, type_name in (
        ("feedback", 10, "test_msgs/action/Fibonacci_FeedbackMessage"),
        ("status", latched, "action_msgs/msg/GoalStatusArray"),
    ):
        kind = message_class(type_name)
        publisher = math.create_publisher(kind, f"/fibonacci/_action/{part}", qos)
        carrier.create_subscription(kind, f"/fibonacci/_action/{part}", publisher.publish, qos, raw=True)
    client = ActionClient(world.ceddp_nodes.node("user"), Fibonacci, "/fibonacci")
    eventually(client.server_is_ready)
    return client


def test_a_call_without_an_answer_times_out(world, eventually, caplog):
    """A call fails after its time, with a response where the type can say so, and the serving end forgets it."""
    requests, _ = silent_server(world.robot_nodes.node("camera"), SetCameraInfo, "/set_camera_info")
    others, _ = silent_server(world.robot_nodes.node("other"), BasicTypes, "/other")
    world.relay(timeout_s=20.0)
    client, mute = (
        world.ceddp_nodes.client(SetCameraInfo, "/set_camera_info"),
        world.ceddp_nodes.client(BasicTypes, "/other"),
    )
    eventually(lambda: client.service_is_ready() and mute.service_is_ready())
    silent, asked = mute.call_async(BasicTypes.Request()), client.call_async(SetCameraInfo.Request())
    eventually(lambda: len(requests) == len(others) == 1)
    world.pass_time(25.0)
    response = finished(eventually, asked)
    assert not response.success
    assert "no answer within 20 s" in response.status_message
    eventually(lambda: world.ceddp.calls.failures == {"timeout": 2})
    eventually(lambda: world.robot.calls.under_way == (0, 0))  # the robot's end does not wait for ever
    assert not silent.done()
    again = client.call_async(SetCameraInfo.Request())
    eventually(lambda: len(requests) == 2)
    world.pass_time(25.0)
    finished(eventually, again)
    assert world.ceddp.calls.failures == {"timeout": 3}
    assert (len(requests), len(others)) == (2, 1)
    assert sum("/set_camera_info failed" in line for line in caplog.messages) == 1  # once a minute


def test_an_unreachable_end_fails_calls_and_takes_its_services(world, eventually):
    """When the link is cut, calls fail at once, clients see that the service is not there, and it returns with it."""
    requests, _ = silent_server(world.robot_nodes.node("camera"), SetCameraInfo, "/set_camera_info")
    doubler = Doubler(world.robot_nodes.node("calculator"))
    world.relay()
    client, other = (
        world.ceddp_nodes.client(SetCameraInfo, "/set_camera_info"),
        world.ceddp_nodes.client(BasicTypes, "/double"),
    )
    eventually(lambda: client.service_is_ready() and other.service_is_ready())
    future = client.call_async(SetCameraInfo.Request())
    eventually(lambda: requests)
    world.cut()
    assert "unreachable" in finished(eventually, future, 3.0).status_message
    assert world.ceddp.calls.failures == {"unreachable": 1}
    eventually(lambda: not client.service_is_ready() and not other.service_is_ready())
    world.mend()
    eventually(other.service_is_ready)
    assert finished(eventually, other.call_async(BasicTypes.Request(int32_value=4))).int32_value == 8
    assert doubler.runs == [4]
    assert len(requests) == 1


def test_a_restarted_end_fails_calls_and_serves_again(world, eventually):
    """A call that was under way with an end that restarted fails and does not run again; the next one is answered."""
    requests, _ = silent_server(world.robot_nodes.node("camera"), SetCameraInfo, "/set_camera_info")
    doubler = Doubler(world.robot_nodes.node("calculator"))
    world.relay()
    client = world.ceddp_nodes.client(SetCameraInfo, "/set_camera_info")
    eventually(client.service_is_ready)
    future = client.call_async(SetCameraInfo.Request())
    eventually(lambda: requests)
    world.restart_robot()
    assert "restarted" in finished(eventually, future).status_message
    other = world.ceddp_nodes.client(BasicTypes, "/double")
    eventually(other.service_is_ready)
    assert finished(eventually, other.call_async(BasicTypes.Request(int32_value=4))).int32_value == 8
    assert (len(requests), doubler.runs) == (1, [4])
    assert world.ceddp.calls.failures == {"restarted": 1}


def test_a_service_that_both_sides_serve_is_refused(world, eventually, caplog):
    """The server on the own side answers; without it, calls cross the link."""
    far = Doubler(world.robot_nodes.node("far"))
    near = Doubler(world.other_ceddp_nodes().node("near"))
    world.relay()
    eventually(lambda: "/double" in world.ceddp.calls.refused and "/double" in world.robot.calls.refused)
    client = world.ceddp_nodes.client(BasicTypes, "/double")
    eventually(client.service_is_ready)
    finished(eventually, client.call_async(BasicTypes.Request(int32_value=1)))
    time.sleep(5 * STATE_S)
    assert sum("/double" in line for line in caplog.messages) == 2  # once for each end
    near.node.destroy_service(near.service)
    eventually(lambda: not world.ceddp.calls.refused)
    eventually(client.service_is_ready)
    finished(eventually, client.call_async(BasicTypes.Request(int32_value=2)))
    assert (near.runs, far.runs) == ([1], [2])


def test_a_server_that_appears_beside_its_ghost_takes_over(world, eventually):
    """A ghost goes when a node on its side begins to serve the same name."""
    far = Doubler(world.robot_nodes.node("far"))
    world.relay()
    client = world.ceddp_nodes.client(BasicTypes, "/double")
    eventually(client.service_is_ready)
    near = Doubler(world.other_ceddp_nodes().node("near"))
    eventually(lambda: "/double" in world.ceddp.calls.refused and client.service_is_ready())
    eventually(lambda: world.ceddp_nodes.node("count").count_services("/double") == 1)
    finished(eventually, client.call_async(BasicTypes.Request(int32_value=1)))
    assert (near.runs, far.runs) == ([1], [])


def test_a_type_that_is_not_installed_here_is_named(world, eventually, monkeypatch):
    """A service whose type is missing on the calling side is refused, and the others go on."""
    monkeypatch.setattr(calls_module, "service_class", missing)
    Doubler(world.robot_nodes.node("calculator"))
    world.robot_nodes.node("empty").create_service(Empty, "/empty", lambda _request, response: response)
    world.relay()
    client = world.ceddp_nodes.client(BasicTypes, "/double")
    eventually(client.service_is_ready)
    eventually(lambda: world.ceddp.calls.refused == {"/empty": "test_msgs/srv/Empty is not installed here"})


def missing(type_name):
    if type_name == "test_msgs/srv/Empty":
        raise UnknownTypeError(f"{type_name} is not installed here")
    return service_class(type_name)


def test_a_type_that_is_not_installed_there_fails(world, eventually, monkeypatch):
    """A call whose type is missing on the serving side fails at once."""
    monkeypatch.setattr(served_calls_module, "service_class", missing)
    world.robot_nodes.node("empty").create_service(Empty, "/empty", lambda _request, response: response)
    world.relay()
    client = world.ceddp_nodes.client(Empty, "/empty")
    eventually(client.service_is_ready)
    client.call_async(Empty.Request())
    eventually(lambda: world.ceddp.calls.failures == {"type": 1})


def test_what_is_no_name_of_ros_is_refused(world):
    """Names that the middleware would not take are refused, and stop nothing."""
    alone = End("alone", DOMAIN, SingleThreadedExecutor)
    bad = {
        "/no name": ServiceOffer(type_name="test_msgs/srv/Empty", node="/node"),
        "relative": ServiceOffer(type_name="test_msgs/srv/Empty", node="/node"),
        "/bad_node": ServiceOffer(type_name="test_msgs/srv/Empty", node="/no node"),
        "/bad_type": ServiceOffer(type_name="nonsense", node="/node"),
    }
    alone.calls.follow(bad | {"/good": ServiceOffer(type_name="test_msgs/srv/Empty", node="/node")}, session="other")
    assert set(alone.calls.refused) == set(bad)
    assert set(alone.calls._ghosts) == {"/good"}
    alone.calls.follow({}, session="other")
    assert not alone.calls.refused
    assert not alone.calls._ghosts
    alone.stop()


def test_what_cannot_be_read_fails(world, eventually):
    """A request that is no message or one of another type, and a record that is none, stop nothing."""
    doubler = Doubler(world.robot_nodes.node("calculator"))
    world.relay()
    client = world.ceddp_nodes.client(BasicTypes, "/double")
    eventually(client.service_is_ready)
    world.robot.inbox.append(b"no record")
    eventually(lambda: world.robot.calls.malformed == 1)
    outcomes = forged_call(world, "/double", body=b"\0\1\0\0")
    others = forged_call(world, "/double", type_name="test_msgs/srv/Empty")
    eventually(lambda: outcomes and others)
    assert {outcomes[0].reason, others[0].reason} == {FailureReason.TYPE}
    world.ceddp.inbox.append(encode_record(stray_answer(world)))
    assert finished(eventually, client.call_async(BasicTypes.Request(int32_value=4))).int32_value == 8
    assert doubler.runs == [4]


def stray_answer(world):
    return Record(caller=world.ceddp.session, callee=world.robot.session, number=99, content=Answer(body=b"of no call"))


def test_an_answer_that_cannot_be_read_fails(world, eventually, monkeypatch):
    """A response that is no message of the type is a failure of the call."""
    monkeypatch.setattr(served_calls_module, "serialize_message", lambda _message: b"\0\1\0\0")
    world.robot_nodes.node("camera").create_service(SetCameraInfo, "/set", lambda _request, response: response)
    world.relay()
    client = world.ceddp_nodes.client(SetCameraInfo, "/set")
    eventually(client.service_is_ready)
    response = finished(eventually, client.call_async(SetCameraInfo.Request()))
    assert "cannot be read" in response.status_message
    assert world.ceddp.calls.failures == {"type": 1}


def test_a_server_that_goes_fails_its_calls(world, eventually):
    """When the server of a call under way is gone, the caller need not wait for the time-out."""
    requests, server = silent_server(world.robot_nodes.node("camera"), SetCameraInfo, "/set_camera_info")
    world.relay()
    client = world.ceddp_nodes.client(SetCameraInfo, "/set_camera_info")
    eventually(client.service_is_ready)
    future = client.call_async(SetCameraInfo.Request())
    eventually(lambda: requests)
    server.destroy()
    assert not finished(eventually, future, 5.0).success
    assert world.ceddp.calls.failures == {"no_server": 1}
    eventually(lambda: not client.service_is_ready())


def test_a_service_without_a_server_fails(world, eventually):
    """A request for a service whose server has gone fails without waiting for the time-out."""
    world.relay()
    eventually(lambda: world.robot.calls._caller._callee is not None)
    eventually(lambda: world.ceddp.calls._caller._callee is not None)
    outcomes = forged_call(world, "/nothing")
    eventually(lambda: outcomes, 5.0)
    assert outcomes[0].reason is FailureReason.NO_SERVER


def test_a_server_on_another_node_gets_its_ghost_there(world, eventually, caplog):
    """A server that returns on a node of another name and with another type is offered with both."""
    first = Doubler(world.robot_nodes.node("first"))
    world.relay()
    eventually(lambda: world.ceddp_nodes.node("count").count_services("/double") == 1)
    first_client = world.ceddp_nodes.client(BasicTypes, "/double")
    eventually(first_client.service_is_ready)
    finished(eventually, first_client.call_async(BasicTypes.Request()))
    first.node.destroy_service(first.service)
    world.other_robot_nodes().node("second").create_service(Empty, "/double", lambda _request, response: response)
    client = world.other_ceddp_nodes().client(Empty, "/double")
    eventually(lambda: is_served_by(world, "second"))
    eventually(client.service_is_ready)
    finished(eventually, client.call_async(Empty.Request()))
    assert not [line for line in caplog.messages if "cannot be called" in line]


def is_served_by(world, node):
    return world.ceddp.calls._ghosts.get("/double") is not None and (
        world.ceddp.calls._ghosts["/double"].offer.node == f"/{node}"
    )


@pytest.mark.parametrize(
    ("type_name", "reason", "fields"),
    [
        (
            "sensor_msgs/srv/SetCameraInfo",
            FailureReason.TIMEOUT,
            {"success": False, "status_message": "arpd relay: why"},
        ),
        ("lifecycle_msgs/srv/ChangeState", FailureReason.TIMEOUT, {"success": False}),
        ("test_msgs/action/Fibonacci_SendGoal", FailureReason.TIMEOUT, {"accepted": False}),
        ("action_msgs/srv/CancelGoal", FailureReason.TIMEOUT, {"return_code": CancelGoal.Response.ERROR_REJECTED}),
        ("test_msgs/action/Fibonacci_GetResult", FailureReason.UNREACHABLE, {"status": GoalStatus.STATUS_UNKNOWN}),
        ("test_msgs/action/Fibonacci_GetResult", FailureReason.NO_SERVER, {"status": GoalStatus.STATUS_ABORTED}),
    ],
)
def test_a_failure_is_said_where_the_type_can(type_name, reason, fields):
    """Types with a field for it say that the call failed."""
    response = failed_response(service_class(type_name), type_name, reason=reason, message="why")
    assert {name: getattr(response, name) for name in fields} == fields


def test_a_type_that_cannot_say_it_gets_no_response():
    """A response with invented values would be worse than none."""
    assert failed_response(BasicTypes, "test_msgs/srv/BasicTypes", reason=FailureReason.TIMEOUT, message="why") is None


@pytest.mark.parametrize(
    ("importer", "name"),
    [
        (service_class, "no_such_msgs/srv/Thing"),
        (service_class, "test_msgs/srv/Thing"),
        (service_class, "test_msgs/action/Thing_SendGoal"),
        (service_class, "test_msgs/action/Fibonacci_FeedbackMessage"),
        (service_class, "std_msgs/msg/String"),
        (service_class, "../srv/String"),
        (service_class, "nonsense"),
        (message_class, "test_msgs/action/Fibonacci_SendGoal"),
        (message_class, "test_msgs/srv/Empty"),
    ],
)
def test_a_name_of_no_such_type_is_refused(importer, name):
    """A type that is missing, or is none of this kind, is named."""
    with pytest.raises(UnknownTypeError, match=name):
        importer(name)


def test_a_type_without_its_libraries_is_refused(monkeypatch):
    """A message package that was built elsewhere, or half, is named before an endpoint needs it."""

    def fails(_metaclass):
        raise UnsupportedTypeSupport("test_msgs")

    monkeypatch.setattr(type(BasicTypes), "_TYPE_SUPPORT", None)
    monkeypatch.setattr(type(BasicTypes), "__import_type_support__", classmethod(fails))
    with pytest.raises(UnknownTypeError, match="libraries of test_msgs/srv/BasicTypes"):
        service_class("test_msgs/srv/BasicTypes")


class LateServer:
    """Stands for a node, its client and the future of the client: its server is there when a test says so."""

    def __init__(self):
        self.is_there, self.requests = True, []

    def create_client(self, *_args, **_options):
        return self

    def service_is_ready(self):
        return self.is_there

    def call_async(self, request):
        self.requests.append(request)
        return self

    def add_done_callback(self, _callback):
        """Never call it: nothing answers."""


def test_no_request_leaves_before_its_server_can_know_the_client():
    """A server drops a response for a client that it does not know yet, after a restart of the server, too."""
    node, now_s = LateServer(), 100.0
    served = ServedCalls(
        node,
        send=lambda _data: None,
        session="robot",
        offered=lambda name: (name, "test_msgs/srv/Empty"),
        clock=lambda: now_s,
    )
    served.follow("ceddp")
    body = bytes(serialize_message(Empty.Request()))

    def ask(number):
        request = Request(service="/empty", type_name="test_msgs/srv/Empty", body=body)
        served.receive(Record(caller="ceddp", callee="robot", number=number, oldest=1, content=request))

    def pass_time(seconds):
        nonlocal now_s
        now_s += seconds
        served.step(now_s)
        return len(node.requests)

    ask(1)
    assert (pass_time(0.2), pass_time(0.2)) == (0, 1)
    ask(2)
    assert len(node.requests) == 2
    node.is_there = False
    pass_time(0.1)
    node.is_there = True
    pass_time(0.1)
    ask(3)
    assert (pass_time(0.1), pass_time(0.3)) == (2, 3)
