"""Services and actions across the link with real rclpy: two ends, each in a domain of its own, and nodes on both."""

import platform
import signal
import time
from dataclasses import replace

import pytest
from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import NodeNameNonExistentError
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Float64MultiArray, String, UInt8MultiArray
from test_msgs.action import Fibonacci
from test_msgs.srv import BasicTypes

from arpd.model.plan import TopicPlan
from arpd.relay.calls import CallBook, Kind, Record
from arpd.relay.ends.offers import ServiceOffer
from arpd.relay.ends.services import GhostServer, LocalClient
from arpd.relay.envelope import decode_chunk
from arpd.ros.cdr import wrap
from arpd.ros.names import PRICE_TOPIC
from arpd.ros.price_message import encode_price
from arpd.ros.raw_reader import ReadingThread
from tests.ros.ends_world import RELIABLE, Stranger, listen
from tests.ros.world import FREE, TERMS, Announced, Plans, costing


class Doubler:
    """Counts its calls, and answers with twice the number."""

    def __init__(self, node, name="/double"):
        self.node, self.runs = node, []
        self.service = node.create_service(BasicTypes, name, self._answer)

    def _answer(self, request, response):
        self.runs.append(request.int32_value)
        response.int32_value = 2 * request.int32_value
        return response


def silent_server(ends, side, name="/set_camera_info"):
    """Serve a service that never answers: nobody spins its node."""
    node = ends.side(side).idle_node(f"camera{name.replace('/', '_')}")
    return node, node.create_service(SetCameraInfo, name, lambda _request, response: response)


def doubled(client, number, eventually):
    return finished(eventually, client.call_async(BasicTypes.Request(int32_value=number))).int32_value


def finished(eventually, future):
    eventually("the call ends", future.done)
    return future.result()


def serves(node, name, service):
    """Return whether the graph shows a node with this name and service, as another node sees it."""
    namespace, _, base = name.rpartition("/")
    try:
        return service in dict(node.get_service_names_and_types_by_node(base, namespace or "/"))
    except NodeNameNonExistentError:
        return False


def test_calls_get_their_own_answers_and_delay_no_other(world, eventually):
    """Many calls at once run once each while another one waits, which fails when its server is gone, and says so."""
    ends = world("services: [/**]").start()
    doubler = Doubler(ends.side("robot").node("calculator", namespace="/tools"))
    camera, server = silent_server(ends, "robot")
    user = ends.side("base").node("user")
    slow, fast = (
        user.create_client(kind, f"/{name}")
        for kind, name in ((SetCameraInfo, "set_camera_info"), (BasicTypes, "double"))
    )
    eventually("both services cross", lambda: slow.service_is_ready() and fast.service_is_ready())
    eventually("the ghost has its name", lambda: serves(user, "/tools/calculator", "/double"))
    waiting = slow.call_async(SetCameraInfo.Request())
    for first in (0, 8, 16):  # a client of ROS has room for ten responses
        futures = [fast.call_async(BasicTypes.Request(int32_value=first + number)) for number in range(8)]
        answers = [finished(eventually, future).int32_value for future in futures]
        assert answers == [2 * (first + number) for number in range(8)]
    assert sorted(doubler.runs) == list(range(24))
    assert not waiting.done()
    camera.destroy_service(server)
    assert "arpd relay" in finished(eventually, waiting).status_message


