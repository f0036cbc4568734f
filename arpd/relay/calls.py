"""Calls of services across the link, whose records may be lost, doubled or reordered: pure.

A call is known by the session of the end that makes it, its caller, and a number that only grows. Once a second the
caller says which of its calls wait. The other end, the callee, then sends their outcomes again, asks for the requests
that it lacks, and gives up all other calls. It keeps the last outcomes, so that a late copy of a request does not run.
Each record names the session of the process that it is meant for: another one ignores it.
"""

from __future__ import annotations

import math
import struct
from enum import IntEnum, StrEnum
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from arpd.endpoint.lane import SMALL_BYTES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

REPEAT_S = 1.0
MOST_CALLS = 1000  # that wait, that run, and whose outcomes are kept
_MOST_OF_SERVICE = 500  # of those that wait: a server that hangs leaves room for the calls of others
MOST_BYTES = 64_000_000  # of the requests that wait, and of the outcomes that are kept
_MOST_MESSAGE = 250  # characters
# Kind, session that it is meant for, and number; by the first bytes `Assembly` tells one call from another.
_HEADER = struct.Struct("<BIQ")
_NUMBER_BYTES = 8


class Kind(IntEnum):
    """Kind of a record: the caller sends the first three, the callee the others.

    WAITING has the numbers of all calls that wait, and as its own that of the last one that was made. MISSING asks for
    a request.
    """

    REQUEST = 1
    WAITING = 2
    GIVEN_UP = 3
    MISSING = 4
    ANSWER = 5
    FAILURE = 6


class Record(NamedTuple):
    """Part of a call that crosses the link: its kind, the session that it is meant for, its call, and the rest."""

    kind: Kind
    to: int
    number: int
    body: bytes = b""

    def encode(self) -> bytes:
        """Return the record as bytes."""
        return _HEADER.pack(*self[:3]) + self.body

    @classmethod
    def decode(cls, data: bytes) -> Record:
        """Return the record from its bytes; ValueError = they are none."""
        if len(data) < _HEADER.size:
            raise ValueError(f"a record of {len(data)} bytes; it has {_HEADER.size} at least")
        kind, to, number = _HEADER.unpack_from(data)
        return cls(Kind(kind), to, number, data[_HEADER.size :])


class Request(NamedTuple):
    """A request: its service, its type, ``example_interfaces/srv/AddTwoInts``, and the serialized message."""

    service: str
    type_name: str
    body: bytes


class FailureReason(StrEnum):
    """Reason why a call has no answer."""

    TIMEOUT = "timeout"
    UNREACHABLE = "unreachable"
    RESTARTED = "restarted"
    NO_SERVER = "no_server"
    TYPE = "type"
    BUSY = "busy"


class CallFailure(NamedTuple):
    """A call without an answer: the reason, and the same in words."""

    reason: FailureReason
    message: str


Outcome: TypeAlias = bytes | CallFailure  # the serialized response


class CallId(NamedTuple):
    """A call at the end that runs it: the session of its caller, and its number there."""

    caller: int
    number: int


class _Waiting(NamedTuple):
    service: str
    request: bytes
    on_end: Callable[[Outcome], None]
    until_s: float


