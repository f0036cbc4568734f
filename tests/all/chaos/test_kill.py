"""Kill -9 of every participant of a writer swap, in every state of it."""

from types import SimpleNamespace

import pytest

from tests.all.chaos.nodes import BASELINE_DEPTH, DEPTH, TOPICS, WHERE
from tests.all.chaos.world import Log, Source, ended, is_gapless, settle
from tests.waiting import eventually

pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]

DEADLINE_NS = 800_000_000
OTHER_DEPTH = 250
AGAIN = 100_000  # first number of a node's second life
LINK = {where: f"/link{topic}" for where, topic in TOPICS.items()}
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
def test_a_killed_reader_leaves_one_writer_of_stated_qos(played, where):
    """After a reader died the swap succeeds or is refused with a reason, and one writer is left."""
    now = played(kill_reader).now[TOPICS[where]]
    print(where, dict(now.last.swaps_by_result), now.last.refusal)
    assert ended(now.last) == 1, now.last
    assert qos(now.last) == (BASELINE if now.last.refusal else ASKED)
    assert now.writers == [now.last.deadline_ns]


@every_state
def test_a_killed_reader_costs_the_other_one_nothing(played, where):
    """The surviving reader has every published sample once and in order."""
    topic = TOPICS[where]
    last = played(kill_reader).now[topic].last
    assert played(kill_reader).survivor[topic] == list(range(played(kill_reader).sent))
    assert (last.published, last.withheld) == (played(kill_reader).sent, 0)


@every_state
def test_a_reader_started_again_receives(played, where):
    """The restarted reader has all samples from its first one on."""
    received = played(kill_reader).restarted[TOPICS[where]]
    assert is_gapless(received)
    assert received[-1] == played(kill_reader).sent - 1


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
def test_a_killed_node_takes_only_what_it_held_with_it(played, where):
    """Samples announced as published have arrived once and in order, and only those announced as queued are lost."""
    last = played(kill_node).before[TOPICS[where]].last
    received = [number for number in played(kill_node).received[TOPICS[where]] if number < AGAIN]
    assert received == list(range(last.published))
    assert played(kill_node).sent - len(received) == last.queued
    assert last.withheld == 0


@every_state
def test_a_node_started_again_begins_with_its_own_qos_and_gets_the_plan_back(played, where):
    """The restarted node swaps from its application's QoS to the daemon's plan, and has one writer."""
    assert_planned(played(kill_node).now[TOPICS[where]])


@every_state
def test_a_node_started_again_loses_nothing(played, where):
    """The restarted node's samples arrive once and in order, through the swap to the plan."""
    received = [number for number in played(kill_node).received[TOPICS[where]] if number >= AGAIN]
    assert received == list(range(AGAIN, played(kill_node).end))
    assert played(kill_node).now[TOPICS[where]].last.published == played(kill_node).end - AGAIN


def kill_relay(world):
    """Kill the relay during the swap to a daemon's first plan, and start it again; its source goes on."""
    far, near = Log(world, "far", LINK.values()), Log(world, "near")
    source = Source(world, "source", TOPICS.values())
    world.daemon()
    eventually("the near reader matches", lambda: source.is_heard(1))
    source.is_publishing = True
    config = world.relay_config()
    relay = world.start("relay", config, has_short_lease=True)
    relay.stop(LINK)
    eventually("every swap is stopped", lambda: relay.stopped == set(LINK.values()))
    paused = source.pause()
    eventually("all that flows has left", lambda: all(world.rests(topic) for topic in LINK.values()))
    before = world.picture()
    relay.kill()
    source.is_publishing = True
    world.start("relay", config)
    eventually("the plan is in force", lambda: world.has_settled(LINK.values(), depth=DEPTH, swaps=1))
    sent = source.pause()
    eventually(
        "both readers have the last sample",
        lambda: all(numbers[-1] == sent - 1 for log in (far, near) for numbers in log.numbers.values()),
    )
    eventually("the relay has sent all", lambda: all(world.rests(topic) for topic in LINK.values()))
    return SimpleNamespace(
        before=before, now=world.picture(), far=far.numbers, near=near.numbers, paused=paused, sent=sent
    )


@every_state
def test_a_killed_relay_takes_only_what_it_held_with_it(played, where):
    """Samples arrive once and in order from the first on, and only those announced as queued are lost."""
    last = played(kill_relay).before[LINK[where]].last
    received = [number for number in played(kill_relay).far[LINK[where]] if number < played(kill_relay).paused]
    assert received == list(range(received[0], played(kill_relay).paused - last.queued))
    assert last.offered == last.published + last.queued
    assert last.published >= len(received), "the far reader may match after the relay has begun"


@every_state
def test_a_relay_started_again_carries_on(played, where):
    """The restarted relay swaps to the daemon's plan, and carries every sample from its first one on."""
    topic = LINK[where]
    now = played(kill_relay).now[topic]
    assert_planned(now)
    received = [number for number in played(kill_relay).far[topic] if number >= played(kill_relay).paused]
    assert received == list(range(received[0], played(kill_relay).sent))
    assert now.last.offered == now.last.published >= len(received)


@every_state
def test_a_killed_relay_does_not_touch_its_source(played, where):
    """A reader of the source itself has every sample, once and in order."""
    assert played(kill_relay).near[TOPICS[where]] == list(range(played(kill_relay).sent))


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
@pytest.mark.parametrize(("death", "depth"), [(0, DEPTH), (1, OTHER_DEPTH)])
def test_a_swap_outlives_the_daemon_that_asked_for_it(played, where, death, depth):
    """The swap succeeds without a daemon, and one writer is left."""
    now = played(kill_daemon).deaths[death][TOPICS[where]]
    assert (now.last.depth, now.last.refusal, ended(now.last)) == (depth, "", death + 1)
    assert now.writers == [now.last.deadline_ns] != [0]


@every_state
def test_a_plan_with_a_lease_ends_with_its_daemon(played, where):
    """With ``on_lost: baseline`` the publisher returns to its own QoS and to generation 0."""
    now = played(kill_daemon).deserted[TOPICS[where]]
    assert (qos(now.last), now.last.generation) == (BASELINE, 0)
    assert now.writers == [0]


@every_state
def test_a_daemon_started_again_takes_over(played, where):
    """Without a lease the plan stays until the next daemon's, and generations rise until a lease is over."""
    first = played(kill_daemon).deaths[0][TOPICS[where]].last
    announced = played(kill_daemon).announced[TOPICS[where]]
    generations = [state.generation for state in announced]
    while generations[-1] == 0:
        generations.pop()
    assert generations == sorted(generations)
    after = [qos(state) for state in announced[announced.index(first) :] if state.generation == first.generation]
    assert set(after) == {qos(first)}
    assert_planned(played(kill_daemon).now[TOPICS[where]])


@every_state
def test_daemons_that_die_cost_no_sample(played, where):
    """Every published sample arrives once and in order."""
    last = played(kill_daemon).now[TOPICS[where]].last
    assert played(kill_daemon).received[TOPICS[where]] == list(range(played(kill_daemon).sent))
    assert (last.published, last.withheld) == (played(kill_daemon).sent, 0)
