"""Calls across the link by type: what says a failure, what cannot be called, and when a request may leave."""

import sys
from unittest.mock import MagicMock

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("test_msgs", reason="test_msgs is not installed")

from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from test_msgs.srv import BasicTypes, Empty

from arpd.relay.calls import CallFailure, FailureReason
from arpd.relay.ends.services import LocalClient, failed_response
from arpd.relay.ends.types import UnknownTypeError, message_class, service_class


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
    response = failed_response(service_class(type_name), type_name, CallFailure(reason, "why"))
    assert {name: getattr(response, name) for name in fields} == fields


def test_a_type_that_cannot_say_it_gets_no_response():
    """A response with invented values would be worse than none."""
    assert failed_response(BasicTypes, "test_msgs/srv/BasicTypes", CallFailure(FailureReason.TIMEOUT, "why")) is None


class LateServer(MagicMock):
    """Stands for a node and its client: the server is there when a test says so."""

    is_there = True

    def create_client(self, *_args, **_options):
        return self

    def service_is_ready(self):
        return self.is_there


def test_no_request_leaves_before_its_server_can_know_the_client():
    """A server drops a response for a client that it does not know yet, after a restart of the server, too."""
    node, now_s = LateServer(), 100.0
    client = LocalClient(node, Empty, "/empty", MagicMock(), lambda _call, _response: None)

    def pass_time(seconds):
        nonlocal now_s
        now_s += seconds
        return client.is_ready(now_s)

    assert [pass_time(seconds) for seconds in (0.0, 0.2, 0.2)] == [False, False, True]
    node.is_there = False
    assert not pass_time(0.1)
    node.is_there = True
    assert [pass_time(seconds) for seconds in (0.1, 0.1, 0.3)] == [False, False, True]


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
