"""Calls across a link that loses, doubles and reorders records: each ends once, and its server runs it at most once."""

from collections import Counter
from functools import partial

from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from arpd.apply.relay.call_records import (
    Answer,
    CallFailure,
    FailureReason,
    Outcome,
    Request,
    Signal,
    decode_record,
)
from arpd.apply.relay.calls import KEEP_S, REPEAT_S, Callee, Caller, CallId
from tests.examples import examples

REQUEST = Request(service="/add", type_name="test_msgs/srv/BasicTypes", body=b"2+3")
ANSWER = Answer(body=b"5")


class Link:
    """A caller and a callee with every record between them, in each direction."""

    def __init__(self):
        self.now_s = 0.0
        self.to_callee: list[bytes] = []
        self.to_caller: list[bytes] = []
        self.running, self.outcomes = [], []
        self.caller = Caller(session="robot", send=self.to_callee.append)
        self.callee = self.new_callee("ceddp")
        self.callee.follow("robot")
        self.caller.follow("ceddp")

    def new_callee(self, session):
        return Callee(session=session, send=self.to_caller.append, run=lambda call, _request: self.running.append(call))

    def call(self, timeout_s=10.0, request=REQUEST):
        self.caller.call(request, timeout_s=timeout_s, now_s=self.now_s, on_end=self.outcomes.append)

    def deliver(self):
        """Let all records arrive, and what they cause."""
        while self.to_callee or self.to_caller:
            while self.to_callee:
                self.callee.receive(decode_record(self.to_callee.pop(0)))
            while self.to_caller:
                self.caller.receive(decode_record(self.to_caller.pop(0)))

    def lose(self):
        lost = [decode_record(data).content for data in (*self.to_callee, *self.to_caller)]
        self.to_callee.clear()
        self.to_caller.clear()
        return lost

    def wait(self, duration_s):
        self.now_s += duration_s
        self.caller.step(self.now_s)
        self.callee.step(self.now_s)

    def finish(self, outcome=ANSWER):
        self.callee.finish(self.running[-1], outcome, self.now_s)


def reasons(outcomes):
    return [outcome.reason for outcome in outcomes]


def test_a_repeated_request_does_not_carry_its_message_again_and_again():
    """Once the other end says that it has the request, only its number is repeated."""
    link = Link()
    link.call()
    link.deliver()
    link.wait(REPEAT_S)
    link.deliver()
    for _ in range(5):
        link.wait(REPEAT_S)
        assert link.lose() == [Signal.ASK]
    link.wait(REPEAT_S)
    link.finish()
    link.lose()
    link.wait(REPEAT_S)
    link.deliver()
    assert link.outcomes == [ANSWER]
    assert len(link.running) == 1


def test_an_answer_that_was_lost_for_too_long_is_a_failure():
    """The callee forgets an old answer, but never that the call ran."""
    link = Link()
    link.call(timeout_s=None)
    link.deliver()
    link.finish()
    link.lose()
    link.wait(KEEP_S)
    link.deliver()
    assert reasons(link.outcomes) == [FailureReason.TIMEOUT]
    assert len(link.running) == 1


def test_a_call_without_an_answer_times_out():
    """A call fails when its time is over, and a late answer changes nothing."""
    link = Link()
    link.call(timeout_s=3.0)
    link.deliver()
    link.wait(2.9)
    assert not link.outcomes
    link.wait(0.1)
    link.deliver()
    assert reasons(link.outcomes) == [FailureReason.TIMEOUT]
    assert not link.callee.is_running(link.running[0])
    link.finish()
    link.deliver()
    assert len(link.outcomes) == 1


def test_an_unreachable_end_fails_calls_at_once():
    """Calls that are under way fail, and so does every new one, until the other end is back."""
    link = Link()
    link.call()
    link.caller.follow(None)
    link.call()
    assert reasons(link.outcomes) == [FailureReason.UNREACHABLE] * 2
    link.caller.follow("ceddp")
    link.call()
    link.deliver()
    link.finish()
    link.deliver()
    assert link.outcomes[2:] == [ANSWER]


