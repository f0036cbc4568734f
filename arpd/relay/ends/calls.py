"""Services and actions of the other side, which nodes on this side can call, in the local domain of one end."""

from __future__ import annotations

import logging
import math
import time
from collections import Counter, deque
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import InvalidServiceNameException, NameValidationException
from rclpy.serialization import deserialize_message, serialize_message

from arpd.relay.calls import Caller, CallFailure, FailureReason, Request, decode_record
from arpd.relay.ends.served_calls import AT_ONCE, CALLS_QOS, ServedCalls
from arpd.relay.ends.types import UnknownTypeError, service_class
from arpd.relay.offers import ServiceOffer
from arpd.ros.graph_view import GraphView
from arpd.ros.names import is_full_name
from arpd.ros.rate_limits import OncePerMinute

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from arpd.relay.calls import Outcome
    from arpd.relay.ends.call_link import CallLink
    from arpd.relay.ends.ghosts import GhostNodes

log = logging.getLogger(__name__)
_TICK_S = 0.02  # between bursts of requests to a server, and of answers to a client
_LOOK_S = 0.5
_OWNER = "services"
_MOST_RECORDS = 1000  # that wait for a tick; a call whose record is dropped repeats it
_GET_RESULT = "/_action/get_result"  # waits for the end of its goal
_STATUS_UNKNOWN, _STATUS_ABORTED = 0, 6  # action_msgs/msg/GoalStatus


