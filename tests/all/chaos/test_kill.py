"""Kill -9 of every participant of a writer swap, and readers that join, in every state of it."""

from types import SimpleNamespace

import pytest

from tests.all.chaos.nodes import BASELINE_DEPTH, DEPTH, TOPICS, WHERE
from tests.all.chaos.world import Log, ended, is_gapless, settle
from tests.waiting import eventually

pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]

DEADLINE_NS = 800_000_000
OTHER_DEPTH = 250
AGAIN = 100_000  # first number of a node's second life
BASELINE = (BASELINE_DEPTH, 0)
ASKED = (DEPTH, DEADLINE_NS)
every_state = pytest.mark.parametrize("where", WHERE)


def qos(state):
    return (state.depth, state.deadline_ns)


def kill_reader(world):
    """Kill a subscriber while the publisher swaps, and start it again; another one stays."""
    survivor = Log(world, "survivor")
    victim = world.start("listener", "victim", *TOPICS.values())
    talker = world.talker(readers=2, stops=TOPICS)
    eventually("the victim receives", lambda: all(victim.tell("received").values()))
    world.ask("/talker", TOPICS.values(), depth=DEPTH, deadline_ns=DEADLINE_NS)
    eventually("every swap is stopped", lambda: talker.stopped == set(TOPICS.values()))
    victim.kill()
    talker.tell("release")
    eventually("every swap has ended", lambda: world.has_settled(TOPICS.values(), swaps=1))
    restarted = world.start("listener", "victim", *TOPICS.values())
    eventually("it receives again", lambda: all(len(numbers) > 10 for numbers in restarted.tell("received").values()))
    sent = settle(world, talker, survivor)
    eventually(
        "the restarted reader has the last sample",
        lambda: all(numbers[-1] == sent - 1 for numbers in restarted.tell("received").values()),
    )
    return SimpleNamespace(
        now=world.picture(), survivor=survivor.numbers, sent=sent, restarted=restarted.tell("received")
    )


@every_state
def test_a_killed_reader_costs_the_other_one_nothing(played, where):
    """The swap ends with one writer; the survivor has every sample, the restarted reader all from its first one on."""
    topic, outcome = TOPICS[where], played(kill_reader)
    now = outcome.now[topic]
    print(where, dict(now.last.swaps_by_result), now.last.refusal)
    assert (ended(now.last), now.last.published, now.last.withheld) == (1, outcome.sent, 0), now.last
    assert qos(now.last) == (BASELINE if now.last.refusal else ASKED)
    assert now.writers == [now.last.deadline_ns]
    assert outcome.survivor[topic] == list(range(outcome.sent))
    assert is_gapless(outcome.restarted[topic])
    assert outcome.restarted[topic][-1] == outcome.sent - 1


def assert_planned(now):
    """Assert that a restarted publisher swapped from its own QoS to the plan, and has one writer."""
    assert (now.last.baseline_depth, now.last.baseline_deadline_ns) == BASELINE
    assert ended(now.last) >= 1
    assert now.last.generation >= 1
    assert (now.last.depth, now.last.refusal) == (DEPTH, "")
    assert now.writers == [now.last.deadline_ns] != [0]


def kill_node(world):
    """Kill the publishers' node during the swap to a daemon's first plan, and start it again."""
    reader = Log(world, "reader")
    world.daemon()
    talker = world.talker(has_short_lease=True, stops=TOPICS)
    eventually("every swap is stopped", lambda: talker.stopped == set(TOPICS.values()))
    sent = talker.tell("publish", is_on=False)
    eventually("all that flows has left", lambda: all(world.rests(topic) for topic in TOPICS.values()))
    before = world.picture()
    talker.kill()
    talker = world.talker(number=AGAIN)
    eventually("the plan is in force", lambda: world.has_settled(TOPICS.values(), depth=DEPTH, swaps=1))
    end = settle(world, talker, reader, first=AGAIN)
    return SimpleNamespace(before=before, now=world.picture(), received=reader.numbers, sent=sent, end=end)