class CallBook:
    """The calls to the other end, each of which ends exactly once, and those of the other end, which run at most once.

    Parameters
    ----------
    session : of this process, 32 bit
    send : writes one record to the link, in the place of one with the same source that still waits there
    run : called once per call of the other end; `finish` ends it, at once or later
    """

    def __init__(
        self, session: int, *, send: Callable[[bytes, int], None], run: Callable[[CallId, Request], None]
    ) -> None:
        self._session, self._send, self._run = session, send, run
        self._other = 0  # session of the other end
        self._is_reachable = False
        self._waiting: dict[int, _Waiting] = {}  # calls to the other end, by number
        self._number = 0  # of the last one
        self._tell_s = math.inf  # when to say which calls wait
        # Calls of the other end: None while one runs, then the record of its outcome, empty where nobody waits; the
        # last used last.
        self._calls: dict[CallId, bytes | None] = {}

    def runs(self, call: CallId) -> bool:
        """Return whether somebody waits for the outcome of a call that runs."""
        return self._calls.get(call, b"") is None

    def follow(self, other: int | None) -> None:
        """Speak with this session of the other end from now on; None = it is unreachable.

        Calls that wait for another session fail, and those that wait for an end that is unreachable, but for those that
        may take any time. Those of another session are given up; an end that is unreachable may still want its calls.
        """
        self._is_reachable = other is not None
        if other is None:
            timed = [number for number, call in self._waiting.items() if call.until_s < math.inf]
            self._give_up(timed, FailureReason.UNREACHABLE, "the other end became unreachable")
        elif other != self._other:
            words = "the other end restarted; the call may have run"
            self._give_up([*self._waiting], FailureReason.RESTARTED, words)
            self._other = other
            for call in [each for each in self._calls if each.caller != other]:
                self._close(call)

    def receive(self, sender: int, data: bytes) -> None:
        """Take a record of the other end; before `follow` knew its session it is ignored, and repeated later.

        Raises ValueError if the bytes are none.
        """
        record = Record.decode(data)
        if sender != self._other or record.to != self._session:
            return
        if record.kind is Kind.REQUEST:
            service, type_name, body = record.body.split(b"\0", 2)
            self._serve(CallId(sender, record.number), Request(service.decode(), type_name.decode(), body))
        elif record.kind is Kind.WAITING:
            count, odd = divmod(len(record.body), _NUMBER_BYTES)
            if odd or count > MOST_CALLS:
                raise ValueError(f"{len(record.body)} bytes of numbers of calls")
            self._settle(record.number, {*struct.unpack(f">{count}Q", record.body)})
        elif record.kind is Kind.GIVEN_UP:
            self._close(CallId(sender, record.number))
        elif (call := self._waiting.get(record.number)) is None:
            return
        elif record.kind is Kind.MISSING:
            self._send(call.request, record.number)
        else:
            outcome: Outcome = record.body
            if record.kind is Kind.FAILURE:
                reason, _, message = record.body.decode().partition("\0")
                outcome = CallFailure(FailureReason(reason), f"the other end says: {message}")
            del self._waiting[record.number]
            if len(record.body) > SMALL_BYTES:
                self._tell()  # the other end has no room for many
            call.on_end(outcome)

    def step(self, now_s: float) -> None:
        """Say which calls wait, and end those whose time is over; call it several times a second."""
        late = [number for number, call in self._waiting.items() if now_s >= call.until_s]
        self._give_up(late, FailureReason.TIMEOUT, "no answer in time")
        if now_s >= self._tell_s and self._is_reachable:
            self._tell()
            self._tell_s = now_s + REPEAT_S if self._waiting else math.inf

    # -- calls to the other end

    def call(self, request: Request, *, timeout_s: float, now_s: float, on_end: Callable[[Outcome], None]) -> None:
        """Begin a call.

        Parameters
        ----------
        timeout_s : time after which it fails (s)
        now_s : monotonic time (s)
        on_end : called once with the outcome, perhaps before this returns
        """
        if not self._is_reachable:
            on_end(CallFailure(FailureReason.UNREACHABLE, "the other end is unreachable"))
            return
        body = f"{request.service}\0{request.type_name}\0".encode() + request.body
        record = Record(Kind.REQUEST, self._other, self._number + 1, body).encode()
        size = sum(len(call.request) for call in self._waiting.values()) + len(record)
        of_service = sum(call.service == request.service for call in self._waiting.values())
        if len(self._waiting) >= MOST_CALLS or of_service >= _MOST_OF_SERVICE or size > MOST_BYTES:
            words = (
                f"more than {MOST_CALLS} calls, {_MOST_OF_SERVICE} of one service, or {MOST_BYTES} bytes of their "
                "requests, would wait"
            )
            on_end(CallFailure(FailureReason.BUSY, words))
            return
        self._number += 1
        self._waiting[self._number] = _Waiting(request.service, record, on_end, now_s + timeout_s)
        self._send(record, self._number)
        self._tell_s = min(self._tell_s, now_s + REPEAT_S)

    def fail(self, service: str, reason: FailureReason, message: str) -> None:
        """End all calls of a service that the other end does not serve any more."""
        numbers = [number for number, call in self._waiting.items() if call.service == service]
        self._give_up(numbers, reason, message)

    def close(self) -> None:
        """End all calls, because this end stops."""
        words = "this end of the relay stops; the call may have run"
        self._give_up([*self._waiting], FailureReason.UNREACHABLE, words)

    def _give_up(self, numbers: Iterable[int], reason: FailureReason, message: str) -> None:
        for number, call in [(number, self._waiting.pop(number)) for number in numbers]:
            # Takes the place of its request where that has not left yet.
            self._send(Record(Kind.GIVEN_UP, self._other, number).encode(), number)
            call.on_end(CallFailure(reason, message))

    def _tell(self) -> None:
        numbers = struct.pack(f">{len(self._waiting)}Q", *self._waiting)
        self._send(Record(Kind.WAITING, self._other, self._number, numbers).encode(), 0)

    # -- calls of the other end

    def finish(self, call: CallId, outcome: Outcome) -> None:
        """End a call of the other end with its outcome; one that nobody waits for is ignored."""
        if not self.runs(call):
            return
        record = _outcome_record(call, outcome)
        if sum(len(kept) for kept in self._calls.values() if kept) + len(record) > MOST_BYTES:
            failure = CallFailure(FailureReason.BUSY, f"more than {MOST_BYTES} bytes of answers would wait")
            record = _outcome_record(call, failure)
        self._calls[call] = record
        self._repeat(call)

    def _serve(self, call: CallId, request: Request) -> None:
        if call in self._calls:
            self._repeat(call)
            return
        for oldest in [each for each, kept in self._calls.items() if kept is not None][:-MOST_CALLS]:
            del self._calls[oldest]
        running = sum(record is None for record in self._calls.values())
        self._calls[call] = None
        if running < MOST_CALLS:
            self._run(call, request)
        else:
            self.finish(call, CallFailure(FailureReason.BUSY, f"{MOST_CALLS} calls run"))

    def _settle(self, last: int, waiting: set[int]) -> None:
        """Give up what the caller has given up, and send what it lacks."""
        for call in self._calls:
            if call.caller == self._other and call.number <= last and call.number not in waiting:
                self._close(call)
        for call in (CallId(self._other, number) for number in sorted(waiting)):
            if call in self._calls:
                self._repeat(call)
            else:
                self._ask(call)

    def _repeat(self, call: CallId) -> None:
        if record := self._calls[call]:
            self._calls[call] = self._calls.pop(call)
            self._send(record, -call.number)

    def _close(self, call: CallId) -> None:
        """Forget the outcome of a call, but not that it ran."""
        if call in self._calls:
            record, self._calls[call] = self._calls[call], b""
            if record and len(record) > SMALL_BYTES:
                self._ask(call)  # takes the place of the answer where that has not left yet

    def _ask(self, call: CallId) -> None:
        self._send(Record(Kind.MISSING, *call).encode(), -call.number)


def _outcome_record(call: CallId, outcome: Outcome) -> bytes:
    if isinstance(outcome, CallFailure):
        body = f"{outcome.reason}\0{outcome.message[:_MOST_MESSAGE]}".encode(errors="replace")
        return Record(Kind.FAILURE, call.caller, call.number, body).encode()
    return Record(Kind.ANSWER, call.caller, call.number, outcome).encode()
