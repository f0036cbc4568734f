"""Services and actions of one side that nodes of the other can call, at one end."""

from __future__ import annotations

import logging
import math
import time
from collections import Counter, deque
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.exceptions import NameValidationException
from rclpy.serialization import deserialize_message, serialize_message

from arpd.relay.calls import CallBook, CallFailure, CallId, FailureReason, Outcome, Request
from arpd.relay.ends.offers import ServiceOffer
from arpd.relay.ends.services import GhostServer, LocalClient, class_of, failed_response
from arpd.relay.ends.types import UnknownTypeError
from arpd.ros.graph import GraphView
from arpd.ros.names import is_full_name
from arpd.ros.rate_limits import OncePerMinute
from arpd.ros.raw_reader import ReadingThread

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from rclpy.node import Node

    from arpd.relay.ends.ghosts import GhostNodes
    from arpd.relay.envelope import Chunk
    from arpd.relay.selection import Side
    from arpd.ros.graph import Endpoint

log = logging.getLogger(__name__)
_STEP_S, _LOOK_S = 0.1, 0.5
_LAST_S = 0.1  # a client that hears that its server goes drops responses that it has not read
_MOST_LAST_S = 1.0  # for responses to leave: an end is to stop within 2 s
_NO_MORE = "the other end offers it no more"
_SILENT = "the other end has been unreachable for too long"
_GET_RESULT = "/_action/get_result"  # waits for the end of its goal
_REFUSED = (UnknownTypeError, NameValidationException, RuntimeError, ValueError)


