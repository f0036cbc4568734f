"""Servers and clients of services, which a `ReadingThread` serves, and what they say of a call that failed."""

from __future__ import annotations

import logging
import math
from collections import deque
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message

from arpd.relay.calls import CallBook, CallFailure, CallId, FailureReason
from arpd.relay.ends.types import require_same, service_class
from arpd.ros.raw_reader import Inlet, ReadingThread
from arpd.ros.rcl import rcl

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from arpd.relay.ends.offers import ServiceOffer

log = logging.getLogger(__name__)
# As ROS's own, but deeper: requests of many clients wait while the relay does other work, and nobody repeats them.
_QOS = QoSProfile(depth=100)
_AT_ONCE, _BURST_S = 5, 0.02  # messages leave in bursts: a client and a server of ROS have histories of ten
_SETTLED_S = 0.3  # for a server to match a client: rmw_fastrtps drops a response whose reader stays unknown for 100 ms
_STATUS_ABORTED = 6  # action_msgs/msg/GoalStatus
_GONE = "its server is gone"


class _Endpoint(Inlet):
    """A server or a client, and what waits to leave it.

    Parameters
    ----------
    of : the server or the client of rclpy; no executor serves it
    """

    def __init__(self, of: Any, name: str, notify: Any, thread: ReadingThread) -> None:
        self.name, self.handle, self.notify = name, of.handle, notify
        self._waiting: deque[tuple[Any, Any]] = deque()  # messages, and what each belongs to
        self._room, self._burst_s = 0, -math.inf  # messages that may still leave, and when the next burst may
        self._thread, self._event = thread, thread.watch(self)

    def send(self, owner: Any, message: Any) -> None:
        """Let a message leave with a later `release`; its owner is a call, or the header of a request."""
        self._waiting.append((owner, message))

    def release(self, now_s: float) -> float:
        """Let leave what may; return when more may (s)."""
        if now_s >= self._burst_s:
            self._room, self._burst_s = _AT_ONCE, now_s + _BURST_S
        while self._waiting and self._room and self._is_ready(now_s):
            self._room -= self._leave(*self._waiting.popleft())
        return self._burst_s if self._waiting else math.inf

    @property
    def is_idle(self) -> bool:
        """Whether no message waits."""
        return not self._waiting

    def destroy(self) -> None:
        """Remove it; nothing is read any more."""
        self._thread.unwatch(self, self._event)

    def _is_ready(self, _now_s: float) -> bool:
        return True

    def _leave(self, owner: Any, message: Any) -> int:
        """Send a message, if somebody wants it; return how many have left."""
        raise NotImplementedError


class GhostServer(_Endpoint):
    """A server of a service of the other side; it answers each request later.

    Parameters
    ----------
    kind : class of the service
    on_request : called with each request and its header, in the thread
    """

    def __init__(
        self,
        node: Node,
        offer: ServiceOffer,
        kind: Any,
        name: str,
        thread: ReadingThread,
        *,
        on_request: Callable[[Any, Any], None],
    ) -> None:
        self.offer, self.kind = offer, kind
        self._node, self._on_request = node, on_request
        self._server = node.create_service(self.kind, name, lambda _request, answer: answer, **_options())
        super().__init__(self._server, name, rcl().notify_server, thread)

    def read(self, announced: int) -> int:
        """Take a request; return how many may be left."""
        with self.handle:
            request, header = self.handle.service_take_request(self.kind.Request)
        if header is not None:
            self._on_request(request, header)
        return 0 if header is None else announced

    def _leave(self, header: Any, response: Any) -> int:
        try:
            self._server.send_response(response, header)
        except RuntimeError as error:
            log.warning("a response of %s cannot be sent: %s", self.name, error)
        return 1

    def destroy(self) -> None:
        """Send what waits, and remove the server, so that clients see at once that the service is not there."""
        while self._waiting:
            self._leave(*self._waiting.popleft())
        super().destroy()
        self._node.destroy_service(self._server)


class LocalClient(_Endpoint):
    """A client of a server of this side, kept for all calls of its service.

    Parameters
    ----------
    book : of the calls, which it finishes in the thread
    """

    def __init__(self, node: Node, offer: ServiceOffer, name: str, thread: ReadingThread, book: CallBook) -> None:
        self.offer, self._kind = offer, class_of(offer)
        self._node, self._book = node, book
        self._matched_s = math.inf  # when it began to see its server
        # By the number that each request has here: its call, and the servers that may have it.
        self._running: dict[int, tuple[CallId, frozenset[bytes]]] = {}
        self._client = node.create_client(self._kind, name, **_options())
        super().__init__(self._client, name, rcl().notify_client, thread)

    def read(self, announced: int) -> int:
        """Take a response; return how many may be left."""
        with self.handle:
            header, response = self.handle.take_response(self._kind.Response)
        if header is not None and (run := self._running.pop(header.request_id.sequence_number, None)) is not None:
            self._book.finish(run[0], bytes(serialize_message(response)))
        return 0 if header is None else announced

    def _is_ready(self, now_s: float) -> bool:
        """Return whether a request may leave: the server must know this client, also after its restart."""
        self._matched_s = min(self._matched_s, now_s) if self._client.service_is_ready() else math.inf
        return now_s - self._matched_s >= _SETTLED_S

    def _leave(self, call: CallId, request: bytes) -> int:
        if not self._book.runs(call):
            return 0
        try:
            with self.handle:
                number = self.handle.send_request(deserialize_message(request, self._kind.Request))
                self._running[number] = call, frozenset()
        except (RuntimeError, ValueError) as error:
            self._book.finish(call, CallFailure(FailureReason.TYPE, f"its request cannot be sent: {error}"))
        return 1

    def follow(self, servers: frozenset[bytes]) -> None:
        """Forget the calls whose outcome nobody awaits, also those that wait for a server that never matches.

        A server that restarts knows nothing of earlier requests: a call fails once all servers are gone that were there
        at the first look after its request.

        Parameters
        ----------
        servers : GUIDs of those that the graph shows now
        """
        for call, asked in self._running.values():
            if asked and not asked & servers:
                self._book.finish(call, CallFailure(FailureReason.NO_SERVER, _GONE))
        self._waiting = deque(each for each in self._waiting if self._book.runs(each[0]))
        self._running = {
            number: (call, asked or servers) for number, (call, asked) in self._running.items() if self._book.runs(call)
        }

    def destroy(self) -> None:
        """Remove the client; its calls fail.

        So does the end that asked, where it hears that their service is not offered; in an outage it does not.
        """
        for call, _ in (*self._running.values(), *self._waiting):
            self._book.finish(call, CallFailure(FailureReason.NO_SERVER, _GONE))
        super().destroy()
        self._node.destroy_client(self._client)


def _options() -> dict[str, Any]:
    # A group of callbacks of rclpy keeps a reference to all that was ever in it, so each has one of its own.
    return {"qos_profile": _QOS, "callback_group": ReentrantCallbackGroup()}


def class_of(offer: ServiceOffer) -> Any:
    """Return the class of a service; UnknownTypeError = there is none, or another one, here."""
    kind = service_class(offer.type_name)
    for message, type_hash in zip((kind.Request, kind.Response), offer.type_hashes, strict=True):
        require_same(message, offer.type_name, type_hash)
    return kind


def failed_response(kind: Any, type_name: str, failure: CallFailure) -> Any:
    """Return the response that says why a call failed; None where its type cannot say it.

    A service of ROS has no failures. Without a response it looks like a server that died.
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
