"""Calls across a link that loses, doubles and reorders records: each ends once, and its server runs it at most once."""

import math
from collections import Counter
from contextlib import suppress

from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from arpd.endpoint.lane import Lane
from arpd.relay import calls
from arpd.relay.calls import (
    REPEAT_S,
    CallBook,
    CallId,
    FailureReason,
    Kind,
    Record,
    Request,
)
from tests.examples import examples

REQUEST = Request("/add", "test_msgs/srv/BasicTypes", b"2+3")
ANSWER = b"5"
LARGE = bytes(20_000)
ROBOT, BASE, NEW = 1, 2, 3  # sessions


class Link:
    """A caller and a callee, and what waits between them in each direction: one record of each source."""

    def __init__(self):
        self.now_s = 0.0
        self.to_callee: list[tuple[int, bytes]] = []
        self.to_caller: list[tuple[int, bytes]] = []
        self.running, self.requests, self.outcomes = [], [], []
        self.caller = CallBook(
            ROBOT, send=lambda data, source: self.to_callee.append((source, data)), run=lambda *_call: None
        )
        self.restart(BASE)
        self.caller.follow(BASE)

    def restart(self, session):
        """Let a new process be the callee."""

        def run(call, request):
            self.running.append(call)
            self.requests.append(request)

        self.session = session
        self.callee = CallBook(session, send=lambda data, source: self.to_caller.append((source, data)), run=run)
        self.callee.follow(ROBOT)

    def call(self, timeout_s=10.0, request=REQUEST):
        self.caller.call(request, timeout_s=timeout_s, now_s=self.now_s, on_end=self.outcomes.append)

    def hear(self, data):
        """Let the callee receive a record."""
        self.callee.receive(ROBOT, data)

    def answer(self, data):
        """Let the caller receive a record."""
        self.caller.receive(self.session, data)

    def deliver(self):
        """Let all records arrive, and what they cause."""
        while self.to_callee or self.to_caller:
            while self.to_callee:
                self.hear(self.to_callee.pop(0)[1])
            while self.to_caller:
                self.answer(self.to_caller.pop(0)[1])

    def lose(self):
        lost = [Record.decode(data).kind for _, data in (*self.to_callee, *self.to_caller)]
        self.to_callee.clear()
        self.to_caller.clear()
        return lost

    def wait(self, duration_s):
        self.now_s += duration_s
        self.caller.step(self.now_s)
        self.callee.step(self.now_s)

    def finish(self, outcome=ANSWER, at=-1):
        self.callee.finish(self.running[at], outcome)


def reasons(outcomes):
    return [outcome.reason for outcome in outcomes]


def test_a_lost_request_is_asked_for_and_a_lost_answer_is_sent_again():
    """What is repeated every second is the number of the call; its message crosses again only where it was lost."""
    link = Link()
    link.call()
    assert link.lose() == [Kind.REQUEST]
    link.wait(REPEAT_S)
    link.deliver()
    for _ in range(3):
        link.wait(REPEAT_S)
        assert link.lose() == [Kind.WAITING]
    link.finish()
    assert link.lose() == [Kind.ANSWER]
    link.wait(REPEAT_S)
    link.deliver()
    assert (link.outcomes, link.requests) == ([ANSWER], [REQUEST])


def test_what_still_waits_for_the_link_does_not_cross_once_its_call_is_given_up():
    """In the queue of the link a small record takes the place of a request, and of a large answer."""
    link = Link()
    link.call(timeout_s=3.0)
    link.wait(3.0)
    assert Kind.REQUEST not in leaving(link.to_callee)
    link.lose()
    link.call(timeout_s=3.0)
    link.deliver()
    link.finish(LARGE)
    assert leaving(link.to_caller) == [Kind.ANSWER]
    link.wait(3.0)
    while link.to_callee:
        link.hear(link.to_callee.pop(0)[1])
    assert leaving(link.to_caller) == [Kind.MISSING]


def leaving(records):
    """Return the kinds of the records that leave after an outage."""
    lane = Lane(lambda _sample: None, is_kept=True)
    for source, data in records:
        lane.offer(data, 0.0, source=source, expires_s=math.inf, is_held_up=True, is_out=True)
    kinds = []
    while (current := lane.begin(1.0)) is not None:
        kinds.append(Record.decode(current.message).kind)
    return kinds


def test_calls_that_are_given_up_together_cost_few_bytes():
    """However many others wait, and none of them is given up with those."""
    link = Link()
    for service in ("/gone", "/add"):
        for _ in range(300):
            link.call(request=REQUEST._replace(service=service))
    link.deliver()
    link.caller.fail("/gone", FailureReason.NO_SERVER, "why")
    assert sum(len(data) for _, data in link.to_callee) < 300 * 20
    link.deliver()
    assert [link.callee.runs(call) for call in link.running] == [False] * 300 + [True] * 300


