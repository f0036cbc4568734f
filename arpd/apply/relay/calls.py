"""Calls of services across the link: each runs at most once, though records are lost, doubled or reordered.

A call is known by the session of the end that makes it and a number that only grows. The caller repeats its request
until the call ends; the callee remembers every number that it has seen, so a late copy of a request never runs again.
A request names the session of the process that it is meant for: one that was started meanwhile does not run it.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.apply.relay.call_records import (
    Answer,
    CallFailure,
    FailureReason,
    Record,
    Request,
    Signal,
    encode_record,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.apply.relay.call_records import Outcome

REPEAT_S = 1.0
KEEP_S = 60.0  # an outcome that the caller has not confirmed


@dataclass(slots=True)
class _Open:
    """A call that waits for its outcome."""

    request: Request
    on_end: Callable[[Outcome], None]
    timeout_s: float | None
    until_s: float | None
    sent_s: float
    is_received: bool = False


class Caller:
    """Makes calls to the other end; each one ends exactly once, with an answer or a failure.

    Parameters
    ----------
    session : of this process
    send : writes one record to the link
    """

    def __init__(self, *, session: str, send: Callable[[bytes], None]) -> None:
        self._session = session
        self._send_bytes = send
        self._callee: str | None = None
        self._open: dict[int, _Open] = {}
        self._next = 1

    def __len__(self) -> int:
        """Return how many calls are under way."""
        return len(self._open)

    def follow(self, callee: str | None) -> None:
        """Make calls to this session of the other end from now on; calls that are under way with another one fail.

        Parameters
        ----------
        callee : None = the other end is unreachable
        """
        if callee == self._callee:
            return
        self._callee = callee
        if callee is None:
            failure = CallFailure(reason=FailureReason.UNREACHABLE, message="the other end became unreachable")
        else:
            failure = CallFailure(
                reason=FailureReason.RESTARTED, message="the other end restarted; the call may have run"
            )
        for number in [*self._open]:
            self._end(number, failure)

    def call(
        self, request: Request, *, timeout_s: float | None, now_s: float, on_end: Callable[[Outcome], None]
    ) -> None:
        """Begin a call.

        Parameters
        ----------
        timeout_s : time after which it fails, None = never (s)
        now_s : monotonic time (s)
        on_end : called once with the outcome, perhaps before this returns
        """
        if self._callee is None:
            on_end(CallFailure(reason=FailureReason.UNREACHABLE, message="the other end is unreachable"))
            return
        number, self._next = self._next, self._next + 1
        until_s = None if timeout_s is None else now_s + timeout_s
        self._open[number] = _Open(request, on_end, timeout_s, until_s, now_s)
        try:
            self._send(number, self._callee, request)
        except ValueError as error:
            self._end(number, CallFailure(reason=FailureReason.TYPE, message=f"the request is too large: {error}"))

    def fail(self, service: str, failure: CallFailure) -> None:
        """End all calls of one service with this failure."""
        for number in [number for number, call in self._open.items() if call.request.service == service]:
            self._end(number, failure)

    def receive(self, record: Record) -> None:
        """Take a record of the other end; records of other callers are ignored."""
        if record.caller != self._session:
            return
        call = self._open.get(record.number)
        match record.content:
            case Answer() | CallFailure() as outcome:
                if call is not None:
                    self._end(record.number, outcome)
                else:
                    self._send(record.number, record.callee, Signal.DONE)
            case Signal.RUNNING if call is not None:
                call.is_received = True

    def step(self, now_s: float) -> None:
        """Repeat requests, and end the calls whose time is over; call it several times a second."""
        for number, call in [*self._open.items()]:
            if number not in self._open:
                continue  # ended by the end of another one
            if call.until_s is not None and now_s >= call.until_s:
                message = f"no answer within {call.timeout_s:g} s"
                self._end(number, CallFailure(reason=FailureReason.TIMEOUT, message=message))
            elif now_s - call.sent_s >= REPEAT_S and self._callee is not None:
                call.sent_s = now_s
                self._send(number, self._callee, Signal.ASK if call.is_received else call.request)

    def _end(self, number: int, outcome: Outcome) -> None:
        call = self._open.pop(number)
        if self._callee is not None:
            self._send(number, self._callee, Signal.DONE)
        call.on_end(outcome)

    def _send(self, number: int, callee: str, content: Request | Signal) -> None:
        oldest = next(iter(self._open), self._next)  # in the order of their numbers
        record = Record(caller=self._session, callee=callee, number=number, oldest=oldest, content=content)
        self._send_bytes(encode_record(record))


class _Numbers:
    """A set of numbers with few gaps: all below the first start, and ranges above."""

    def __init__(self) -> None:
        self._starts: list[int] = [0]
        self._ends: list[int] = [1]  # beyond the last of each range

    def __contains__(self, number: int) -> bool:
        return number < self._ends[bisect_right(self._starts, number) - 1]

    def add(self, number: int) -> None:
        """Add one number."""
        if number in self:
            return
        at = bisect_right(self._starts, number)
        self._starts.insert(at, number)
        self._ends.insert(at, number + 1)
        if at + 1 < len(self._starts) and self._starts[at + 1] == number + 1:
            del self._starts[at + 1], self._ends[at]
        if self._ends[at - 1] == number:
            del self._starts[at], self._ends[at - 1]

    def add_below(self, number: int) -> None:
        """Add all numbers below this one."""
        at = bisect_right(self._starts, number)
        end = max(number, self._ends[at - 1])
        self._starts[:at], self._ends[:at] = [0], [end]


@dataclass(frozen=True, kw_only=True, slots=True)
class CallId:
    """A call at the end that runs it: the session of its caller, and its number there."""

    caller: str
    number: int


@dataclass(slots=True)
class _Seen:
    """A call that runs, or its outcome and the time until which it is kept."""

    outcome: Outcome | None = None
    until_s: float = 0.0


class Callee:
    """Runs the calls of the other end, each at most once, and answers repeated requests with the same outcome.

    Parameters
    ----------
    session : of this process
    send : writes one record to the link
    run : called once per call; `finish` ends it, at once or later
    """

    def __init__(self, *, session: str, send: Callable[[bytes], None], run: Callable[[CallId, Request], None]) -> None:
        self._session = session
        self._send_bytes = send
        self._run = run
        self._caller: str | None = None
        self._calls: dict[int, _Seen] = {}
        self._numbers: dict[str, _Numbers] = {}  # by session; kept, so that a late request of an old one never runs

    def is_running(self, call: CallId) -> bool:
        """Return whether the caller waits for the outcome of this call."""
        seen = self._calls.get(call.number) if call.caller == self._caller else None
        return seen is not None and seen.outcome is None

    def follow(self, caller: str | None) -> None:
        """Run calls of this session of the other end from now on; None = unreachable, which changes nothing."""
        if caller is not None and caller != self._caller:
            self._caller = caller
            self._calls.clear()
            self._numbers.setdefault(caller, _Numbers())

    def receive(self, record: Record) -> None:
        """Take a record of the other end; it repeats what came before `follow` knew its session."""
        if not isinstance(record.content, Request | Signal) or record.content is Signal.RUNNING:
            return
        if record.callee != self._session:
            if record.content is not Signal.DONE:
                message = "the other end restarted; the call may have run"
                self._send(record, CallFailure(reason=FailureReason.RESTARTED, message=message))
            return
        if record.caller != self._caller:
            return
        self._settle(record)
        if record.content is not Signal.DONE:
            self._serve(record, record.content)

    def finish(self, call: CallId, outcome: Outcome, now_s: float) -> None:
        """End a call with its outcome; one that the caller has given up is ignored."""
        if not self.is_running(call):
            return
        record = Record(caller=call.caller, callee=self._session, number=call.number, content=outcome)
        try:
            data = encode_record(record)
        except ValueError as error:
            outcome = CallFailure(reason=FailureReason.TYPE, message=f"the answer is too large: {error}")
            data = encode_record(Record(caller=call.caller, callee=self._session, number=call.number, content=outcome))
        self._calls[call.number] = _Seen(outcome, now_s + KEEP_S)
        self._send_bytes(data)

    def step(self, now_s: float) -> None:
        """Forget outcomes that the caller has not confirmed for a long time."""
        for number, seen in [*self._calls.items()]:
            if seen.outcome is not None and now_s >= seen.until_s:
                del self._calls[number]

    def _settle(self, record: Record) -> None:
        """Forget the calls of which the caller needs nothing more."""
        numbers = self._numbers[record.caller]
        numbers.add_below(record.oldest)
        for number in [number for number in self._calls if number < record.oldest]:
            del self._calls[number]
        if record.content is Signal.DONE:
            numbers.add(record.number)
            self._calls.pop(record.number, None)

    def _serve(self, record: Record, content: Request | Signal) -> None:
        numbers, seen = self._numbers[record.caller], self._calls.get(record.number)
        if seen is not None:
            if seen.outcome is not None:
                self._send(record, seen.outcome)
            elif content is not Signal.ASK:
                self._send(record, Signal.RUNNING)
        elif record.number in numbers:
            message = f"the call ran, and its answer was lost for {KEEP_S:g} s"
            self._send(record, CallFailure(reason=FailureReason.TIMEOUT, message=message))
        elif isinstance(content, Request):
            numbers.add(record.number)
            self._calls[record.number] = _Seen()
            self._run(CallId(caller=record.caller, number=record.number), content)

    def _send(self, record: Record, content: Outcome | Signal) -> None:
        answer = Record(caller=record.caller, callee=record.callee, number=record.number, content=content)
        self._send_bytes(encode_record(answer))