@every_state
def test_a_node_started_again_begins_with_its_own_qos_and_gets_the_plan_back(played, where):
    """What its first life announced as published has arrived, and its second life loses nothing through the swap."""
    topic, outcome = TOPICS[where], played(kill_node)
    before = outcome.before[topic].last
    received = [number for number in outcome.received[topic] if number < AGAIN]
    assert received == list(range(before.published))
    assert (outcome.sent - len(received), before.withheld) == (before.queued, 0)
    assert_planned(outcome.now[topic])
    assert outcome.received[topic][len(received) :] == list(range(AGAIN, outcome.end))
    assert outcome.now[topic].last.published == outcome.end - AGAIN


def kill_daemon(world):
    """Kill a daemon and then its successor during the swaps to their plans, then start a third one."""
    reader = Log(world, "reader")
    daemon = world.daemon()
    talker = world.talker(stops=TOPICS)
    topics = TOPICS.values()
    deaths = []
    for swaps, depth in enumerate((DEPTH, OTHER_DEPTH), start=1):
        eventually("every swap is stopped", lambda: talker.stopped == set(topics))
        daemon.kill()
        talker.tell("release")
        eventually("the plan is in force", lambda d=depth, n=swaps: world.has_settled(topics, depth=d, swaps=n))
        deaths.append(world.picture())
        if depth == DEPTH:
            talker.stop(TOPICS)
            daemon = world.daemon(depth=OTHER_DEPTH, on_lost="baseline", lost_after="5s")
    eventually("the lease is over", lambda: world.has_settled(topics, depth=BASELINE_DEPTH, swaps=3))
    deserted = world.picture()
    announced = {topic: world.announced(topic) for topic in topics}
    world.daemon()
    eventually("the third daemon's plan is in force", lambda: world.has_settled(topics, depth=DEPTH, swaps=4))
    sent = settle(world, talker, reader)
    return SimpleNamespace(
        deaths=deaths, deserted=deserted, now=world.picture(), announced=announced, received=reader.numbers, sent=sent
    )


@every_state
def test_a_plan_with_a_lease_ends_with_its_daemon(played, where):
    """With ``on_lost: baseline`` the publisher returns to its own QoS and to generation 0."""
    now = played(kill_daemon).deserted[TOPICS[where]]
    assert (qos(now.last), now.last.generation) == (BASELINE, 0)
    assert now.writers == [0]


@every_state
def test_a_daemon_started_again_takes_over(played, where):
    """A swap outlives its daemon; the plan stays until the next one's, and generations rise until a lease is over."""
    topic, outcome = TOPICS[where], played(kill_daemon)
    for swaps, (death, depth) in enumerate(zip(outcome.deaths, (DEPTH, OTHER_DEPTH), strict=True), start=1):
        now = death[topic]
        assert (now.last.depth, now.last.refusal, ended(now.last)) == (depth, "", swaps)
        assert now.writers == [now.last.deadline_ns] != [0]
    first, announced = outcome.deaths[0][topic].last, outcome.announced[topic]
    generations = [state.generation for state in announced]
    while generations[-1] == 0:
        generations.pop()
    assert generations == sorted(generations)
    after = [qos(state) for state in announced[announced.index(first) :] if state.generation == first.generation]
    assert set(after) == {qos(first)}
    assert_planned(outcome.now[topic])


@every_state
def test_daemons_that_die_cost_no_sample(played, where):
    """Every published sample arrives once and in order."""
    topic, outcome = TOPICS[where], played(kill_daemon)
    last = outcome.now[topic].last
    assert outcome.received[topic] == list(range(outcome.sent))
    assert (last.published, last.withheld) == (outcome.sent, 0)


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
def test_who_joins_during_a_swap_gets_everything_from_then_on(played, where):
    """A joining reader has every sample since it matched; the swap ends, and the first reader loses nothing."""
    topic, outcome = TOPICS[where], played(join)
    for joined in (outcome.early, outcome.late):
        numbers = joined.numbers[topic]
        assert is_gapless(numbers)
        assert numbers[0] <= joined.first[topic]
        assert numbers[-1] == outcome.sent - 1
    now = outcome.now[topic]
    stated = (BASELINE_DEPTH, 0) if now.last.refusal else (DEPTH, DEADLINE_NS)
    assert (now.last.depth, now.last.deadline_ns, ended(now.last)) == (*stated, 1)
    assert now.writers == [now.last.deadline_ns]
    assert outcome.there[topic] == list(range(outcome.sent))
    assert (now.last.published, now.last.withheld) == (outcome.sent, 0)