def test_a_small_call_waits_behind_no_large_one(world, eventually):
    """While a request of a megabyte crosses a slow link, another service is called and answers."""
    ends = world("services: [/**]", "call_timeout: 1h").start()
    Doubler(ends.side("robot").node("calculator"))
    camera = ends.side("robot").node("camera")
    camera.create_service(SetCameraInfo, "/set_camera_info", lambda _request, response: response)
    user, goals = ends.side("base").node("user"), listen(camera, "/goal", RELIABLE)
    slow, fast = user.create_client(SetCameraInfo, "/set_camera_info"), user.create_client(BasicTypes, "/double")
    eventually("both services cross", lambda: slow.service_is_ready() and fast.service_is_ready())
    goal = user.create_publisher(String, "/goal", 1)  # by a topic an end learns the price
    eventually("a topic crosses", lambda: goal.publish(String()) or goals)
    daemon = ends.side("link").node("daemon")
    told, prices = Announced(daemon), daemon.create_publisher(Float64MultiArray, PRICE_TOPIC, 1)
    row = TopicPlan(rate_hz=100.0, min_rate_hz=0.0, deadline_ns=0, depth=10, **TERMS)
    Plans(daemon)(1, {"/goal": row})
    slow_link = replace(costing(5.0), capacity_bytes_per_second=50e3, spare_share=0.5)  # a megabyte takes half a minute
    price = [slow_link]
    daemon.create_timer(0.1, lambda: prices.publish(Float64MultiArray(data=encode_price(price[0]))))
    rates_hz = [pytest.approx(slow_link.rate_hz(row))]
    eventually("the price is in force", lambda: [each.paced_rate_hz for each in told.states] == rates_hz)
    large = slow.call_async(SetCameraInfo.Request(camera_info=CameraInfo(d=[0.0] * 125_000)))
    time.sleep(1.0)  # without which the small ones might leave first
    assert [doubled(fast, number, eventually) for number in (1, 2)] == [2, 4]
    assert not large.done()
    price[0] = replace(FREE, spare_share=1.0)
    finished(eventually, large)


def test_only_allowed_services_cross(world, eventually):
    """A service that the configuration does not name does not cross, and the robot's are under the namespace."""
    ends = world("services: [/double, /plan]", "namespace: /spot").start()
    robot, base = ends.side("robot"), ends.side("base")
    up, _ = (Doubler(robot.node(name), f"/{name}") for name in ("double", "secret"))
    down = Doubler(base.node("planner", namespace="/spot"), "/spot/plan")
    Doubler(base.node("alien"), "/alien")
    far, near = base.node("user"), robot.node("user")
    to_robot, to_base = far.create_client(BasicTypes, "/spot/double"), near.create_client(BasicTypes, "/plan")
    eventually("both services cross", lambda: to_robot.service_is_ready() and to_base.service_is_ready())
    assert (doubled(to_robot, 1, eventually), doubled(to_base, 2, eventually)) == (2, 4)
    assert (up.runs, down.runs) == ([1], [2])
    eventually("the ghost has its name", lambda: serves(far, "/spot/double", "/spot/double"))
    assert "/spot/secret" not in dict(far.get_service_names_and_types())
    assert "/alien" not in dict(near.get_service_names_and_types())


def test_an_end_serves_nothing_that_it_does_not_offer(world, eventually):
    """A request for a service that is not allowed, from an end that asks for it all the same, never runs."""
    ends = world("services: [/double]").start("robot")
    secret = Doubler(ends.side("robot").node("safe"), "/secret")
    stranger = Stranger(ends.side("link").node("stranger"))
    calls = stranger.node.create_publisher(UInt8MultiArray, "/arpd/relay/base/calls", RELIABLE)
    heard = listen(stranger.node, "/arpd/relay/robot/calls", RELIABLE, UInt8MultiArray)

    def is_refused():
        stranger.live()
        if (state := stranger.offered) is not None:
            body = b"/secret\0test_msgs/srv/BasicTypes\0" + bytes(serialize_message(BasicTypes.Request()))
            stranger.send(calls, Record(Kind.REQUEST, state.session, 1, body).encode())
        records = [Record.decode(decode_chunk(wrap(bytes(data))).part) for data in heard]
        return any(record.kind is Kind.FAILURE and record.body.startswith(b"no_server") for record in records)

    eventually("the call is refused", is_refused)
    assert not secret.runs


def test_an_action_is_cancelled_across_the_link(world, eventually):
    """An action is accepted, gives feedback and is cancelled; its result comes long after the time-out of calls.

    It comes after an outage, too, in which nobody can send a goal.
    """
    ends = world("actions: [/fibonacci]", "call_timeout: 5s").start()
    server = fibonacci(ends.side("robot"))
    client, feedback = ActionClient(ends.side("base").node("user"), Fibonacci, "/fibonacci"), []
    for each in (server, client):
        ends.nodes.callback(each.destroy)  # rclpy destroys no action with its node
    eventually("the action crosses", client.server_is_ready)
    handle = finished(eventually, client.send_goal_async(Fibonacci.Goal(order=1000), feedback.append))
    assert handle.accepted
    result = handle.get_result_async()
    eventually("six seconds have passed", lambda: feedback and len(feedback[-1].feedback.sequence) > 32)
    ends.processes["robot"].send_signal(signal.SIGSTOP)
    eventually("an outage is seen", lambda: not client.server_is_ready())
    ends.processes["robot"].send_signal(signal.SIGCONT)
    eventually("the action crosses again", client.server_is_ready)
    assert not result.done()
    cancelled = finished(eventually, handle.cancel_goal_async())
    assert cancelled.return_code == CancelGoal.Response.ERROR_NONE
    assert finished(eventually, result).status == GoalStatus.STATUS_CANCELED