def test_an_unreachable_end_fails_calls_at_once():
    """Calls that are under way fail, and so does every new one, until the other end is back; nobody waits for them."""
    link = Link()
    link.call()
    link.deliver()
    link.caller.follow(None)
    link.call()
    assert reasons(link.outcomes) == [FailureReason.UNREACHABLE] * 2
    link.deliver()
    assert not link.callee.runs(link.running[0])
    link.caller.follow(BASE)
    link.call()
    link.deliver()
    link.finish()
    link.deliver()
    assert link.outcomes[2:] == [ANSWER]


def test_a_call_that_may_take_any_time_waits_through_an_outage():
    """The result of an action arrives after it; a restart of the other end still ends the call."""
    link = Link()
    link.call(timeout_s=math.inf)
    link.hear(link.to_callee.pop()[1])
    link.caller.follow(None)
    link.callee.finish(link.running[0], ANSWER)
    link.to_caller.clear()
    assert link.outcomes == []
    link.caller.follow(BASE)
    link.caller.step(REPEAT_S)
    link.hear(link.to_callee.pop()[1])
    link.caller.receive(BASE, link.to_caller.pop()[1])
    assert link.outcomes == [ANSWER]
    link.call(timeout_s=math.inf)
    link.caller.follow(None)
    link.caller.follow(NEW)
    assert link.outcomes[1].reason is FailureReason.RESTARTED


def test_a_restarted_callee_does_not_run_what_its_predecessor_may_have_run():
    """A request that was meant for an ended process does not run, and fails once the caller knows the new session."""
    link = Link()
    link.call()
    link.deliver()
    link.restart(NEW)
    link.wait(REPEAT_S)
    link.call()
    link.deliver()
    link.caller.follow(NEW)
    link.deliver()
    assert reasons(link.outcomes) == [FailureReason.RESTARTED] * 2
    assert len(link.running) == 1


def test_memory_is_bounded_by_bytes(monkeypatch):
    """Requests and answers beyond what an end holds fail by name, and do not wait for their time-out."""
    link = Link()
    monkeypatch.setattr(calls, "MOST_BYTES", 50_000)
    for _ in range(3):
        link.call(request=Request("/add", "t/srv/T", LARGE))
    assert reasons(link.outcomes) == [FailureReason.BUSY]
    link.call()
    link.deliver()
    for at in range(3):
        link.finish(LARGE, at)
    assert link.lose().count(Kind.FAILURE) == 1
    link.wait(REPEAT_S)
    link.deliver()
    words = "the other end says: more than 50000 bytes of answers would wait"
    assert link.outcomes[1:] == [LARGE, LARGE, (FailureReason.BUSY, words)]
    link.call()
    link.deliver()
    link.finish(LARGE)  # the caller has told at once that it has the others
    link.deliver()
    assert link.outcomes[-1] == LARGE


def test_a_server_that_hangs_leaves_room_for_the_calls_of_others():
    """However many of its calls wait, a goal can be cancelled."""
    link = Link()
    for _ in range(calls.MOST_CALLS):
        link.call()
    link.outcomes.clear()
    link.call(request=Request("/go/_action/cancel_goal", "action_msgs/srv/CancelGoal", b""))
    link.deliver()
    link.finish()
    link.deliver()
    assert link.outcomes == [ANSWER]


def test_memory_is_bounded_by_number(monkeypatch):
    """Only so many calls wait, and run, and so many outcomes are kept; a call that runs is not forgotten for others."""
    link = Link()
    monkeypatch.setattr(calls, "MOST_CALLS", 3)
    for _ in range(4):
        link.call(timeout_s=math.inf)
    assert reasons(link.outcomes) == [FailureReason.BUSY]
    requests = [data for _, data in link.to_callee]
    link.deliver()
    link.hear(Record(Kind.REQUEST, BASE, 99, b"/add\0t/srv/T\0").encode())
    assert Record.decode(link.to_caller.pop()[1]).body.startswith(b"busy")
    for _ in range(5):
        link.finish()
        link.deliver()
        link.call(timeout_s=math.inf)
        link.deliver()
    assert len(link.callee._calls) <= 6
    link.hear(requests[0])
    link.finish(at=0)
    link.deliver()
    assert link.outcomes[1:] == [ANSWER] * 6
    assert len(link.running) == 8


@given(st.binary(max_size=200), st.sampled_from([b"", *(bytes([kind]) for kind in Kind)]))
def test_random_bytes_raise_nothing_else(data, kind):
    """Bytes from a stranger are a record or a ValueError."""
    link = Link()
    link.call()
    link.deliver()
    for receive in (link.hear, link.answer):
        with suppress(ValueError):
            receive(kind + b"\0\0\0\2" + bytes(7) + data)


