"""Servers and clients of services, which a `ReadingThread` serves, and what they say of a call that failed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile

from arpd.relay.calls import FailureReason
from arpd.relay.ends.types import service_class
from arpd.ros.rcl import rcl

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from arpd.relay.calls import CallFailure, CallId
    from arpd.relay.ends.offers import ServiceOffer
    from arpd.ros.raw_reader import ReadingThread

# As ROS's own, but deeper: requests of many clients wait while the relay does other work, and nobody repeats them.
_QOS = QoSProfile(depth=100)
_SETTLED_S = 0.3  # for a server to match a client: rmw_fastrtps drops a response whose reader stays unknown for 100 ms
_STATUS_ABORTED = 6  # action_msgs/msg/GoalStatus


class GhostServer:
    """A server of a service of the other side; it answers each request later.

    Parameters
    ----------
    node : node that the server belongs to; no executor serves it
    offer : the service
    name : fully qualified name
    thread : serves it
    on_request : called with each request and its header, in the thread
    """

    def __init__(
        self, node: Node, offer: ServiceOffer, name: str, thread: ReadingThread, on_request: Callable[[Any, Any], None]
    ) -> None:
        self.offer, self.kind = offer, service_class(offer.type_name)
        self._node, self._thread, self._on_request = node, thread, on_request
        self._server = node.create_service(self.kind, name, lambda _request, answer: answer, qos_profile=_QOS)
        self.name, self.handle, self.notify = name, self._server.handle, rcl().notify_server
        self._event = thread.watch(self)

    def read(self) -> bool:
        """Take a request; return whether there was none."""
        with self.handle:
            request, header = self.handle.service_take_request(self.kind.Request)
        if header is not None:
            self._on_request(request, header)
        return header is None

    def is_ready(self, _now_s: float) -> bool:
        """Return whether a response may leave."""
        return True

    def send(self, header: Any, response: Any) -> None:
        """Send the response of one request."""
        self._server.send_response(response, header)

    def destroy(self) -> None:
        """Remove the server, so that clients see at once that the service is not there."""
        self._thread.unwatch(self, self._event)
        self._node.destroy_service(self._server)


class LocalClient:
    """A client of a server of this side, kept for all calls of its service.

    Parameters
    ----------
    node : node that the client belongs to
    kind, name : service class, and fully qualified name
    thread : serves it
    on_response : called with each call and its response, in the thread
    """

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        thread: ReadingThread,
        on_response: Callable[[CallId, Any], None],
    ) -> None:
        self.kind = kind
        self._node, self._thread, self._on_response = node, thread, on_response
        self._matched_s = math.inf  # when it began to see its server
        self._running: dict[int, CallId] = {}  # by the number that each request has here
        self._client = node.create_client(kind, name, qos_profile=_QOS)
        self.name, self.handle, self.notify = name, self._client.handle, rcl().notify_client
        self._event = thread.watch(self)

    def read(self) -> bool:
        """Take a response; return whether there was none."""
        with self.handle:
            header, response = self.handle.take_response(self.kind.Response)
        if header is not None and (call := self._running.pop(header.request_id.sequence_number, None)) is not None:
            self._on_response(call, response)
        return header is None

    def is_ready(self, now_s: float) -> bool:
        """Return whether a request may leave: the server must know this client, also after its restart."""
        self._matched_s = min(self._matched_s, now_s) if self._client.service_is_ready() else math.inf
        return now_s - self._matched_s >= _SETTLED_S

    def send(self, call: CallId, request: Any) -> None:
        """Send the request of a call."""
        with self.handle:
            self._running[self.handle.send_request(request)] = call

    @property
    def running(self) -> tuple[CallId, ...]:
        """The calls whose request has left."""
        return (*self._running.values(),)

    def keep(self, is_awaited: Callable[[CallId], bool]) -> None:
        """Forget the calls whose outcome nobody awaits."""
        self._running = {number: call for number, call in self._running.items() if is_awaited(call)}

    def destroy(self) -> None:
        """Remove the client."""
        self._thread.unwatch(self, self._event)
        self._node.destroy_client(self._client)


def failed_response(kind: Any, type_name: str, failure: CallFailure) -> Any:
    """Return the response that says why a call failed; None where its type cannot say it.

    A service of ROS has no failures. Without a response it looks like a server that died.

    Parameters
    ----------
    kind, type_name : service class, and its ROS name
    """
    response = kind.Response()  # one of an action's says by default that its goal is not accepted, or not known
    fields = response.get_fields_and_field_types()
    if type_name == "action_msgs/srv/CancelGoal":
        response.return_code = response.ERROR_REJECTED
    elif type_name.endswith("_GetResult"):
        if failure.reason is FailureReason.NO_SERVER:  # then the goal is over; beyond a link that is down it may go on
            response.status = _STATUS_ABORTED
    elif not type_name.endswith("_SendGoal") and fields.get("success") != "boolean":
        return None
    for field in ("message", "status_message"):
        if fields.get(field) == "string":
            setattr(response, field, f"arpd relay: {failure.message}")
    return response
