"""Calls across the link: what says a failure, what cannot be called, when requests leave, and servers that go."""

import math
import sys
import time
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("test_msgs", reason="test_msgs is not installed")

from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from diagnostic_msgs.srv import AddDiagnostics
from rclpy.serialization import serialize_message
from test_msgs.srv import BasicTypes

from arpd.model.settings import RelaySettings
from arpd.relay.calls import CallFailure, FailureReason, Record
from arpd.relay.ends import calls as module
from arpd.relay.ends.offers import ServiceOffer
from arpd.relay.ends.services import GhostServer, LocalClient, failed_response
from arpd.relay.ends.types import UnknownTypeError, message_class, service_class
from arpd.relay.selection import Side


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
        ("test_msgs/srv/BasicTypes", FailureReason.TIMEOUT, None),
    ],
)
def test_a_failure_is_said_where_the_type_can(type_name, reason, fields):
    """Types with a field for it say that the call failed; of others a response would be invented, so there is none."""
    response = failed_response(service_class(type_name), type_name, CallFailure(reason, "why"))
    assert (response and {name: getattr(response, name) for name in fields}) == fields


class World(MagicMock):
    """Stands for a node and its client or server: a server that may come late, and a middleware that refuses some."""

    is_there = True
    refused = ()

    def create_client(self, *_args, **_options):
        return self

    create_service = create_client

    def service_is_ready(self):
        return self.is_there

    def send_request(self, request):
        self.send_response(request, None)
        return len(self.sent)

    def send_response(self, response, _header):
        self.sent.append(response.int32_value)
        if self.sent[-1] in self.refused:
            raise RuntimeError("no")


@pytest.fixture
def world():
    world = World()
    world.handle, world.sent = world, []
    return world


OFFER = ServiceOffer(type_name="test_msgs/srv/BasicTypes", node="/n")


@pytest.fixture
def client(world):
    """Make a client whose calls up to 100 are awaited; their outcomes are in ``ended``."""
    ended = {}
    book = SimpleNamespace(runs=lambda call: call <= 100, finish=ended.__setitem__)
    client = LocalClient(world, OFFER, "/double", MagicMock(), book)
    client.ended = ended
    return client


def request(number):
    return serialize_message(BasicTypes.Request(int32_value=number))


def test_no_request_leaves_before_its_server_can_know_the_client(world, client):
    """A server drops a response for a client that it does not know yet, after a restart of the server, too."""
    client.send(1, request(1))

    def sent_at(now_s):
        client.release(now_s)
        return world.sent

    assert [sent_at(now_s) for now_s in (100.0, 100.2)] == [[], []]
    world.is_there = False
    assert not sent_at(100.4)
    world.is_there = True
    assert [[*sent_at(now_s)] for now_s in (100.5, 100.7, 100.9)] == [[], [], [1]]


def test_requests_that_were_given_up_do_not_wait_for_a_server_that_never_matches(world, client):
    """Each would keep its bytes, and the thread awake, for as long as the service is offered."""
    world.is_there = False
    for number in (1, 200, 201):
        client.send(number, request(number))
    client.follow(frozenset())
    assert len(client._waiting) == 1
    client._waiting.clear()
    client.send(202, request(202))
    client.follow(frozenset())
    assert client.release(100.0) == math.inf


def test_requests_leave_five_at_a_time_and_one_that_cannot_be_sent_fails_alone(world, client):
    """Of hundreds that wait each leaves once and in order, but for those that were given up meanwhile."""
    world.refused = {3}
    client.send(0, b"no request")
    for number in (1, 200, 2, 3, 4, 5, 6):
        client.send(number, request(number))
    client.release(100.0)
    due_s = client.release(101.0)
    assert (world.sent, [*client.ended]) == ([1, 2, 3, 4], [0, 3])
    assert {failure.reason for failure in client.ended.values()} == {FailureReason.TYPE}
    assert client.release(due_s - 0.001) == due_s
    assert client.release(due_s) == math.inf
    assert world.sent == [1, 2, 3, 4, 5, 6]


def test_calls_fail_when_their_server_goes(world, client):
    """In an outage the end that asked never hears of it, and would wait for the result of a goal without end."""
    client.send(1, request(1))
    for now_s in (100.0, 101.0):
        client.release(now_s)
    client.send(2, request(2))
    client.destroy()
    assert world.sent == [1]
    assert {call: failure.reason for call, failure in client.ended.items()} == dict.fromkeys(
        (1, 2), FailureReason.NO_SERVER
    )


def test_calls_fail_once_none_of_the_servers_is_left_that_may_have_them(world, client):
    """A component that is loaded again has the same name, and knows nothing of earlier goals."""
    for number, now_s in ((1, 100.0), (2, 101.0)):
        client.send(number, request(number))
        client.release(now_s)
        client.release(now_s + 0.5)
        client.follow(frozenset({b"old", b"other"}))
    client.send(3, request(3))
    client.release(102.0)
    client.follow(frozenset({b"new", b"other"}))
    assert not client.ended
    client.follow(frozenset({b"new"}))
    assert {call: failure.reason for call, failure in client.ended.items()} == dict.fromkeys(
        (1, 2), FailureReason.NO_SERVER
    )


