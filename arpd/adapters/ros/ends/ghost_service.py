"""A server of a service whose real server is on the other side of the link."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile

from arpd.apply.relay.call_records import FailureReason

if TYPE_CHECKING:
    from collections.abc import Callable

# As ROS's own, but deeper: requests of many clients wait while the relay does other work, and nobody repeats them.
CALLS_QOS = QoSProfile(depth=100)
_AT_ONCE = 5  # responses in one step: a client's own history has ten places, and the link delivers in bursts
_STATUS_UNKNOWN, _STATUS_ABORTED = 0, 6  # action_msgs/msg/GoalStatus


class GhostService:
    """Takes requests, and answers each one later without blocking its executor.

    rclpy has no such server. Its executors send what the callback returns at once. A coroutine would keep an executor
    busy until the answer comes, and Jazzy's EventsExecutor takes none. But every executor sends through
    ``send_response`` of the service, with the request's header. So this callback returns the request, and
    ``send_response`` of this one service hands both on.

    Parameters
    ----------
    node : node that the server belongs to
    kind : service class
    name : fully qualified name
    on_request : called with each request and its header
    """

    def __init__(self, node: Any, kind: Any, name: str, *, on_request: Callable[[Any, Any], None]) -> None:
        self._node = node
        self._answers: deque[tuple[Any, Any]] = deque()
        self._sent = 0  # since the last step
        self._service: Any = node.create_service(kind, name, _request, qos_profile=CALLS_QOS)
        self._send: Callable[[Any, Any], None] = self._service.send_response
        self._service.send_response = on_request

    def answer(self, response: Any, header: Any) -> None:
        """Send the response of one request, unless the server is gone; where many just left, after the next `step`."""
        self._answers.append((response, header))
        self._release()

    def step(self) -> None:
        """Send some of the responses that wait."""
        self._sent = 0
        self._release()

    def _release(self) -> None:
        while self._service is not None and self._answers and self._sent < _AT_ONCE:
            self._sent += 1
            self._send(*self._answers.popleft())

    def destroy(self) -> None:
        """Remove the server, so that clients see at once that the service is not there."""
        service, self._service = self._service, None
        if service is not None:
            while self._answers:
                self._send(*self._answers.popleft())
            self._node.destroy_service(service)


def _request(request: Any, _response: Any) -> Any:
    return request


def failed_response(kind: Any, type_name: str, *, reason: FailureReason, message: str) -> Any:
    """Return the response that says why a call failed; None where its type cannot say it.

    A service of ROS has no failures. Without a response it looks like a server that died.

    Parameters
    ----------
    kind, type_name : service class, and its ROS name
    reason, message : the reason, and the same in words
    """
    response = kind.Response()
    if type_name == "action_msgs/srv/CancelGoal":
        response.return_code = response.ERROR_REJECTED
        return response
    if "/action/" in type_name and type_name.endswith("_SendGoal"):
        response.accepted = False
        return response
    if "/action/" in type_name and type_name.endswith("_GetResult"):
        # Without its server a goal is over; beyond a link that is down it may go on.
        response.status = _STATUS_ABORTED if reason is FailureReason.NO_SERVER else _STATUS_UNKNOWN
        return response
    fields = response.get_fields_and_field_types()
    if fields.get("success") != "boolean":
        return None
    response.success = False
    for field in ("message", "status_message"):
        if fields.get(field) == "string":
            setattr(response, field, f"arpd relay: {message}")
    return response
