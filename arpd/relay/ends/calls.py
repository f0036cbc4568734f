"""Services and actions of one side that nodes of the other can call, at one end."""

from __future__ import annotations

import logging
import math
import time
from collections import Counter, deque
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.exceptions import InvalidServiceNameException, NameValidationException
from rclpy.serialization import deserialize_message, serialize_message

from arpd.relay.calls import CallBook, CallFailure, FailureReason, Request, decode_record
from arpd.relay.ends.offers import ServiceOffer
from arpd.relay.ends.services import GhostServer, LocalClient, failed_response
from arpd.relay.ends.types import UnknownTypeError, service_class
from arpd.ros.graph_view import GraphView
from arpd.ros.names import is_full_name
from arpd.ros.rate_limits import OncePerMinute
from arpd.ros.raw_reader import ReadingThread

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.node import Node

    from arpd.relay.calls import CallId, Outcome, Send
    from arpd.relay.ends.ghosts import GhostNodes
    from arpd.relay.selection import Side
    from arpd.ros.graph import Endpoint

log = logging.getLogger(__name__)
_STEP_S, _BURST_S = 0.1, 0.02  # between steps; and while more wait than a server or a client may get at once
_LOOK_S = 0.5
_OWNER = "services"
_GET_RESULT = "/_action/get_result"  # waits for the end of its goal
_REFUSED = (InvalidServiceNameException, NameValidationException, RuntimeError, ValueError)  # by the middleware