class Calls:
    """Lets nodes on this side call services of the other side, and the other way round.

    Every service that the other end offers gets a ghost server here, under a node with the name of the real server's
    node. A call runs at most once. One without an answer fails, with a response that says so where its type can; so
    does one whose server is gone, together with its offer. Servers of this process, ghosts above all, are not offered.
    All works in one thread, which may wait for a server or a client here.

    Parameters
    ----------
    send : writes one record to the link, as `CallBook` says
    timeout_s : time after which a call without an answer has failed; the result of an action may take any time (s)

    Attributes
    ----------
    offered : services of the other side, and its session, None = unreachable; the end's own thread sets it
    offers : services of this side that the other side may call, by their names on the link
    failures : calls from this side that failed, by reason
    refused : services of the other side that are not served here, and the reason
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
        self._node, self._nodes, self._side = node, nodes, side
        self._timeout_s = timeout_s
        self._view = GraphView.of(node)
        self._ghosts: dict[str, GhostServer] = {}  # by name on the link
        self._leaving: Collection[str] = ()  # of these, those that go with the next look
        self._clients: dict[str, LocalClient] = {}  # by name on the link
        self._step_s = self._look_s = time.monotonic()
        self._logged = OncePerMinute()
        self._arrived: deque[tuple[int, bytes]] = deque()  # records of the other end, and its session
        self.offered: tuple[Mapping[str, ServiceOffer], int | None] = {}, None
        self._session_there: int | None = None  # that was followed last
        self.offers: Mapping[str, ServiceOffer] = {}
        self.refused: Mapping[str, str] = {}
        self.failures: Counter[str] = Counter()
        self._book = CallBook(session, send=send, run=self._run)
        self.thread = ReadingThread(step=self._step)

    def close(self) -> None:
        """Fail the calls that are under way, and remove all servers and clients."""
        self.thread.stop()
        self._book.close()
        until_s = time.monotonic() + _MOST_LAST_S
        while (due_s := _released(self._ghosts.values(), now_s := time.monotonic())) < until_s:
            time.sleep(max(0.0, due_s - now_s))
        time.sleep(_LAST_S)
        for each in (*self._ghosts.values(), *self._clients.values()):
            each.destroy()

    def deliver(self, record: bytes, chunk: Chunk, _age_s: float) -> None:
        """Take a record of the other end later, in the own thread."""
        self._arrived.append((chunk.session, record))
        self.thread.wake()

    def _step(self) -> float:
        """Do what is due; return when to call again (s)."""
        while self._arrived:
            try:
                self._book.receive(*self._arrived.popleft())
            except ValueError as fault:
                if self._logged.take("", time.monotonic()):
                    log.warning("ignored a record of the other end: %s (logged once a minute)", fault)
        now_s = time.monotonic()
        if now_s >= self._step_s:
            self._step_s = now_s + _STEP_S
            if now_s >= self._look_s or self.offered[1] != self._session_there:
                self._look_s = now_s + _LOOK_S
                self._look()
            self._book.step(now_s)
        return min(self._step_s, _released((*self._ghosts.values(), *self._clients.values()), now_s))

    # -- calls of this side

    def _look(self) -> None:
        self._view.look()
        ours, servers = self._view.ours, {}
        for local in sorted(self._view.services):
            name = self._side.robot_name(local) if is_full_name(local) else None
            if name is not None and self._side.may_call(name):
                servers[name] = [each for each in self._view.servers(local) if each.participant not in ours]
        self.offers = {name: offer for name, found in servers.items() if (offer := self._offer(name, found))}
        for name, client in [*self._clients.items()]:
            client.follow(frozenset(each.gid for each in servers.get(name, ())))
            if self.offers.get(name) != client.offer:
                self._clients.pop(name).destroy()
        offered, self._session_there = self.offered
        self._follow(offered, self._session_there, {name for name, found in servers.items() if found})

    def _offer(self, name: str, servers: list[Endpoint]) -> ServiceOffer | None:
        """Return the first server whose node is known, and whose writer of responses."""
        if not servers:
            return None  # nothing to read: the base computer's end has ghosts of all services, and few servers
        found = self._view.responders(self._side.local_name(name))
        responders = {(each.participant, each.node): each.type_hash for each in found}
        named = [server for server in servers if server.node and (server.participant, server.node) in responders]
        if (first := min(named, key=lambda server: server.node, default=None)) is None:
            return None
        # The type of DDS, example_interfaces::srv::dds_::AddTwoInts_Request_, has another name in ROS.
        type_name = first.type_name.replace("::dds_::", "::").removesuffix("_Request_").replace("::", "/")
        hashes = first.type_hash, responders[first.participant, first.node]
        return ServiceOffer(type_name=type_name, node=self._side.node_name(first.node), type_hashes=hashes)

    def _follow(self, offered: Mapping[str, ServiceOffer], session: int | None, served: Collection[str]) -> None:
        """Serve here what the other end offers, and nothing else; not what is served on this side."""
        self._book.follow(session)
        if session is None:  # a goal outlives an outage, so its result is awaited
            offered = {name: offer for name, offer in offered.items() if name.endswith(_GET_RESULT)}
        refused = {name: reason for name in offered if (reason := self._reason_against(name, served))}
        accepted = {name: offer for name, offer in offered.items() if name not in refused}
        # A participant has one type per name, so the next look is soon enough for one that changed.
        new = accepted.keys() - self._ghosts.keys()
        leaving = [name for name, ghost in self._ghosts.items() if accepted.get(name) != ghost.offer]
        for name in leaving:
            reason = FailureReason.UNREACHABLE if session is None else FailureReason.NO_SERVER
            words = _SILENT if session is None else refused.get(name, _NO_MORE)
            self._book.fail(name, reason, f"{words}; the call may have run")
            if name in self._leaving and self._ghosts[name].is_idle:  # its last responses have arrived
                self._ghosts.pop(name).destroy()
        self._leaving = self._ghosts.keys() & leaving
        for name in new:
            try:
                self._ghosts[name] = self._ghost(name, accepted[name])
            except _REFUSED as error:
                refused[name] = str(error)
        self.refused = refused

    def _reason_against(self, name: str, served: Collection[str]) -> str:
        """Return why there must not be a ghost of this service; empty if there may be one."""
        if not self._side.may_call(name):
            return "relay.services and relay.actions of this end do not allow it"
        return "a node on this side serves it, too; that one stays" if name in served else ""

    def _ghost(self, name: str, offer: ServiceOffer) -> GhostServer:
        kind = class_of(offer)  # before there is a node: it would come and go with every look where this raises
        local, call = self._side.local_name(name), partial(self._call, name)
        return self._nodes.give(
            self._side.local_name(offer.node),
            lambda node: GhostServer(node, offer, kind, local, self.thread, on_request=call),
        )

    def _call(self, name: str, message: Any, header: Any) -> None:
        """Pass a request of a node on this side to the other end."""
        ghost = self._ghosts[name]
        if name in self._leaving and self._session_there is not None:
            if name not in self.refused:  # else the server on this side answers
                self._end(name, ghost, header, CallFailure(FailureReason.NO_SERVER, _NO_MORE))
            return
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
            ghost.send(header, response)

    # -- calls of the other side

    def _run(self, call: CallId, request: Request) -> None:
        name, offer = request.service, self.offers.get(request.service)
        if offer is None:
            self._book.finish(call, CallFailure(FailureReason.NO_SERVER, f"{name} is not offered"))
            return
        try:
            if offer.type_name != request.type_name:
                raise UnknownTypeError(f"{name} is a {offer.type_name} here, not a {request.type_name}")
            if name not in self._clients:
                local = self._side.local_name(name)
                self._clients[name] = LocalClient(self._node, offer, local, self.thread, self._book)
            self._clients[name].send(call, request.body)
        except _REFUSED as error:
            self._book.finish(call, CallFailure(FailureReason.TYPE, str(error)))


def _released(endpoints: Iterable[GhostServer | LocalClient], now_s: float) -> float:
    """Let leave what may; return when more may (s)."""
    return min((each.release(now_s) for each in endpoints), default=math.inf)
