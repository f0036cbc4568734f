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

from arpd.relay.calls import CallBook, CallFailure, CallId, FailureReason, Record, Request
from arpd.relay.ends.offers import ServiceOffer
from arpd.relay.ends.services import GhostServer, LocalClient, failed_response
from arpd.relay.ends.types import UnknownTypeError, service_class
from arpd.ros.graph_view import GraphView
from arpd.ros.names import is_full_name
from arpd.ros.rate_limits import OncePerMinute
from arpd.ros.raw_reader import ReadingThread

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from rclpy.node import Node

    from arpd.relay.calls import Outcome
    from arpd.relay.ends.ghosts import GhostNodes
    from arpd.relay.selection import Side
    from arpd.ros.graph import Endpoint

log = logging.getLogger(__name__)
_STEP_S, _BURST_S = 0.1, 0.02  # between steps; and while more waits than a server or a client may get at once
_AT_ONCE = 5  # messages that one server or client gets between steps: their own histories have ten places
_LOOK_S = 0.5
_GET_RESULT = "/_action/get_result"  # waits for the end of its goal
_REFUSED = (UnknownTypeError, InvalidServiceNameException, NameValidationException, RuntimeError, ValueError)


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
    send : writes one record to the link, as `CallBook` says
    session : of this process, 32 bit
    side : names on this side
    timeout_s : time after which a call without an answer has failed; the result of an action may take any time (s)

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
        send: Callable[[bytes, int], None],
        *,
        session: int,
        side: Side,
        timeout_s: float,
    ) -> None:
        self._node, self._nodes, self._session, self._side = node, nodes, session, side
        self._timeout_s = timeout_s
        self._view = GraphView.of(node)
        self._ghosts: dict[str, GhostServer] = {}  # by name on the link
        self._clients: dict[str, tuple[ServiceOffer, LocalClient]] = {}  # likewise
        self._stepped_s = self._look_s = time.monotonic()
        self._logged = OncePerMinute()
        self._arrived: deque[tuple[int, bytes]] = deque()  # records of the other end, and its session
        self._waiting: deque[tuple[GhostServer | LocalClient, Any, Any]] = deque()  # messages, and what each belongs to
        self._sent: Counter[GhostServer | LocalClient] = Counter()  # since the last step
        self.offered: tuple[Mapping[str, ServiceOffer], int | None] = {}, None
        self.offers: Mapping[str, ServiceOffer] = {}
        self.refused: Mapping[str, str] = {}
        self.failures: Counter[str] = Counter()
        self._book = CallBook(send=send, run=self._run)
        self.thread = ReadingThread(step=self._step)

    def close(self) -> None:
        """Fail the calls that are under way, and remove all servers and clients."""
        self.thread.stop()
        self._follow({}, None)
        while self._clients:
            self._clients.popitem()[1][1].destroy()

    def arrived(self, sender: int, data: bytes) -> None:
        """Take a record of the other end later, in the own thread; the sender is its session."""
        self._arrived.append((sender, data))
        self.thread.wake()

    def _step(self) -> float:
        """Do what is due; return when to call again (s)."""
        while self._arrived:
            self._take(*self._arrived.popleft())
        now_s = time.monotonic()
        if now_s >= self._stepped_s + (_BURST_S if self._waiting else _STEP_S):
            self._stepped_s = now_s
            if now_s >= self._look_s:
                self._look_s = now_s + _LOOK_S
                self._look()
            self._book.step(now_s)
            self._sent.clear()
            self._release()
        return self._stepped_s + (_BURST_S if self._waiting else _STEP_S)

    def _take(self, sender: int, data: bytes) -> None:
        try:
            record = Record.decode(data)
            if record.to == self._session:
                self._book.receive(sender, record)
        except ValueError as fault:
            if self._logged.take("", time.monotonic()):
                log.warning("ignored a record of the other end: %s (logged once a minute)", fault)

    def _send(self, endpoint: GhostServer | LocalClient, owner: Any, message: Any) -> None:
        """Send a message, with its call or its header; where many just left, after the next step."""
        self._waiting.append((endpoint, owner, message))
        self._release()

    def _release(self) -> None:
        now_s, kept = time.monotonic(), []
        try:
            while self._waiting:
                endpoint, owner, message = each = self._waiting.popleft()
                if isinstance(owner, CallId) and not self._book.runs(owner):
                    continue  # given up before it left
                if endpoint.is_ready(now_s) and self._sent[endpoint] < _AT_ONCE:
                    self._sent[endpoint] += 1
                    self._hand_over(endpoint, owner, message)
                else:
                    kept.append(each)
        finally:  # one that cannot be sent keeps no other
            self._waiting.extendleft(reversed(kept))

    def _hand_over(self, endpoint: GhostServer | LocalClient, owner: Any, message: Any) -> None:
        try:
            endpoint.send(owner, message)
        except _REFUSED as error:
            if not isinstance(owner, CallId):
                raise
            self._fail(owner, FailureReason.TYPE, f"the middleware says: {error}")

    # -- calls of this side

    def _look(self) -> None:
        """Follow the graph and the other end."""
        self._view.look()
        ours, servers = self._view.ours, {}
        for local in sorted(self._view.services):
            name = self._side.robot_name(local) if is_full_name(local) else None
            if name is not None and self._side.may_call(name):
                servers[name] = [each for each in self._view.servers(local) if each.participant not in ours]
        self.offers = {name: offer for name, found in servers.items() if (offer := self._offer(found)) is not None}
        for name, (offer, client) in [*self._clients.items()]:
            client.keep(self._book.runs)
            if self.offers.get(name) != offer:
                waiting = [owner for endpoint, owner, _ in self._waiting if endpoint is client]
                for call in (*client.running, *waiting):
                    self._fail(call, FailureReason.NO_SERVER, f"{name} is not offered any more")
                self._clients.pop(name)[1].destroy()
        offered, session = self.offered
        self._follow(offered, session, served={name for name, found in servers.items() if found})

    def _offer(self, servers: list[Endpoint]) -> ServiceOffer | None:
        """Return the first server whose node is known."""
        named = [server for server in servers if server.node]
        if (first := min(named, key=lambda server: server.node, default=None)) is None:
            return None
        # The type of DDS, example_interfaces::srv::dds_::AddTwoInts_Request_, has another name in ROS.
        type_name = first.type_name.replace("::dds_::", "::").removesuffix("_Request_").replace("::", "/")
        return ServiceOffer(type_name=type_name, node=self._side.robot_name(first.node) or first.node)

    def _follow(
        self, offered: Mapping[str, ServiceOffer], session: int | None, served: Collection[str] = frozenset()
    ) -> None:
        """Serve here what the other end offers, and nothing else."""
        self._book.follow(session)
        changed = {name for name, ghost in self._ghosts.items() if offered.get(name) != ghost.offer}
        for name in changed:
            self._withdraw(name, "the other end offers it no more")
        # A participant has one type per name, so the next look is soon enough for one that changed.
        asked = {name: offer for name, offer in offered.items() if name not in changed}
        self.refused = {name: reason for name, offer in asked.items() if (reason := self._serve(name, offer, served))}
        for name in self._ghosts.keys() & self.refused:
            self._withdraw(name, self.refused[name])

    def _serve(self, name: str, offer: ServiceOffer, served: Collection[str]) -> str:
        """Make a ghost of this service where there is none; return why there must not be one."""
        if not self._side.may_call(name):
            return "relay.services and relay.actions of this end do not allow it"
        if name in served:
            return "a node on this side serves it, too; that one stays"
        if name not in self._ghosts:
            local, on_request = self._side.local_name(name), partial(self._call, name)
            try:
                self._ghosts[name] = self._nodes.give(
                    self._side.local_name(offer.node),
                    lambda node: GhostServer(node, offer, local, self.thread, on_request),
                )
            except _REFUSED as error:
                return str(error)
        return ""

    def _withdraw(self, name: str, reason: str) -> None:
        self._book.fail(name, f"{reason}; the call may have run")
        ghost = self._ghosts.pop(name)
        for endpoint, header, response in self._waiting:
            if endpoint is ghost:
                ghost.send(header, response)
        self._waiting = deque(each for each in self._waiting if each[0] is not ghost)
        ghost.destroy()

    def _call(self, name: str, message: Any, header: Any) -> None:
        """Pass a request of a node on this side to the other end."""
        ghost = self._ghosts[name]
        self._book.call(
            Request(name, ghost.offer.type_name, bytes(serialize_message(message))),
            timeout_s=math.inf if name.endswith(_GET_RESULT) else self._timeout_s,
            now_s=time.monotonic(),
            on_end=partial(self._end, name, ghost, header),
        )

    def _end(self, name: str, ghost: GhostServer, header: Any, outcome: Outcome) -> None:
        response = None
        if isinstance(outcome, bytes):
            try:
                response = deserialize_message(outcome, ghost.kind.Response)
            except (RuntimeError, ValueError) as error:
                outcome = CallFailure(FailureReason.TYPE, f"its answer cannot be read: {error}")
        if isinstance(outcome, CallFailure):
            self.failures[outcome.reason.value] += 1
            if self._logged.take((name, outcome.reason), time.monotonic()):
                log.warning("a call of %s failed: %s", name, outcome.message)
            response = failed_response(ghost.kind, ghost.offer.type_name, outcome)
        if response is not None:
            self._send(ghost, header, response)

    # -- calls of the other side

    def _run(self, call: CallId, request: Request) -> None:
        name, offer = request.service, self.offers.get(request.service)
        if offer is None:
            self._fail(call, FailureReason.NO_SERVER, f"{name} is not offered")
            return
        if offer.type_name != request.type_name:
            words = f"{name} is a {offer.type_name} here, not a {request.type_name}"
            self._fail(call, FailureReason.TYPE, words)
            return
        try:
            if name not in self._clients:
                kind, local = service_class(offer.type_name), self._side.local_name(name)
                client = LocalClient(self._node, kind, local, self.thread, self._finish)
                self._clients[name] = offer, client
            _, client = self._clients[name]
            self._send(client, call, deserialize_message(request.body, client.kind.Request))
        except _REFUSED as error:
            self._fail(call, FailureReason.TYPE, str(error))

    def _finish(self, call: CallId, response: Any) -> None:
        try:
            self._book.finish(call, bytes(serialize_message(response)))
        except RuntimeError as error:
            self._fail(call, FailureReason.TYPE, str(error))

    def _fail(self, call: CallId, reason: FailureReason, message: str) -> None:
        self._book.finish(call, CallFailure(reason, f"the other end says: {message}"))
