"""Servers and clients of services, which a `ReadingThread` serves."""

from __future__ import annotations

import math
from collections import deque
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
# Requests to one server, or responses to the clients of one, between two steps: their own histories have ten places,
# and the link delivers in bursts.
_AT_ONCE = 5
_SETTLED_S = 0.3  # for a server to match a client: rmw_fastrtps drops a response whose reader stays unknown for 100 ms
_STATUS_UNKNOWN, _STATUS_ABORTED = 0, 6  # action_msgs/msg/GoalStatus


class _Endpoint:
    """A server or a client: a `ReadingThread` takes what comes, and a few messages leave between two steps."""

    def __init__(self, endpoint: Any, notify: Any, thread: ReadingThread) -> None:
        self.name, self.handle, self.notify = endpoint.srv_name, endpoint.handle, notify
        self._waiting: deque[tuple[Any, Any]] = deque()  # messages that have not left, and what each belongs to
        self._sent = 0  # since the last step
        self._thread, self._event = thread, thread.watch(self)

    @property
    def is_waiting(self) -> bool:
        """Whether something waits for the next step."""
        return bool(self._waiting)

    def read(self) -> bool:
        """Take some; return whether that was all."""
        return not all(self._take() for _ in range(_AT_ONCE))

    def step(self) -> None:
        """Send some of what waits."""
        self._sent = 0
        self._release()

    def close(self) -> None:
        """Take no more."""
        self._thread.unwatch(self, self._event)

    def _release(self, most: float = _AT_ONCE) -> None:
        while self._is_ready() and self._waiting and self._sent < most:
            self._sent += 1
            self._send(*self._waiting.popleft())

    def _is_ready(self) -> bool:
        return True

    def _take(self) -> bool:
        """Take and deliver one; return whether there was one."""
        raise NotImplementedError

    def _send(self, owner: Any, message: Any) -> None:
        raise NotImplementedError


class GhostServer(_Endpoint):
    """A server of a service of the other side; it answers each request later.

    Parameters
    ----------
    node : node that the server belongs to
    offer : the service
    name : fully qualified name
    thread : serves it
    on_request : called with each request and its header, in the thread
    """

    def __init__(
        self, node: Node, offer: ServiceOffer, name: str, thread: ReadingThread, on_request: Callable[[Any, Any], None]
    ) -> None:
        self.offer, self.kind = offer, service_class(offer.type_name)
        self._node, self._on_request = node, on_request
        # No executor serves its node, so nobody calls this back.
        self._server = node.create_service(self.kind, name, lambda _request, answer: answer, qos_profile=_QOS)
        super().__init__(self._server, rcl().notify_server, thread)

    def answer(self, header: Any, response: Any) -> None:
        """Send the response of one request; where many just left, after the next `step`."""
        self._waiting.append((header, response))
        self._release()

    def destroy(self) -> None:
        """Send all that waits, and remove the server, so that clients see at once that the service is not there."""
        self._release(math.inf)
        self.close()
        self._node.destroy_service(self._server)

    def _take(self) -> bool:
        with self.handle:
            request, header = self.handle.service_take_request(self.kind.Request)
        if header is not None:
            self._on_request(request, header)
        return header is not None

    def _send(self, owner: Any, message: Any) -> None:
        self._server.send_response(message, owner)


class LocalClient(_Endpoint):
    """A client of a server of this side, kept for all calls of its service.

    Parameters
    ----------
    node : node that the client belongs to
    kind : service class
    name : fully qualified name
    thread : serves it
    on_response : called with each call and its response, in the thread
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        thread: ReadingThread,
        on_response: Callable[[CallId, Any], None],
        *,
        clock: Callable[[], float],
    ) -> None:
        self.kind = kind
        self._node, self._on_response, self._clock = node, on_response, clock
        self._matched_s = math.inf  # when it began to see its server
        self._running: dict[int, CallId] = {}  # by the number that each request has here
        self._client = node.create_client(kind, name, qos_profile=_QOS)
        super().__init__(self._client, rcl().notify_client, thread)

    @property
    def is_idle(self) -> bool:
        """Whether it has no call."""
        return not self._waiting and not self._running

    def call(self, call: CallId, request: Any) -> None:
        """Send a request, once the server must know this client, also after its restart."""
        self._waiting.append((call, request))
        self._release()

    def stop(self, call: CallId) -> None:
        """Forget a call, if it is one of these."""
        self._waiting = deque(each for each in self._waiting if each[0] != call)
        self._running = {number: each for number, each in self._running.items() if each != call}

    def destroy(self) -> None:
        """Remove the client."""
        self.close()
        self._node.destroy_client(self._client)

    def _is_ready(self) -> bool:
        now_s = self._clock()
        self._matched_s = min(self._matched_s, now_s) if self._client.service_is_ready() else math.inf
        return now_s - self._matched_s >= _SETTLED_S

    def _take(self) -> bool:
        with self.handle:
            header, response = self.handle.take_response(self.kind.Response)
        if header is not None and (call := self._running.pop(header.request_id.sequence_number, None)) is not None:
            self._on_response(call, response)
        return header is not None

    def _send(self, owner: CallId, message: Any) -> None:
        with self.handle:
            self._running[self.handle.send_request(message)] = owner


def failed_response(kind: Any, type_name: str, failure: CallFailure) -> Any:
    """Return the response that says why a call failed; None where its type cannot say it.

    A service of ROS has no failures. Without a response it looks like a server that died.

    Parameters
    ----------
    kind, type_name : service class, and its ROS name
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
        response.status = _STATUS_ABORTED if failure.reason is FailureReason.NO_SERVER else _STATUS_UNKNOWN
        return response
    fields = response.get_fields_and_field_types()
    if fields.get("success") != "boolean":
        return None
    response.success = False
    for field in ("message", "status_message"):
        if fields.get(field) == "string":
            setattr(response, field, f"arpd relay: {failure.message}")
    return response