class Unreliable(RuleBasedStateMachine):
    """Two ends that both call, over a link that loses, doubles and reorders; either may restart or be unreachable.

    Each call ends once, runs at most once, and has its own answer; between two live ends a bad link costs time only.
    """

    @initialize(is_calm=st.booleans())
    def begin(self, is_calm):
        self.now_s = 0.0
        self.flying = []  # (end it goes to, session of the sender, bytes)
        self.begun = 0
        self.runs: Counter[CallId] = Counter()
        self.ends: Counter[int] = Counter()
        self.waiting = []  # (side, session, call, body of the request) that runs
        self.is_calm = is_calm  # both ends live on, and each call is answered
        self.sessions = 0
        self.sides = [self.started(0), self.started(1)]
        self.learn(0)
        self.learn(1)

    @precondition(lambda self: not self.is_calm)
    @rule(side=st.sampled_from([0, 1]))
    def restart(self, side):
        """End a process, and with it the calls that it makes."""
        for number in self.sides[side]["mine"]:
            self.ends[number] += 1
        self.sides[side] = self.started(side)

    def started(self, side):
        self.sessions += 1
        session = self.sessions

        def send(data, _source):
            self.flying.append((1 - side, session, data))

        def run(call, request):
            self.runs[call] += 1
            self.waiting.append((side, session, call, request.body))

        return {"session": session, "book": CallBook(session, send=send, run=run), "mine": set()}

    @rule(side=st.sampled_from([0, 1]))
    def know(self, side):
        """Let the state of the other end arrive."""
        self.learn(side)

    def learn(self, side):
        other = self.sides[1 - side]["session"]
        self.sides[side]["book"].follow(other)

    @precondition(lambda self: not self.is_calm)
    @rule(side=st.sampled_from([0, 1]))
    def lose_sight(self, side):
        self.sides[side]["book"].follow(None)

    @rule(side=st.sampled_from([0, 1]), timeout_s=st.sampled_from([math.inf, 2.5, 100.0]))
    def call(self, side, timeout_s):
        self.begun += 1
        number, mine = self.begun, self.sides[side]["mine"]
        mine.add(number)

        def end(outcome):
            self.ends[number] += 1
            mine.discard(number)
            assert outcome == b"answer of %d" % number or not (self.is_calm or isinstance(outcome, bytes))

        request = Request("/add", "t/srv/T", b"%d" % number)
        self.sides[side]["book"].call(
            request, timeout_s=math.inf if self.is_calm else timeout_s, now_s=self.now_s, on_end=end
        )

    @precondition(lambda self: self.flying)
    @rule(data=st.data(), is_kept=st.booleans())
    def arrive(self, data, is_kept):
        """Any record arrives; kept, it arrives again later."""
        at = data.draw(st.integers(0, len(self.flying) - 1))
        self.receive(*(self.flying[at] if is_kept else self.flying.pop(at)))

    @precondition(lambda self: self.flying)
    @rule(data=st.data())
    def lose(self, data):
        self.flying.pop(data.draw(st.integers(0, len(self.flying) - 1)))

    @precondition(lambda self: self.waiting)
    @rule(data=st.data())
    def answer(self, data):
        self.finish(*self.waiting.pop(data.draw(st.integers(0, len(self.waiting) - 1))))

    def finish(self, side, session, call, body):
        if self.sides[side]["session"] == session:
            self.sides[side]["book"].finish(call, b"answer of " + body)

    @rule(duration_s=st.sampled_from([0.3, 1.0, 30.0, 61.0]))
    def wait(self, duration_s):
        self.now_s += duration_s
        for side in self.sides:
            side["book"].step(self.now_s)

    def receive(self, side, sender, data):
        self.sides[side]["book"].receive(sender, data)

    @invariant()
    def at_most_once(self):
        """No call runs twice, and none ends twice."""
        assert all(count == 1 for count in self.runs.values())
        assert all(count == 1 for count in self.ends.values())

    def teardown(self):
        """On a link that works again, every call ends."""
        self.learn(0)
        self.learn(1)
        for _ in range(300):
            while self.flying:
                self.receive(*self.flying.pop(0))
            while self.waiting:
                self.finish(*self.waiting.pop())
            if sum(self.ends.values()) == self.begun and not self.flying:
                break
            self.wait(1.0)
        assert all(count == 1 for count in (*self.runs.values(), *self.ends.values()))
        assert set(self.ends) == set(range(1, self.begun + 1))


TestUnreliable = Unreliable.TestCase
TestUnreliable.settings = examples(80, stateful_step_count=60)
