"""Kill -9 of who takes part in a writer swap, and readers that join, in every state of it."""

import time
from contextlib import ExitStack
from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from scripts.bench.nodes import BASE_SINK
from scripts.bench.samples import Topic
from scripts.bench.sides import SIDES, Robot
from scripts.bench.world import world_of
from tests.all.chaos.stopping import TOPICS, WHERE
from tests.all.link.hosts import NEEDS_LINK
from tests.waiting import eventually

pytestmark = [*NEEDS_LINK, pytest.mark.timeout(300)]

DEPTH = 1000  # of the application
SWAPPED = {"depth": 900, "deadline_ns": 800_000_000}
RATE = 20e6 / 8
ROBOT = Robot(
    topics=tuple(Topic(name=name, node="talker", rate_hz=20.0, size=60, is_kept=True) for name in TOPICS.values()),
    settings={"governor": {"hold": "1h"}},  # one plan only: the test's jitter must not cause another
)
every_state = pytest.mark.parametrize("where", WHERE)


class Stage:
    """A talker on the robot that publishes, and what reads it on the base computer."""

    def __init__(self, world, stack):
        self.world, self._stack = world, stack
        assert world.start(stack) == []
        self.talker, self.there = world.children["talker"], world.children[BASE_SINK]
        self.publish()

    def publish(self, *, for_s=3600.0):
        """Let the talker publish from now on."""
        now_s = time.monotonic()
        self.talker.ask(do="begin", begin_s=now_s, from_s=now_s, until_s=now_s + for_s)

    def start(self, host, name):
        """Start one more process of the robot's."""
        child = self.world.child(self._stack, host, str(self.world.workdir / "world.json"), name)
        child.receive()
        return child

    def reader(self):
        return self.start("base", BASE_SINK)

    def states(self):
        return self.talker.ask(do="states")

    def when(self, what, holds):
        """Wait until something holds of the state of every publisher; return the states."""
        return eventually(what, lambda: states if all(map(holds, (states := self.states()).values())) else None)

    def stopped(self):
        return self.when("every swap is stopped", lambda state: not state["will_stop"])

    def go_on(self):
        self.talker.ask(do="release")
        self.when("every swap has ended", lambda state: state["ended"] and state["writers"] == 1)

    def sent(self):
        """Return the numbers of the samples that the talker gave its publishers."""
        sources = self.talker.ask(do="report")["sources"].values()
        return {
            name: [number for number, _ in source["sent"]]
            for name, source in zip(TOPICS.values(), sources, strict=True)
        }

    def settle(self, *readers):
        """Stop publishing; return the last states, the numbers of the samples, and those that each reader has."""
        self.publish(for_s=0.0)
        states, sent = self.when("the queues are empty", lambda state: not state["queued"]), self.sent()
        for reader in (self.there, *readers):
            eventually(
                "every reader has the last sample",
                lambda reader=reader: all(rows[-1:] == sent[name][-1:] for name, rows in numbers(reader).items()),
            )
        return SimpleNamespace(states=states, sent=sent, there=numbers(self.there), read=[*map(numbers, readers)])


def numbers(reader):
    """Return the numbers that have arrived on each topic, in order."""
    return {name: [row[1] for row in rows] for name, rows in reader.ask(do="report")["arrivals"].items()}


def has_some(reader):
    return all(len(rows) > 10 for rows in numbers(reader).values())


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """Return a function that plays a scenario once for all states, and returns its outcome."""
    outcomes = {}

    def play(scenario, *, is_governed=False):
        if scenario not in outcomes:
            outcomes[scenario] = None
            side, logs = replace(SIDES["adaptive"], is_governed=is_governed), tmp_path_factory.mktemp(scenario.__name__)
            nodes = "tests.all.chaos.stopping"
            with world_of(ROBOT, side, rate=RATE, logs=logs, nodes=nodes) as world, ExitStack() as stack:
                outcomes[scenario] = scenario(Stage(world, stack))
        assert outcomes[scenario], "it broke when it was played"
        return outcomes[scenario]

    return play