def test_a_response_that_cannot_be_sent_keeps_no_other_and_none_is_lost_with_its_server(world):
    """Responses leave five at a time, and all that wait when their server goes."""
    world.refused = {1}
    server = GhostServer(world, OFFER, BasicTypes, "/double", MagicMock(), on_request=MagicMock())
    for number in range(20):
        server.send(None, BasicTypes.Response(int32_value=number))
    server.release(100.0)
    assert world.sent == [*range(5)]
    server.destroy()
    assert world.sent == [*range(20)]


@pytest.mark.parametrize("kind", ["msg", "srv", "action"])
def test_a_package_that_rosidl_did_not_make_is_not_imported(tmp_path, monkeypatch, kind):
    """The other end names types, and no code of another package runs for that."""
    package = tmp_path / "not_of_ros"
    (package / kind).mkdir(parents=True)
    for folder in (package, package / kind):
        (folder / "__init__.py").write_text("raise SystemExit('it ran')\n")
    monkeypatch.syspath_prepend(tmp_path)
    load = message_class if kind == "msg" else service_class
    for name in ("not_of_ros", "antigravity", "nowhere"):
        with pytest.raises(UnknownTypeError, match="is not installed here"):
            load(f"{name}/{kind}/Thing")
    assert not {"not_of_ros", "antigravity"} & sys.modules.keys()


# -- servers of the other side's services that go

OFFERED = {"/set": ServiceOffer(type_name="diagnostic_msgs/srv/AddDiagnostics", node="/n")}  # can say a failure
SESSION = 7


@pytest.fixture
def end(monkeypatch):
    """Return the calls of an end, and what it does: records on the link, responses, and the end of its server."""
    for name in ("ReadingThread", "GraphView"):
        monkeypatch.setattr(module, name, MagicMock())
    did, node = [], MagicMock()
    node.create_service().send_response = lambda _response, header: did.append((header, time.monotonic()))
    node.destroy_service = lambda _server: did.append("gone")
    calls = module.Calls(
        node,
        SimpleNamespace(give=lambda _name, make: make(node)),
        lambda data, _source: did.append(Record.decode(data).kind.name),
        session=1,
        side=Side(RelaySettings(services=("/**",)), is_far=True),
        timeout_s=10.0,
    )
    calls._session_there = SESSION
    calls._follow(OFFERED, SESSION, ())
    calls.did = did
    calls.ask = lambda header: calls._call("/set", AddDiagnostics.Request(), header)
    return calls


def test_a_call_of_a_server_that_goes_fails_at_once(end):
    """It does not cross: its failure would leave right before its server goes, and its caller would wait for ever."""
    end._follow({}, SESSION, ())
    end.ask("late")
    end._ghosts["/set"].release(time.monotonic())
    end._follow({}, SESSION, ())
    assert [each if isinstance(each, str) else each[0] for each in end.did] == ["late", "gone"]


def test_a_service_that_cannot_be_served_here_makes_no_node(end):
    """Its node would come and go with every look, and each process of the domain would hear of it."""
    end._nodes.give = lambda *_: pytest.fail("there is a node")
    end._follow({**OFFERED, "/vendor": ServiceOffer(type_name="vendor_msgs/srv/Calibrate", node="/v")}, SESSION, ())
    assert "vendor_msgs" in end.refused["/vendor"]


def test_a_server_that_gives_way_to_one_of_this_side_takes_no_call(end):
    """Else the call would run on both sides, or the failure would arrive before the answer."""
    end._follow(OFFERED, SESSION, {"/set"})
    end.ask("both")
    assert end._ghosts["/set"].is_idle
    assert not end.did


@pytest.mark.parametrize(
    ("session", "status"), [(None, GoalStatus.STATUS_UNKNOWN), (SESSION, GoalStatus.STATUS_ABORTED)]
)
def test_a_goal_is_over_where_its_server_is_gone_and_not_where_the_link_is(end, session, status):
    """Beyond a link that is down for long the robot may still drive, and its result must not say that it stopped."""
    name, responses = "/drive/_action/get_result", []
    offer = ServiceOffer(type_name="test_msgs/action/Fibonacci_GetResult", node="/n")
    end._side.may_call = lambda _name: True
    end._follow({name: offer}, SESSION, ())
    end._ghosts[name].send = lambda _header, response: responses.append(response.status)
    end._call(name, service_class(offer.type_name).Request(), "goal")
    end._follow({name: offer}, None, ())
    assert not responses
    end._follow({}, session, ())
    assert responses == [status]


def test_the_responses_of_an_end_that_stops_leave_five_at_a_time(end):
    """A client of ROS has room for ten."""
    for number in range(20):
        end.ask(number)
    del end.did[:]
    end.close()
    answered = [each[1] for each in end.did if not isinstance(each, str)]
    assert len(answered) == 20
    assert all(late - early > 0.015 for early, late in zip(answered, answered[5:], strict=False))
    assert end.did[-1] == "gone"
