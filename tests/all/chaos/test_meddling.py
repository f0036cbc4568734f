"""Events during a writer swap, in every state of it: readers join, newer plans come, a second daemon plans."""

import re
import time
from types import SimpleNamespace

import pytest

from tests.all.chaos.nodes import BASELINE_DEPTH, DEPTH, TOPICS, WHERE
from tests.all.chaos.world import Log, ended, is_gapless, settle, status
from tests.waiting import eventually

pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]

DEADLINE_NS = 800_000_000
RIVAL_DEPTH = 250
FOUGHT = "/chaos/fought"
FIGHT_S = 20.0  # an unconfirmed plan is sent again after 1.5, 3, 6 and 12 s
every_state = pytest.mark.parametrize("where", WHERE)


def join(world):
    """One subscriber joins while every swap is stopped, another one as they go on."""
    there = Log(world, "there")
    talker = world.talker(stops=TOPICS)
    world.ask("/talker", TOPICS.values(), depth=DEPTH, deadline_ns=DEADLINE_NS)
    eventually("every swap is stopped", lambda: talker.stopped == set(TOPICS.values()))
    early = Log(world, "early")
    eventually("the early reader matches", lambda: min(talker.tell("matched").values()) == 2)
    late = Log(world, "late")
    talker.tell("release")
    eventually("every swap has ended", lambda: world.has_settled(TOPICS.values(), swaps=1))
    eventually(
        "all three readers are published to", lambda: all("3" in first for first in talker.tell("first").values())
    )
    sent = settle(world, talker, there, early, late)
    first = {
        readers: {
            topic: min(number for count, number in of.items() if int(count) >= readers)
            for topic, of in talker.tell("first").items()
        }
        for readers in (2, 3)
    }
    return SimpleNamespace(
        now=world.picture(),
        sent=sent,
        there=there.numbers,
        early=SimpleNamespace(numbers=early.numbers, first=first[2]),
        late=SimpleNamespace(numbers=late.numbers, first=first[3]),
    )


@every_state
@pytest.mark.parametrize("name", ["early", "late"])
def test_who_joins_during_a_swap_gets_everything_from_then_on(played, where, name):
    """A joining reader has every sample published since it matched, once and in order."""
    joined = getattr(played(join), name)
    numbers = joined.numbers[TOPICS[where]]
    assert is_gapless(numbers)
    assert numbers[0] <= joined.first[TOPICS[where]]
    assert numbers[-1] == played(join).sent - 1


@every_state
def test_who_joins_during_a_swap_harms_nobody(played, where):
    """The swap succeeds or is refused with a reason, and the first reader loses, doubles and reorders nothing."""
    outcome = played(join)
    now = outcome.now[TOPICS[where]]
    stated = (BASELINE_DEPTH, 0) if now.last.refusal else (DEPTH, DEADLINE_NS)
    assert (now.last.depth, now.last.deadline_ns, ended(now.last)) == (*stated, 1)
    assert now.writers == [now.last.deadline_ns]
    assert outcome.there[TOPICS[where]] == list(range(outcome.sent))
    assert (now.last.published, now.last.withheld) == (outcome.sent, 0)


def plan_again(world):
    """Send one newer plan after the other, as another daemon would, while every swap is stopped."""
    reader = Log(world, "reader")
    talker = world.talker(stops=TOPICS)
    world.ask("/talker", TOPICS.values(), depth=DEPTH, deadline_ns=DEADLINE_NS)
    eventually("every swap is stopped", lambda: talker.stopped == set(TOPICS.values()))
    for depth, deadline_ns in ((150, DEADLINE_NS), (150, 700_000_000), (250, 700_000_000)):
        world.ask("/talker", TOPICS.values(), depth=depth, deadline_ns=deadline_ns)
    talker.tell("release")
    eventually("what was asked last is in force", lambda: world.has_settled(TOPICS.values(), depth=250, swaps=2))
    sent = settle(world, talker, reader)
    return SimpleNamespace(now=world.picture(), sent=sent, received=reader.numbers)


@every_state
def test_what_was_asked_last_during_a_swap_is_in_force(played, where):
    """The last plan is in force, earlier ones cost no swap, and one writer is left."""
    now = played(plan_again).now[TOPICS[where]]
    assert (now.last.depth, now.last.deadline_ns, now.last.refusal) == (250, 700_000_000, "")
    assert now.writers == [700_000_000]
    assert ended(now.last) == 2, "the swap that was under way, and one for all that was asked"


@every_state
def test_plans_during_a_swap_lose_nothing(played, where):
    """Every published sample arrives once and in order."""
    outcome = played(plan_again)
    last = outcome.now[TOPICS[where]].last
    assert outcome.received[TOPICS[where]] == list(range(outcome.sent))
    assert (last.published, last.withheld) == (outcome.sent, 0)


def fight(world):
    """Let two daemons that are there first plan for one publisher, then stop the one whose plan is in force."""
    reader = Log(world, "reader", [FOUGHT])
    daemons = {depth: world.daemon(depth=depth) for depth in (DEPTH, RIVAL_DEPTH)}
    eventually("the daemons are there", lambda: all(status(daemon) for daemon in daemons.values()))
    talker = world.talker(FOUGHT)
    eventually("a plan is in force", lambda: any(world.shows(FOUGHT, depth=depth) for depth in daemons))
    time.sleep(FIGHT_S)
    fought = world.last(FOUGHT)
    eventually("one of the plans is in force", lambda: world.last(FOUGHT).depth in daemons)
    winner = world.last(FOUGHT).depth
    (loser,) = set(daemons) - {winner}
    daemons[winner].terminate()
    eventually("the other plan is in force", lambda: world.shows(FOUGHT, depth=loser))
    sent = talker.tell("publish", is_on=False)
    eventually("the queue is empty", lambda: world.shows(FOUGHT, offered=sent, queued=0) and world.rests(FOUGHT))
    eventually("every sample has arrived", lambda: len(reader.numbers[FOUGHT]) == sent)
    logs = [daemon.log() for daemon in daemons.values()]
    print(dict(fought.swaps_by_result), [(s.depth, s.generation) for s in world.announced(FOUGHT)], *logs, sep="\n")
    return SimpleNamespace(
        fought=fought, last=world.last(FOUGHT), loser=loser, logs=logs, received=reader.numbers[FOUGHT], sent=sent
    )


def test_two_daemons_cost_no_sample(played):
    """Every published sample arrives once and in order."""
    outcome = played(fight)
    assert outcome.received == list(range(outcome.sent))
    assert (outcome.last.published, outcome.last.withheld) == (outcome.sent, 0)


def test_two_daemons_come_to_rest(played):
    """One of the two plans stays in force: each daemon's plan costs at most one swap, and one back."""
    assert 1 <= ended(played(fight).fought) <= 3, played(fight).fought


def test_two_daemons_are_logged(played):
    """At least one of the two logs that another daemon is there."""
    assert any(re.search(r"(another|second|two|other) (arpd|daemon)", log) for log in played(fight).logs)


def test_of_two_daemons_the_one_that_stays_takes_over(played):
    """When the active daemon stops, the other one's plan comes into force."""
    outcome = played(fight)
    assert outcome.last.depth == outcome.loser, (BASELINE_DEPTH, outcome.last)