def test_a_restarted_callee_does_not_run_what_its_predecessor_may_have_run():
    """A request that was meant for an ended process fails, before the caller knows the new session and after."""
    link = Link()
    link.call()
    link.deliver()
    link.callee = link.new_callee("new")
    link.callee.follow("robot")
    link.wait(REPEAT_S)
    link.deliver()
    assert reasons(link.outcomes) == [FailureReason.RESTARTED]
    link.call()
    link.caller.follow("new")
    link.deliver()
    assert reasons(link.outcomes) == [FailureReason.RESTARTED] * 2
    assert len(link.running) == 1


def test_a_late_request_of_an_ended_caller_does_not_run():
    """After the caller restarted, copies of its old requests are ignored."""
    link = Link()
    link.call()
    link.deliver()
    link.wait(REPEAT_S)
    late = link.to_callee.pop()
    for session in ("new", "robot"):  # the second: a state of the old session that comes late
        link.callee.follow(session)
        link.callee.receive(decode_record(late))
    assert len(link.running) == 1
    assert not link.callee.is_running(link.running[0])


def test_a_service_that_goes_ends_its_calls_only():
    """Calls of a service that the other end offers no more fail; those of others go on."""
    link = Link()
    link.call()
    link.call(request=Request(service="/other", type_name="t/srv/T", body=b""))
    failure = CallFailure(reason=FailureReason.NO_SERVER, message="gone")
    link.caller.fail("/add", failure)
    assert link.outcomes == [failure]
    assert len(link.caller) == 1


def test_a_message_that_is_too_large_fails(monkeypatch):
    """A request or an answer beyond what an end accepts fails by name, and does not wait for its time-out."""
    link = Link()
    monkeypatch.setattr("arpd.apply.relay.call_records._MOST_BYTES", 200)
    link.call(request=Request(service="/add", type_name="t/srv/T", body=bytes(200)))
    link.call()
    link.deliver()
    link.finish(Answer(body=bytes(200)))
    link.deliver()
    assert reasons(link.outcomes) == [FailureReason.TYPE] * 2


def test_a_request_that_comes_after_its_time_out_does_not_run():
    """Once the callee knows that the caller gave up, a late request does nothing, even with an older call under way."""
    link = Link()
    link.call(timeout_s=None)
    link.deliver()
    link.call(timeout_s=3.0)
    late = link.to_callee.pop()
    link.wait(3.0)
    link.deliver()
    link.callee.receive(decode_record(late))
    assert len(link.running) == 1


def test_a_caller_that_forgot_frees_the_callee():
    """A call whose end got lost is forgotten with the next record of the caller."""
    link = Link()
    link.call(timeout_s=3.0)
    link.deliver()
    link.wait(3.0)
    link.lose()
    assert link.callee.is_running(link.running[0])
    link.call()
    link.deliver()
    assert not link.callee.is_running(link.running[0])