def fibonacci(side):
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
            time.sleep(0.2)
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


def test_a_restarted_end_fails_calls_and_serves_again(world, eventually):
    """A call that was under way with an end that was killed fails and says so; the next one is answered."""
    ends = world("services: [/**]").start()
    silent_server(ends, "robot")
    doubler = Doubler(ends.side("robot").node("calculator"))
    user = ends.side("base").node("user")
    client, other = user.create_client(SetCameraInfo, "/set_camera_info"), user.create_client(BasicTypes, "/double")
    eventually("both services cross", lambda: client.service_is_ready() and other.service_is_ready())
    future = client.call_async(SetCameraInfo.Request())
    assert doubled(other, 3, eventually) == 6  # so the first one has arrived, too
    ends.end("robot")
    ends.start("robot")
    assert "arpd relay: the other end" in finished(eventually, future).status_message
    answers = []

    def is_answered():  # one that is asked for while its ghost goes has no answer
        answers.append(other.call_async(BasicTypes.Request(int32_value=4)))
        return any(answer.done() for answer in answers)

    eventually("a call is answered again", is_answered)
    assert doubler.runs.count(3) == 1


def test_calls_of_an_end_that_goes_fail(world, eventually):
    """Every caller hears that its end stops, and no service is there then; else it would wait for ever."""
    ends = world("services: [/**]").start()
    servers = [silent_server(ends, "robot", f"/camera_{number}") for number in range(8)]
    Doubler(ends.side("robot").node("calculator"))
    user = ends.side("base").node("user")
    clients = [user.create_client(SetCameraInfo, server.srv_name) for _, server in servers]
    other = user.create_client(BasicTypes, "/double")
    for client in (*clients, other):
        eventually("its service crosses", client.service_is_ready)
    futures = [client.call_async(SetCameraInfo.Request()) for client in clients]
    assert doubled(other, 3, eventually) == 6  # so those before it have arrived, too
    ends.end("base", signal.SIGTERM)
    words = "arpd relay: this end of the relay stops; the call may have run"
    assert {finished(eventually, future).status_message for future in futures} == {words}
    for client in clients:
        eventually("its service is there no more", lambda client=client: not client.service_is_ready())


def test_a_service_that_both_sides_serve_is_refused(world, eventually):
    """The server on the own side answers; without it, calls cross the link."""
    ends = world("services: [/double]").start()
    far = Doubler(ends.side("robot").node("far"))
    near = Doubler(ends.side("base").node("near"))
    words = f"refused /double: on {platform.node()}: a node on this side serves it, too"
    eventually("an end refuses it", lambda: any(words in status for status in ends.status.values()))
    client = ends.side("base").node("user").create_client(BasicTypes, "/double")
    eventually("it is served", client.service_is_ready)
    assert doubled(client, 1, eventually) == 2
    near.node.destroy_service(near.service)
    eventually("it is refused no more", lambda: words not in "".join(ends.status.values()))
    eventually("the service crosses", client.service_is_ready)
    assert doubled(client, 2, eventually) == 4
    assert (near.runs, far.runs) == ([1], [2])


def test_clients_and_servers_that_went_leave_nothing_in_their_node(ros, stack):
    """Servers come and go for weeks, and rclpy's groups of callbacks forget nothing that was in them."""
    node, thread = ros.idle_node("end"), ReadingThread()
    stack.callback(thread.stop)
    before = len(node.default_callback_group.entities)
    book = CallBook(1, send=lambda _record, _source: None, run=lambda _call, _request: None)
    offer = ServiceOffer(type_name="test_msgs/srv/BasicTypes", node="/server")
    for _ in range(3):
        LocalClient(node, offer, "/double", thread, book).destroy()
        GhostServer(node, offer, BasicTypes, "/double", thread, on_request=print).destroy()
    assert len(node.default_callback_group.entities) == before
