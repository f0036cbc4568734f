"""`arpd run` among real nodes, with a node that hangs and signals at any time."""

from __future__ import annotations

import json
import signal
import time

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from tests.all.chaos.nodes import BASELINE_DEPTH
from tests.all.chaos.world import World, this_host_only
from tests.scrape import metrics
from tests.waiting import PATIENCE_S, eventually

pytestmark = pytest.mark.ros
TOPICS = {name: f"/{name}" for name in ("first", "second", "third")}
HANGS = "second"


class Stage:
    """Three nodes that publish across the assumed link, and a daemon that plans for them."""

    def __init__(self, world):
        self.world = world
        world.start("listener", "listener", *TOPICS.values())
        self.talkers = {}
        for name, topic in TOPICS.items():
            self.talkers[name] = world.start("talker", name, topic)
        for talker in self.talkers.values():
            eventually("the reader matches", lambda talker=talker: all(talker.tell("matched").values()))
            talker.tell("publish", is_on=True, number=0)
        self.daemon = world.daemon(depth=100)
        self.process = self.daemon._popen
        eventually("the first plan is in force", lambda: self.shows(100))

    def reload(self, *, depth):
        settings = json.loads(self.daemon.config.read_text())
        settings["defaults"] |= {"min_depth": depth, "max_depth": depth}
        self.daemon.config.write_text(json.dumps(settings))
        self.process.send_signal(signal.SIGHUP)

    def shows(self, depth, *names):
        return all(self.world.shows(TOPICS[name], depth=depth) for name in names or TOPICS)

    def send(self, name, number):
        self.talkers[name]._popen.send_signal(number)

    def generation(self):
        return metrics(self.daemon.url).get("arpd_plan_generation", 0)


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    """Start everything once; the tests follow each other, and the last one stops the daemon."""
    with this_host_only(), World(tmp_path_factory.mktemp("failures")) as world:
        yield Stage(world)


def test_a_node_that_hangs_delays_nobodys_plan(stage):
    """While one node is stopped the others take a new plan; when it continues, it follows."""
    stage.send(HANGS, signal.SIGSTOP)
    try:
        stage.reload(depth=130)
        eventually(
            "the others have the new plan", lambda: stage.shows(130, *(name for name in TOPICS if name != HANGS))
        )
        assert stage.shows(100, HANGS)
    finally:
        stage.send(HANGS, signal.SIGCONT)
    eventually("the stopped node follows", lambda: stage.shows(130))


def test_a_stop_during_a_swap_with_a_node_that_hangs_is_clean(stage):
    """After several stop signals it restores every node that answers, and exits 0."""
    generation = stage.generation()
    stage.reload(depth=170)
    eventually("a new plan is asked for", lambda: stage.generation() > generation)
    stage.send(HANGS, signal.SIGSTOP)
    try:
        stage.process.terminate()
        for _ in range(3):
            time.sleep(0.3)
            stage.process.send_signal(signal.SIGTERM)
        assert stage.process.wait(timeout=PATIENCE_S) == 0
    finally:
        stage.send(HANGS, signal.SIGCONT)
    others = [name for name in TOPICS if name != HANGS]
    eventually("the others have their own QoS", lambda: stage.shows(BASELINE_DEPTH, *others))
    assert stage.daemon.log().count("stopping; ") == 1, "it restores once, however often it is told to stop"