class Calls:
    """Lets nodes on this side call services of the other side, and the other way round.

    Every service that the other end offers gets a ghost server here, under a node with the name of the real server's
    node. A call runs at most once. One without an answer fails, with a response that says so where its type can.
    Names on the link are those on the robot. All works in the thread of the node's executor, which a record wakes.

    Parameters
    ----------
    node : this end's node in the local domain
    nodes : ghosts of the other side's nodes
    link : carries the records; None = nothing may be called
    session : of this process, 32 bit
    allows : returns whether a service with this name on the robot may be called across the link
    timeout_s : time after which a call without an answer has failed; the result of an action may take any time (s)
    local_name, robot_name : return the name on this side and the one on the robot, None where it has none there
    clock : monotonic clock (s)

    Attributes
    ----------
    offered : services of the other side, and its session, None = unreachable; the end's own thread sets it
    offers : services of this side that the other side may call, by their names on the link
    failures : calls from this side that failed, by reason
    refused : services of the other side that are not served here, and the reason
    malformed : records of the other end that were none
    """

    def __init__(
        self,
        node: Any,
        nodes: GhostNodes,
        link: CallLink | None,
        *,
        session: int,
        allows: Callable[[str], bool],
        timeout_s: float,
        local_name: Callable[[str], str],
        robot_name: Callable[[str], str | None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._node, self._nodes, self._link = node, nodes, link
        self._session = session
        self._view = GraphView.of(node)
        self._allows = allows
        self._timeout_s = timeout_s
        self._local_name, self._robot_name = local_name, robot_name
        self._clock = clock
        self._ghosts: dict[str, GhostService] = {}  # by name on the link
        self._records: deque[tuple[int, bytes]] = deque(maxlen=_MOST_RECORDS)
        self._is_woken = False
        self._look_s = clock()
        self._logged = OncePerMinute()
        self.offered: tuple[Mapping[str, ServiceOffer], int | None] = MappingProxyType({}), None
        self.offers: Mapping[str, ServiceOffer] = MappingProxyType({})
        self.refused: Mapping[str, str] = MappingProxyType({})
        self.failures: Counter[str] = Counter()
        self.malformed = 0
        if link is not None:
            self._caller = Caller(send=link.send)
            self._served = ServedCalls(node, self._view, send=link.send, local_name=local_name, clock=clock)
            node.create_timer(_TICK_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
            link.open(self._arrive)

    def close(self) -> None:
        """Fail the calls that are under way, and remove all servers and clients; the executor has stopped."""
        if self._link is not None:
            self._link.close()
            self._follow({}, None)
            self._served.destroy()

    def _tick(self) -> None:
        now_s = self._clock()
        if now_s >= self._look_s:
            self._look_s = now_s + _LOOK_S
            self._look()
        self._take()
        self._caller.step(now_s)
        self._served.step(now_s)
        for ghost in self._ghosts.values():
            ghost.step()

    def _look(self) -> None:
        names = {}
        self._view.look()
        for local in self._view.services:
            name = self._robot_name(local) if is_full_name(local) else None
            if name is not None and self._allows(name):
                names[name] = local
        self.offers = {
            name: ServiceOffer(type_name=offer.type_name, node=self._robot_name(offer.node) or offer.node)
            for name, offer in self._served.look(names).items()
        }
        offered, session = self.offered
        self._follow(offered, session)
        self._nodes.release(_OWNER, {self._local_name(offer.node) for offer in offered.values()})

    def _follow(self, offered: Mapping[str, ServiceOffer], session: int | None) -> None:
        """Serve here what the other end offers, and nothing else."""
        self._caller.follow(session)
        self._served.callee.follow(session)
        changed = {name for name, ghost in self._ghosts.items() if offered.get(name) != ghost.offer}
        for name in changed:
            self._withdraw(name, "the other end offers it no more")
        refused = {}
        for name, offer in offered.items():
            reason = self._reason_against(name, offer)
            # A participant has one type per name, so the next look is soon enough for one that changed.
            if not reason and name not in self._ghosts and name not in changed:
                reason = self._serve(name, offer)
            if reason:
                self._withdraw(name, reason)
                refused[name] = reason
        self.refused = refused

    def _reason_against(self, name: str, offer: ServiceOffer) -> str:
        if not is_full_name(self._local_name(name)) or not is_full_name(self._local_name(offer.node)):
            return f"no names of ROS: {name!r} on {offer.node!r}"
        if not self._allows(name):
            return "relay.services and relay.actions of this end do not allow it"
        return "a node on this side serves it, too; that one stays" if self._served.is_served(name) else ""

    def _serve(self, name: str, offer: ServiceOffer) -> str:
        """Make a ghost of this service; return why there is none."""
        try:
            node = self._nodes.served(self._local_name(offer.node), owner=_OWNER)
            self._ghosts[name] = GhostService(node, offer, self._local_name(name), partial(self._call, name))
        except UnknownTypeError as error:
            return str(error)
        except (InvalidServiceNameException, NameValidationException, RuntimeError, ValueError) as error:
            return f"the middleware says: {error}"
        return ""

    def _withdraw(self, name: str, reason: str) -> None:
        if name in self._ghosts:
            self._caller.fail(name, f"{reason}; the call may have run")
            self._ghosts.pop(name).destroy()

    def _call(self, name: str, message: Any, header: Any) -> None:
        """Pass a request of a node on this side to the other end."""
        if (ghost := self._ghosts.get(name)) is None:
            return
        self._caller.call(
            Request(name, ghost.offer.type_name, bytes(serialize_message(message))),
            timeout_s=math.inf if name.endswith(_GET_RESULT) else self._timeout_s,
            now_s=self._clock(),
            on_end=partial(self._end, name, ghost, header),
        )

    def _end(self, name: str, ghost: GhostService, header: Any, outcome: Outcome) -> None:
        if isinstance(outcome, bytes):
            try:
                ghost.answer(deserialize_message(outcome, ghost.kind.Response), header)
            except (RuntimeError, ValueError) as error:
                outcome = CallFailure(FailureReason.TYPE, f"its answer cannot be read: {error}")
        if isinstance(outcome, CallFailure):
            self.failures[outcome.reason.value] += 1
            if self._logged.take((name, outcome.reason), self._clock()):
                log.warning("a call of %s failed: %s", name, outcome.message)
            if (response := failed_response(ghost.kind, ghost.offer.type_name, outcome)) is not None:
                ghost.answer(response, header)

    def _arrive(self, sender: int, record: bytes) -> None:
        """Take a record of the other end, in any thread."""
        self._records.append((sender, record))
        # EventsExecutor has no guard conditions, but both executors wake for a task.
        if not self._is_woken and (executor := self._node.executor) is not None:
            self._is_woken = True
            executor.create_task(self._take)

    def _take(self) -> None:
        self._is_woken = False
        while self._records:
            sender, data = self._records.popleft()
            try:
                record = decode_record(data)
                if record.to == self._session:
                    self._caller.receive(sender, record)
                    self._served.callee.receive(sender, record)
            except ValueError as error:
                self.malformed += 1
                if self._logged.take("malformed", self._clock()):
                    log.warning("a record of the other end was ignored: %s (logged once a minute)", error)


class GhostService:
    """A server of a service of the other side; it answers each request later, without blocking its executor.

    rclpy has no such server. Its executors send what the callback returns at once. A coroutine would keep an executor
    busy until the answer comes, and Jazzy's EventsExecutor takes none. But every executor sends through
    ``send_response`` of the service, with the request's header. So this callback returns the request, and
    ``send_response`` of this one service hands both on.

    Parameters
    ----------
    node : node that the server belongs to
    offer : the service
    name : fully qualified name
    on_request : called with each request and its header
    """

    def __init__(self, node: Any, offer: ServiceOffer, name: str, on_request: Callable[[Any, Any], None]) -> None:
        self.offer, self.kind = offer, service_class(offer.type_name)
        self._node = node
        self._answers: deque[tuple[Any, Any]] = deque()
        self._sent = 0  # since the last step
        self._service: Any = node.create_service(
            self.kind, name, lambda request, _response: request, qos_profile=CALLS_QOS
        )
        self._send: Callable[[Any, Any], None] = self._service.send_response
        self._service.send_response = on_request

    def answer(self, response: Any, header: Any) -> None:
        """Send the response of one request, unless the server is gone; where many just left, after the next `step`."""
        self._answers.append((response, header))
        self._release(AT_ONCE)

    def step(self) -> None:
        """Send some of the responses that wait."""
        self._sent = 0
        self._release(AT_ONCE)

    def destroy(self) -> None:
        """Send all that waits, and remove the server, so that clients see at once that the service is not there."""
        self._release(math.inf)
        service, self._service = self._service, None
        self._node.destroy_service(service)

    def _release(self, most: float) -> None:
        while self._service is not None and self._answers and self._sent < most:
            self._sent += 1
            self._send(*self._answers.popleft())


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
