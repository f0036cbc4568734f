"""Calls of the other end that servers on this side answer."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.exceptions import InvalidServiceNameException, NameValidationException
from rclpy.serialization import deserialize_message, serialize_message

from arpd.adapters.ros.ends.ghost_service import CALLS_QOS
from arpd.adapters.ros.ends.types import UnknownTypeError, service_class
from arpd.apply.relay.call_records import Answer, CallFailure, FailureReason
from arpd.apply.relay.calls import Callee

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.apply.relay.call_records import Record, Request
    from arpd.apply.relay.calls import CallId

_AT_ONCE = 5  # requests to one server in one step: its own history has ten places, and the link delivers in bursts
_READY_S = 3.0  # for a new client to match its server
_SETTLED_S = 0.3  # for its server to match it: rmw_fastrtps drops a response whose reader stays unknown for 100 ms
_GONE_S = 1.0  # without its server; it may seem to be gone for a moment when a second one leaves


@dataclass(slots=True)
class _Client:
    """A client of a local server, kept for all calls of its service."""

    service: str  # its name on the link
    client: Any
    made_s: float
    matched_s: float = math.inf  # when it began to see its server
    sent: int = 0  # in this step

    def look(self, now_s: float) -> bool:
        """Note since when it sees its server, and return whether it does."""
        self.matched_s = min(self.matched_s, now_s) if self.client.service_is_ready() else math.inf
        return now_s >= self.matched_s


@dataclass(slots=True)
class _Running:
    """A call whose request waits for its client to match, or whose response has not come."""

    client: _Client
    service: str
    message: Any
    future: Any = None
    seen_s: float = 0.0  # when its server was last there


class ServedCalls:
    """Passes each call of the other end to the local server, and its response back.

    Parameters
    ----------
    node : node of the clients
    send : writes one record to the link
    session : of this process
    offered : returns the local name and the type of a service, by its name on the link; None if it is not offered
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        node: Any,
        *,
        send: Callable[[bytes], None],
        session: str,
        offered: Callable[[str], tuple[str, str] | None],
        clock: Callable[[], float],
    ) -> None:
        self._node = node
        self._offered = offered
        self._clock = clock
        self._callee = Callee(session=session, send=send, run=self._run)
        self._clients: dict[tuple[str, str], _Client] = {}  # by local name and type
        self._running: dict[CallId, _Running] = {}

    def __len__(self) -> int:
        """Return how many calls are under way."""
        return len(self._running)

    def follow(self, session: str | None) -> None:
        """Run calls of this session of the other end from now on."""
        self._callee.follow(session)

    def receive(self, record: Record) -> None:
        """Take a record of the other end."""
        self._callee.receive(record)

    def step(self, now_s: float) -> None:
        """Send requests whose client is ready now, and end the calls whose server or caller is gone."""
        self._callee.step(now_s)
        for client in self._clients.values():
            client.sent = 0
            client.look(now_s)  # a server that restarts must know this client first
        for call, running in [*self._running.items()]:
            if not self._callee.is_running(call):
                self._forget(call)
            elif running.future is None:
                self._try(call, running, now_s)
            elif now_s >= running.client.matched_s:
                running.seen_s = now_s
            elif now_s - running.seen_s >= _GONE_S:
                self._fail(
                    call, FailureReason.NO_SERVER, f"the server of {running.service} is gone; the call may have run"
                )
        self._drop_idle_clients()

    def _drop_idle_clients(self) -> None:
        """Remove clients of services that are gone or have another type: a participant has one type per name."""
        used = {id(running.client) for running in self._running.values()}
        for key, client in [*self._clients.items()]:
            if self._offered(client.service) != key and id(client) not in used:
                self._node.destroy_client(self._clients.pop(key).client)

    def destroy(self) -> None:
        """Remove the clients."""
        for client in self._clients.values():
            self._node.destroy_client(client.client)
        self._clients.clear()
        self._running.clear()

    def _run(self, call: CallId, request: Request) -> None:
        name, type_name = self._offered(request.service) or ("", "")
        if not name:
            self._fail(call, FailureReason.NO_SERVER, f"{request.service} is not offered")
            return
        if type_name != request.type_name:
            self._fail(call, FailureReason.TYPE, f"{request.service} is a {type_name} here, not a {request.type_name}")
            return
        try:
            kind = service_class(type_name)
            message = deserialize_message(request.body, kind.Request)
            client = self._client(request.service, name, type_name, kind)
        except UnknownTypeError as error:
            self._fail(call, FailureReason.TYPE, str(error))
        except (InvalidServiceNameException, NameValidationException, RuntimeError, ValueError) as error:
            self._fail(call, FailureReason.TYPE, f"the middleware says: {error}")
        else:
            running = self._running[call] = _Running(client, name, message)
            self._try(call, running, self._clock())

    def _client(self, service: str, name: str, type_name: str, kind: Any) -> _Client:
        client = self._clients.get((name, type_name))
        if client is None:
            made = self._node.create_client(kind, name, qos_profile=CALLS_QOS)
            client = self._clients[name, type_name] = _Client(service, made, self._clock())
        return client

    def _try(self, call: CallId, running: _Running, now_s: float) -> None:
        """Send the request; fail without a server, unless the client is so new that it may not have matched yet."""
        client = running.client
        if client.sent >= _AT_ONCE:
            return
        if client.look(now_s):
            if now_s - client.matched_s < _SETTLED_S:
                return
            client.sent += 1
            running.seen_s = now_s
            running.future = client.client.call_async(running.message)
            running.message = None
            running.future.add_done_callback(partial(self._finish, call))
        elif now_s - client.made_s >= _READY_S:
            self._fail(call, FailureReason.NO_SERVER, f"no server of {running.service}")

    def _finish(self, call: CallId, future: Any) -> None:
        if (running := self._running.get(call)) is None or running.future is not future:
            return
        del self._running[call]
        try:
            body = bytes(serialize_message(future.result()))
        except RuntimeError as error:
            self._fail(call, FailureReason.TYPE, f"the middleware says: {error}")
        else:
            self._callee.finish(call, Answer(body=body), self._clock())

    def _fail(self, call: CallId, reason: FailureReason, message: str) -> None:
        self._callee.finish(call, CallFailure(reason=reason, message=f"the other end says: {message}"), self._clock())
        self._forget(call)

    def _forget(self, call: CallId) -> None:
        running = self._running.pop(call, None)
        if running is not None and running.future is not None:
            running.client.client.remove_pending_request(running.future)