class Calls:
    """Lets nodes on this side call services of the other side, and the other way round.

    Every service that the other end offers gets a ghost server here, under a node with the name of the real server's
    node. A call runs at most once. One without an answer fails, with a response that says so where its type can; so
    does one whose server is gone, together with its offer. Servers of this process, ghosts above all, are not offered.
    All works in one thread, which may wait for a server or a client here.

    Parameters
    ----------
    node : this end's node in the local domain
    nodes : ghosts of the other side's nodes
    send : writes one record to the link
    session : of this process, 32 bit
    side : names on this side
    timeout_s : time after which a call without an answer has failed; the result of an action may take any time (s)
    clock : monotonic clock (s)

    Attributes
    ----------
    offered : services of the other side, and its session, None = unreachable; the end's own thread sets it
    offers : services of this side that the other side may call, by their names on the link
    failures : calls from this side that failed, by reason
    refused : services of the other side that are not served here, and the reason
    thread : of all this
    """

    def __init__(
        self,
        node: Node,
        nodes: GhostNodes,
        send: Send,
        *,
        session: int,
        side: Side,
        timeout_s: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._node, self._nodes, self._session, self._side = node, nodes, session, side
        self._timeout_s, self._clock = timeout_s, clock
        self._view = GraphView.of(node)
        self._ghosts: dict[str, GhostServer] = {}  # by name on the link
        self._servers: dict[str, list[Endpoint]] = {}  # of this side, by name on the link
        self._clients: dict[tuple[str, str], LocalClient] = {}  # by name on the link, and type
        self._stepped_s = self._look_s = clock()
        self._logged = OncePerMinute()
        self._arrived: deque[tuple[int, bytes]] = deque()  # records of the other end, and its session
        self.offered: tuple[Mapping[str, ServiceOffer], int | None] = {}, None
        self.offers: Mapping[str, ServiceOffer] = {}
        self.refused: Mapping[str, str] = {}
        self.failures: Counter[str] = Counter()
        self._book = CallBook(send=send, run=self._run, stop=self._stop)
        self.thread = ReadingThread(step=self._step, clock=clock)

    def close(self) -> None:
        """Fail the calls that are under way, and remove all servers and clients."""
        self.thread.stop()
        self._follow({}, None)
        while self._clients:
            self._clients.popitem()[1].destroy()

    def _step(self) -> float:
        """Do what is due; return when to call again (s)."""
        while self._arrived:
            self._take(*self._arrived.popleft())
        now_s = self._clock()
        if now_s >= self._stepped_s + self._every_s:
            self._stepped_s = now_s
            if now_s >= self._look_s:
                self._look_s = now_s + _LOOK_S
                self._look()
            self._book.step(now_s)
            for each in (*self._ghosts.values(), *self._clients.values()):
                each.step()
        return self._stepped_s + self._every_s

    @property
    def _every_s(self) -> float:
        is_waiting = any(each.is_waiting for each in (*self._ghosts.values(), *self._clients.values()))
        return _BURST_S if is_waiting else _STEP_S

    def _look(self) -> None:
        """Follow the graph and the other end."""
        self._view.look()
        ours, servers = self._view.ours, {}
        for local in self._view.services:
            name = self._side.robot_name(local) if is_full_name(local) else None
            if name is not None and self._side.may_call(name):
                servers[name] = [each for each in self._view.servers(local) if each.participant not in ours]
        self._servers = servers
        self.offers = {name: offer for name in sorted(servers) if (offer := self._offer(name)) is not None}
        for (name, type_name), client in [*self._clients.items()]:  # a participant has one type per name
            offer = self.offers.get(name)
            if (offer is None or offer.type_name != type_name) and client.is_idle:
                self._clients.pop((name, type_name)).destroy()
        offered, session = self.offered
        self._follow(offered, session)
        self._nodes.keep(_OWNER, {self._side.local_name(offer.node) for offer in offered.values()})

    def _offer(self, name: str) -> ServiceOffer | None:
        """Return the first server whose node is known."""
        named = [server for server in self._servers[name] if server.node]
        if (first := min(named, key=lambda server: server.node, default=None)) is None:
            return None
        # The type of DDS, example_interfaces::srv::dds_::AddTwoInts_Request_, has another name in ROS.
        type_name = first.type_name.replace("::dds_::", "::").removesuffix("_Request_").replace("::", "/")
        return ServiceOffer(type_name=type_name, node=self._side.robot_name(first.node) or first.node)

    def arrived(self, sender: int, data: bytes) -> None:
        """Take a record of the other end later, in the own thread; the sender is its session."""
        self._arrived.append((sender, data))
        self.thread.wake()

    def _take(self, sender: int, data: bytes) -> None:
        """Take a record of the other end."""
        try:
            record = decode_record(data)
            if record.to == self._session:
                self._book.receive(sender, record)
        except ValueError as fault:
            if self._logged.take("", self._clock()):
                log.warning("ignored a record of the other end: %s (logged once a minute)", fault)

    # -- calls of this side

    def _follow(self, offered: Mapping[str, ServiceOffer], session: int | None) -> None:
        """Serve here what the other end offers, and nothing else."""
        self._book.follow(session)
        changed = {name for name, ghost in self._ghosts.items() if offered.get(name) != ghost.offer}
        for name in changed:
            self._withdraw(name, "the other end offers it no more")
        # A participant has one type per name, so the next look is soon enough for one that changed.
        asked = {name: offer for name, offer in offered.items() if name not in changed}
        self.refused = {name: reason for name, offer in asked.items() if (reason := self._serve(name, offer))}
        for name, reason in self.refused.items():
            self._withdraw(name, reason)

    def _serve(self, name: str, offer: ServiceOffer) -> str:
        """Make a ghost of this service where there is none; return why there must not be one."""
        if not self._side.may_call(name):
            return "relay.services and relay.actions of this end do not allow it"
        if self._servers.get(name):
            return "a node on this side serves it, too; that one stays"
        if name in self._ghosts:
            return ""
        try:
            self._ghosts[name] = GhostServer(
                self._nodes.of(self._side.local_name(offer.node), owner=_OWNER),
                offer,
                self._side.local_name(name),
                self.thread,
                partial(self._call, name),
            )
        except UnknownTypeError as error:
            return str(error)
        except _REFUSED as error:
            return f"the middleware says: {error}"
        return ""

    def _withdraw(self, name: str, reason: str) -> None:
        if name in self._ghosts:
            self._book.fail(name, f"{reason}; the call may have run")
            self._ghosts.pop(name).destroy()

    def _call(self, name: str, message: Any, header: Any) -> None:
        """Pass a request of a node on this side to the other end."""
        ghost = self._ghosts[name]
        self._book.call(
            Request(name, ghost.offer.type_name, bytes(serialize_message(message))),
            timeout_s=math.inf if name.endswith(_GET_RESULT) else self._timeout_s,
            now_s=self._clock(),
            on_end=partial(self._end, name, ghost, header),
        )

    def _end(self, name: str, ghost: GhostServer, header: Any, outcome: Outcome) -> None:
        if isinstance(outcome, bytes):
            try:
                ghost.answer(header, deserialize_message(outcome, ghost.kind.Response))
            except (RuntimeError, ValueError) as error:
                outcome = CallFailure(FailureReason.TYPE, f"its answer cannot be read: {error}")
        if isinstance(outcome, CallFailure):
            self.failures[outcome.reason.value] += 1
            if self._logged.take((name, outcome.reason), self._clock()):
                log.warning("a call of %s failed: %s", name, outcome.message)
            if (response := failed_response(ghost.kind, ghost.offer.type_name, outcome)) is not None:
                ghost.answer(header, response)

    # -- calls of the other side

    def _run(self, call: CallId, request: Request) -> None:
        name, offer = request.service, self.offers.get(request.service)
        if offer is None:
            self._fail(call, FailureReason.NO_SERVER, f"{name} is not offered")
        elif offer.type_name != request.type_name:
            self._fail(call, FailureReason.TYPE, f"{name} is a {offer.type_name} here, not a {request.type_name}")
        else:
            try:
                client = self._client(name, offer.type_name)
                client.call(call, deserialize_message(request.body, client.kind.Request))
            except UnknownTypeError as error:
                self._fail(call, FailureReason.TYPE, str(error))
            except _REFUSED as error:
                self._fail(call, FailureReason.TYPE, f"the middleware says: {error}")

    def _client(self, name: str, type_name: str) -> LocalClient:
        if (name, type_name) not in self._clients:
            kind, local = service_class(type_name), self._side.local_name(name)
            made = LocalClient(self._node, kind, local, self.thread, self._finish, clock=self._clock)
            self._clients[name, type_name] = made
        return self._clients[name, type_name]

    def _finish(self, call: CallId, response: Any) -> None:
        try:
            self._book.finish(call, bytes(serialize_message(response)))
        except RuntimeError as error:
            self._fail(call, FailureReason.TYPE, f"the middleware says: {error}")

    def _fail(self, call: CallId, reason: FailureReason, message: str) -> None:
        self._book.finish(call, CallFailure(reason, f"the other end says: {message}"))

    def _stop(self, call: CallId) -> None:
        for client in self._clients.values():
            client.stop(call)