def kill_reader(stage):
    """Kill a reader while the publisher swaps, and start it again; another one stays."""
    victim = stage.reader()
    eventually("the victim receives", lambda: has_some(victim))
    stage.talker.ask(do="swap", **SWAPPED)
    stage.stopped()
    victim.process.kill()
    stage.go_on()
    again = stage.reader()
    eventually("it receives again", lambda: has_some(again))
    return stage.settle(again)


def assert_swapped(state, sent):
    """Assert that the swap has ended, perhaps undone, with nothing lost on the way."""
    depth, deadline_ns = SWAPPED.values()
    assert (state["depth"], state["deadline_ns"]) == ((DEPTH, 0) if state["refusal"] else (depth, deadline_ns))
    assert (state["ended"], state["writers"]) == (1, 1)
    assert (state["published"], state["withheld"]) == (len(sent), 0)


def is_gapless(read, sent):
    """Return whether a reader has all that was sent from its first sample on, each once and in order."""
    return bool(read) and read == sent[sent.index(read[0]) :]


@every_state
def test_a_killed_reader_costs_the_other_one_nothing(played, where):
    """The swap ends with one writer; the survivor has every sample, the restarted reader all from its first one on."""
    topic, outcome = TOPICS[where], played(kill_reader)
    assert_swapped(outcome.states[topic], outcome.sent[topic])
    assert outcome.there[topic] == outcome.sent[topic]
    assert is_gapless(outcome.read[0][topic], outcome.sent[topic])


def join(stage):
    """One reader joins while every swap is stopped, another one as they go on."""
    stage.talker.ask(do="swap", **SWAPPED)
    stage.stopped()
    early = stage.reader()
    before = stage.when("the early reader matches", lambda state: state["readers"] == 2)
    late = stage.reader()
    stage.go_on()
    matched = (before, stage.when("the late reader matches", lambda state: state["readers"] == 3))
    eventually("it receives", lambda: has_some(late))
    return SimpleNamespace(**vars(stage.settle(early, late)), matched=matched)


@every_state
def test_who_joins_during_a_swap_gets_everything_from_then_on(played, where):
    """A joining reader has every sample since it matched; the swap ends, and the first reader loses nothing."""
    topic, outcome = TOPICS[where], played(join)
    assert_swapped(outcome.states[topic], outcome.sent[topic])
    assert outcome.there[topic] == outcome.sent[topic]
    for read, matched in zip(outcome.read, outcome.matched, strict=True):
        assert is_gapless(read[topic], outcome.sent[topic])
        assert read[topic][0] <= matched[topic]["number"] + 1


def kill_node(stage):
    """Kill the publishers' node during the swap to the daemon's plan, and start it again."""
    stage.stopped()
    stage.publish(for_s=0.0)

    def rests():
        earlier, _ = stage.states(), time.sleep(0.5)
        return earlier == stage.states() and earlier

    before, given = eventually("all that flows has left", rests), stage.sent()
    stage.talker.process.kill()
    first = numbers(stage.there)
    stage.talker = stage.start("robot", "talker")
    stage.talker.ask(do="release")
    stage.when("the reader matches", lambda state: state["readers"])
    stage.publish()
    stage.when("the plan is in force", lambda state: state["deadline_ns"] and state["ended"] and state["writers"] == 1)
    eventually("it receives again", lambda: has_some(stage.there))
    return SimpleNamespace(**vars(stage.settle()), before=before, given=given, first=first)


@every_state
def test_a_node_started_again_gets_the_plan_back(played, where):
    """What its first life published has arrived, and its second life loses nothing through the swap to the plan."""
    topic, outcome = TOPICS[where], played(kill_node, is_governed=True)
    before, state = outcome.before[topic], outcome.states[topic]
    assert (before["published"] + before["queued"], before["withheld"]) == (len(outcome.given[topic]), 0)
    assert outcome.first[topic] == outcome.given[topic][: before["published"]]
    assert outcome.there[topic] == outcome.first[topic] + outcome.sent[topic]
    assert (state["refusal"], state["deadline_ns"] > 0) == ("", True)
    assert (state["published"], state["withheld"]) == (len(outcome.sent[topic]), 0)
