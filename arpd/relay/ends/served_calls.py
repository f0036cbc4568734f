"""Services that nodes on this side serve, and the calls of the other end that they answer."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.exceptions import InvalidServiceNameException, NameValidationException
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message

from arpd.relay.calls import Callee, CallFailure, FailureReason
from arpd.relay.ends.types import UnknownTypeError, service_class
from arpd.relay.offers import ServiceOffer

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from arpd.relay.calls import CallId, Request, Send
    from arpd.ros.graph import Endpoint
    from arpd.ros.graph_view import GraphView

# As ROS's own, but deeper: requests of many clients wait while the relay does other work, and nobody repeats them.
CALLS_QOS = QoSProfile(depth=100)
#: Requests to one server, or responses to the clients of one, in one step: their own histories have ten places, and the
#: link delivers in bursts.
AT_ONCE = 5
_SETTLED_S = 0.3  # for a server to match a client: rmw_fastrtps drops a response whose reader stays unknown for 100 ms


@dataclass(slots=True)
class _Client:
    """A client of a local server, kept for all calls of its service."""

    client: Any
    matched_s: float = math.inf  # when it began to see its server
    waiting: dict[CallId, Any] = field(default_factory=dict)  # requests that have not left
    futures: dict[CallId, Any] = field(default_factory=dict)
    sent: int = 0  # in this step


class ServedCalls:
    """Passes each call of the other end to the local server, and its response back.

    Servers of this process, ghosts above all, do not count. A call whose server is gone ends with its offer: the other
    end gives it up.

    Parameters
    ----------
    node : node of the clients
    view : the graph of the local domain
    send : writes one record to the link
    local_name : returns the name here of a service, by its name on the link
    clock : monotonic clock (s)

    Attributes
    ----------
    callee : of these calls
    """

    def __init__(
        self,
        node: Any,
        view: GraphView,
        *,
        send: Send,
        local_name: Callable[[str], str],
        clock: Callable[[], float],
    ) -> None:
        self._node = node
        self._local_name = local_name
        self._clock = clock
        self._view = view
        self._servers: dict[str, list[Endpoint]] = {}  # by name on the link
        self._clients: dict[tuple[str, str], _Client] = {}  # by name on the link, and type
        self.callee = Callee(send=send, run=self._run, stop=self._stop)

    def look(self, names: Mapping[str, str]) -> dict[str, ServiceOffer]:
        """Return which of these services other processes serve, each with its first server whose node is known.

        Parameters
        ----------
        names : local names by the names on the link
        """
        ours = self._view.ours
        self._servers = {
            name: [server for server in self._view.servers(local) if server.participant not in ours]
            for name, local in names.items()
        }
        return {name: offer for name in sorted(names) if (offer := self._offer(name)) is not None}

    def is_served(self, name: str) -> bool:
        """Return whether the last look found a server, also one whose node is not known yet."""
        return bool(self._servers.get(name))

    def step(self, now_s: float) -> None:
        """Send requests whose client is ready now, and remove clients of services that are gone or have another type.

        A participant has one type per name.
        """
        for (name, type_name), client in [*self._clients.items()]:
            client.sent = 0
            self._release(client, now_s)
            if self._type_of(name) != type_name and not client.waiting and not client.futures:
                self._node.destroy_client(self._clients.pop((name, type_name)).client)

    def destroy(self) -> None:
        """Remove the clients."""
        while self._clients:
            self._node.destroy_client(self._clients.popitem()[1].client)

    def _offer(self, name: str) -> ServiceOffer | None:
        named = [server for server in self._servers.get(name, ()) if server.node]
        first = min(named, key=lambda server: server.node, default=None)
        return None if first is None else ServiceOffer(type_name=_ros_type(first.type_name), node=first.node)

    def _type_of(self, name: str) -> str | None:
        offer = self._offer(name)
        return None if offer is None else offer.type_name

    def _run(self, call: CallId, request: Request) -> None:
        name, type_name = request.service, self._type_of(request.service)
        if type_name is None:
            self._fail(call, FailureReason.NO_SERVER, f"{name} is not offered")
        elif type_name != request.type_name:
            self._fail(call, FailureReason.TYPE, f"{name} is a {type_name} here, not a {request.type_name}")
        else:
            try:
                kind = service_class(type_name)
                message = deserialize_message(request.body, kind.Request)
                if (name, type_name) not in self._clients:
                    made = self._node.create_client(kind, self._local_name(name), qos_profile=CALLS_QOS)
                    self._clients[name, type_name] = _Client(made)
            except UnknownTypeError as error:
                self._fail(call, FailureReason.TYPE, str(error))
            except (InvalidServiceNameException, NameValidationException, RuntimeError, ValueError) as error:
                self._fail(call, FailureReason.TYPE, f"the middleware says: {error}")
            else:
                client = self._clients[name, type_name]
                client.waiting[call] = message
                self._release(client, self._clock())

    def _release(self, client: _Client, now_s: float) -> None:
        """Send requests, once the server must know the client, also after its restart."""
        client.matched_s = min(client.matched_s, now_s) if client.client.service_is_ready() else math.inf
        while client.waiting and client.sent < AT_ONCE and now_s - client.matched_s >= _SETTLED_S:
            client.sent += 1
            call, message = next(iter(client.waiting.items()))
            del client.waiting[call]
            future = client.futures[call] = client.client.call_async(message)
            future.add_done_callback(partial(self._finish, client, call))

    def _finish(self, client: _Client, call: CallId, future: Any) -> None:
        if client.futures.pop(call, None) is None:
            return
        try:
            self.callee.finish(call, bytes(serialize_message(future.result())))
        except RuntimeError as error:
            self._fail(call, FailureReason.TYPE, f"the middleware says: {error}")

    def _fail(self, call: CallId, reason: FailureReason, message: str) -> None:
        self.callee.finish(call, CallFailure(reason, f"the other end says: {message}"))

    def _stop(self, call: CallId) -> None:
        for client in self._clients.values():
            client.waiting.pop(call, None)
            if (future := client.futures.pop(call, None)) is not None:
                client.client.remove_pending_request(future)


def _ros_type(dds_type: str) -> str:
    """Return ``example_interfaces/srv/AddTwoInts`` for ``example_interfaces::srv::dds_::AddTwoInts_Request_``."""
    return dds_type.replace("::dds_::", "::").removesuffix("_Request_").replace("::", "/")
