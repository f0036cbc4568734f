"""Services and actions across the link, in the local domain of one end."""

from __future__ import annotations

import logging
import time
from collections import Counter
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.exceptions import InvalidServiceNameException, NameValidationException
from rclpy.serialization import deserialize_message, serialize_message

from arpd.adapters.ros.ends.ghost_service import GhostService, failed_response
from arpd.adapters.ros.ends.local_services import LocalServices
from arpd.adapters.ros.ends.served_calls import ServedCalls
from arpd.adapters.ros.ends.types import UnknownTypeError, service_class
from arpd.adapters.ros.names import is_full_name
from arpd.apply.relay.call_records import CallFailure, FailureReason, Request, decode_record
from arpd.apply.relay.calls import Caller
from arpd.apply.relay.offers import ServiceOffer
from arpd.apply.relay.selection import far_name, robot_name
from arpd.observe.rate_limits import OncePerMinute

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from arpd.apply.relay.call_records import Outcome

log = logging.getLogger(__name__)
_GET_RESULT = "/_action/get_result"  # waits for the end of its goal


@dataclass(frozen=True, slots=True)
class _Ghost:
    """A service of the other side that nodes on this side can call."""

    offer: ServiceOffer
    kind: Any
    service: GhostService


class Calls:
    """Lets nodes on this side call services of the other side, and the other way round.

    Every service that the other end offers gets a ghost server here, under a node with the name of the real server's
    node. A call runs at most once. One without an answer fails, with a response that says so where its type can.
    Names on the link are those on the robot; ``namespace`` stands before them here. All methods are called in the
    executor's thread.

    Parameters
    ----------
    node : this end's node in the local domain
    send : writes one record to the link
    ghost_node : returns the node with this fully qualified name; it must be in the context and the executor of ``node``
    allows : returns whether a service with this name on the robot may be called across the link
    timeout_s : time after which a call without an answer has failed; the result of an action may take any time (s)
    session : of this process
    namespace : stands before all of the robot's names on this side; empty on the robot
    clock : monotonic clock (s)

    Attributes
    ----------
    failures : calls from this side that failed, by reason
    refused : services of the other side that are not served here, and the reason
    malformed : records of the other end that were none
    """

    def __init__(
        self,
        node: Any,
        *,
        send: Callable[[bytes], None],
        ghost_node: Callable[[str], Any],
        allows: Callable[[str], bool],
        timeout_s: float,
        session: str,
        namespace: str = "",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._ghost_node = ghost_node
        self._allows = allows
        self._timeout_s = timeout_s
        self._namespace = namespace
        self._clock = clock
        self._services = LocalServices(node)
        self._caller = Caller(session=session, send=send)
        self._served = ServedCalls(node, send=send, session=session, offered=self._offered, clock=clock)
        self._ghosts: dict[str, _Ghost] = {}  # by name on the link, as `refused`
        self._logged = OncePerMinute()
        self.failures: Counter[str] = Counter()
        self.refused: dict[str, str] = {}
        self.malformed = 0

    @property
    def under_way(self) -> tuple[int, int]:
        """Calls from this side, and calls to this side, that wait for an outcome."""
        return len(self._caller), len(self._served)

    def offers(self) -> dict[str, ServiceOffer]:
        """Return the services of this side that the other side may call, by their names on the link."""
        found = self._services.look(lambda name: self._link_name(name) is not None)
        return {
            link_name: ServiceOffer(
                type_name=offer.type_name, node=robot_name(offer.node, self._namespace) or offer.node
            )
            for name, offer in found.items()
            if (link_name := self._link_name(name)) is not None
        }

    def follow(self, offered: Mapping[str, ServiceOffer], *, session: str | None) -> None:
        """Serve here what the other end offers, and nothing else; call it again and again.

        Parameters
        ----------
        offered : services of the other side, by their names on the link
        session : of the other end; None = it is unreachable, then all calls fail and no service of it is here
        """
        self._caller.follow(session)
        self._served.follow(session)
        wanted = offered if session is not None else {}
        changed = {name for name, ghost in self._ghosts.items() if wanted.get(name) != ghost.offer}
        for name in changed:
            self._withdraw(name, "the other end offers it no more")
        self.refused = {name: reason for name, reason in self.refused.items() if name in wanted}
        for name, offer in wanted.items():
            if name not in changed:  # a participant has one type per name, so the old server must be gone first
                self._serve(name, offer)

    def receive(self, record: bytes) -> None:
        """Take one record of the other end."""
        try:
            decoded = decode_record(record)
        except ValueError as error:
            self.malformed += 1
            if self._logged.take("malformed", self._clock()):
                log.warning("a record of the other end was ignored: %s", error)
            return
        self._caller.receive(decoded)
        self._served.receive(decoded)

    def step(self, now_s: float) -> None:
        """Repeat what has no answer, and end what takes too long; call it several times a second."""
        self._caller.step(now_s)
        self._served.step(now_s)
        for ghost in self._ghosts.values():
            ghost.service.step()

    def destroy(self) -> None:
        """Fail the calls that are under way, and remove all servers and clients."""
        self.follow({}, session=None)
        self._served.destroy()

    def _serve(self, name: str, offer: ServiceOffer) -> None:
        """Have a ghost of this service, unless a node on this side serves it."""
        ghost = self._ghosts.get(name)
        if not is_full_name(far_name(name, self._namespace)) or not is_full_name(far_name(offer.node, self._namespace)):
            self._refuse(name, f"no names of ROS: {name!r} on {offer.node!r}")
        elif not self._allows(name):
            self._refuse(name, "relay.services and relay.actions of this end do not allow it")
        elif self._services.is_served(far_name(name, self._namespace), ghosts=int(ghost is not None)):
            self._withdraw(name, "a node on this side serves it")
            self._refuse(name, "a node on this side serves it, too; that one stays")
        elif ghost is None:
            self._make(name, offer)

    def _make(self, name: str, offer: ServiceOffer) -> None:
        try:
            kind = service_class(offer.type_name)
            service = GhostService(
                self._ghost_node(far_name(offer.node, self._namespace)),
                kind,
                far_name(name, self._namespace),
                on_request=partial(self._call, name),
            )
        except UnknownTypeError as error:
            self._refuse(name, str(error))
        except (InvalidServiceNameException, NameValidationException, RuntimeError, ValueError) as error:
            self._refuse(name, f"the middleware says: {error}")
        else:
            self._ghosts[name] = _Ghost(offer, kind, service)
            if self.refused.pop(name, None):
                log.info("%s of the other side can be called now", name)

    def _withdraw(self, name: str, reason: str) -> None:
        if name in self._ghosts:
            self._caller.fail(
                name, CallFailure(reason=FailureReason.NO_SERVER, message=f"{reason}; the call may have run")
            )
            self._ghosts.pop(name).service.destroy()

    def _refuse(self, name: str, reason: str) -> None:
        if self.refused.get(name) != reason:
            log.error("%s of the other side cannot be called here: %s", name, reason)
        self.refused[name] = reason

    def _call(self, name: str, message: Any, header: Any) -> None:
        """Pass a request of a node on this side to the other end."""
        if (ghost := self._ghosts.get(name)) is None:
            return
        request = Request(service=name, type_name=ghost.offer.type_name, body=bytes(serialize_message(message)))
        self._caller.call(
            request,
            timeout_s=None if name.endswith(_GET_RESULT) else self._timeout_s,
            now_s=self._clock(),
            on_end=partial(self._end, name, ghost, header),
        )

    def _end(self, name: str, ghost: _Ghost, header: Any, outcome: Outcome) -> None:
        if isinstance(outcome, CallFailure):
            response = self._failed(name, ghost, outcome)
        else:
            try:
                response = deserialize_message(outcome.body, ghost.kind.Response)
            except (RuntimeError, ValueError) as error:
                failure = CallFailure(reason=FailureReason.TYPE, message=f"its answer cannot be read: {error}")
                response = self._failed(name, ghost, failure)
        if response is not None:
            ghost.service.answer(response, header)

    def _failed(self, name: str, ghost: _Ghost, failure: CallFailure) -> Any:
        self.failures[failure.reason.value] += 1
        if self._logged.take((name, failure.reason), self._clock()):
            log.warning("a call of %s failed: %s", name, failure.message)
        return failed_response(ghost.kind, ghost.offer.type_name, reason=failure.reason, message=failure.message)

    def _link_name(self, name: str) -> str | None:
        """Return the name on the link of a service on this side, None where it may not be called across the link."""
        on_link = robot_name(name, self._namespace)
        return on_link if on_link is not None and self._allows(on_link) else None

    def _offered(self, name: str) -> tuple[str, str] | None:
        """Return name and type on this side of a service that the other end calls, None where it is not offered."""
        type_name = self._services.type_of(far_name(name, self._namespace))
        return None if type_name is None or name in self._ghosts else (far_name(name, self._namespace), type_name)