class Unreliable(RuleBasedStateMachine):
    """Two ends that both call, over a link that loses, doubles and reorders; either may restart or be unreachable."""

    @initialize()
    def begin(self):
        self.now_s = 0.0
        self.flying = []  # (end it goes to, bytes)
        self.begun = 0
        self.runs: Counter[CallId] = Counter()
        self.ends: Counter[int] = Counter()
        self.waiting = []  # (side, session, call) that runs
        self.sessions = 0
        self.sides = [self.started(0), self.started(1)]
        self.learn(0)
        self.learn(1)

    @rule(side=st.sampled_from([0, 1]))
    def restart(self, side):
        """End a process, and with it the calls that it makes."""
        for number in self.sides[side]["mine"]:
            self.ends[number] += 1
        self.sides[side] = self.started(side)

    def started(self, side):
        self.sessions += 1
        session = f"{side}:{self.sessions}"
        other = 1 - side
        send = lambda data: self.flying.append((other, data))  # noqa: E731 - one line each
        caller = Caller(session=session, send=send)

        def run(call, _request):
            self.runs[call] += 1
            self.waiting.append((side, session, call))

        callee = Callee(session=session, send=send, run=run)
        return {"session": session, "caller": caller, "callee": callee, "mine": set()}

    @rule(side=st.sampled_from([0, 1]))
    def know(self, side):
        """Let the state of the other end arrive."""
        self.learn(side)

    def learn(self, side):
        other = self.sides[1 - side]["session"]
        self.sides[side]["caller"].follow(other)
        self.sides[side]["callee"].follow(other)

    @rule(side=st.sampled_from([0, 1]))
    def lose_sight(self, side):
        self.sides[side]["caller"].follow(None)
        self.sides[side]["callee"].follow(None)

    @rule(side=st.sampled_from([0, 1]), timeout_s=st.sampled_from([None, 2.5, 100.0]))
    def call(self, side, timeout_s):
        self.begun += 1
        number, mine = self.begun, self.sides[side]["mine"]
        mine.add(number)

        def end(_outcome):
            self.ends[number] += 1
            mine.discard(number)

        self.sides[side]["caller"].call(REQUEST, timeout_s=timeout_s, now_s=self.now_s, on_end=end)

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
        side, session, call = self.waiting.pop(data.draw(st.integers(0, len(self.waiting) - 1)))
        if self.sides[side]["session"] == session:
            self.sides[side]["callee"].finish(call, ANSWER, self.now_s)

    @rule(duration_s=st.sampled_from([0.3, 1.0, 30.0, 61.0]))
    def wait(self, duration_s):
        self.pass_time(duration_s)

    def pass_time(self, duration_s):
        self.now_s += duration_s
        for side in self.sides:
            side["caller"].step(self.now_s)
            side["callee"].step(self.now_s)

    def receive(self, side, data):
        record = decode_record(data)
        self.sides[side]["caller"].receive(record)
        self.sides[side]["callee"].receive(record)

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
            for side, session, call in self.waiting:
                if self.sides[side]["session"] == session:
                    self.sides[side]["callee"].finish(call, ANSWER, self.now_s)
            self.waiting.clear()
            if sum(self.ends.values()) == self.begun and not self.flying:
                break
            self.pass_time(1.0)
        assert all(count == 1 for count in (*self.runs.values(), *self.ends.values()))
        assert set(self.ends) == set(range(1, self.begun + 1))
        assert all(len(side["caller"]) == 0 for side in self.sides)


TestUnreliable = Unreliable.TestCase
TestUnreliable.settings = examples(80, stateful_step_count=60)


@examples(60)
@given(st.randoms(use_true_random=False), st.integers(1, 12))
def test_a_bad_link_between_two_live_ends_costs_time_only(random, count):
    """Without restarts and time-outs every call gets its own answer, whatever happens to the records."""
    link = Link()
    answers: dict[int, Outcome] = {}
    for number in range(count):
        request = Request(service="/add", type_name="t/srv/T", body=bytes([number]))
        link.caller.call(request, timeout_s=None, now_s=0.0, on_end=partial(answers.__setitem__, number))
    link.callee._run = lambda call, request: link.running.append((call, request))
    while len(answers) < count:
        for records, end in ((link.to_callee, link.callee), (link.to_caller, link.caller)):
            random.shuffle(records)
            for _ in range(len(records) // 2 + 1 if records else 0):
                if random.random() < 0.6:
                    end.receive(decode_record(records[-1]))
                if random.random() < 0.7:
                    records.pop()
                if not records:
                    break
            if random.random() < 0.2:
                records.clear()
        if link.running and random.random() < 0.5:
            call, request = link.running.pop(0)
            link.callee.finish(call, Answer(body=b"answer of " + request.body), link.now_s)
        link.wait(0.25)
        assert link.now_s < 10_000
    assert answers == {number: Answer(body=b"answer of " + bytes([number])) for number in range(count)}
