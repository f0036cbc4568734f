"""`arpd run` among real nodes, with a node that hangs and signals at any time."""

import json
import signal
import time

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from scripts.bench.samples import Topic
from scripts.bench.sides import Robot
from tests.all.link.hosts import NEEDS_LINK
from tests.all.link.live_robot import confirmed, is_confirmed, live_robot
from tests.scrape import metrics
from tests.waiting import eventually

pytestmark = NEEDS_LINK
NAMES, HANGS = ("first", "second", "third"), "second"
OWN_DEPTH = 60


class Stage:
    """Three nodes that publish, and a daemon that plans for them."""

    def __init__(self, world, url):
        self.world, self.url, self.daemon = world, url, world.daemons["run"]
        self.config = world.workdir / "arpd.yaml"

    def plan(self, depth):
        """Reload a configuration from which another depth follows."""
        settings = json.loads(self.config.read_text())
        settings["defaults"] |= {"min_depth": depth, "max_depth": depth}
        self.config.write_text(json.dumps(settings))
        self.daemon.send_signal(signal.SIGHUP)

    def have(self, depth, *names):
        """Return whether the nodes, or all of them, have confirmed a depth."""
        now = confirmed(self.world)
        return all(now[f"/{name}"]["depth"] == depth for name in names or NAMES)

    def send(self, number):
        self.world.children[HANGS].process.send_signal(number)


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    """Start everything once; the tests follow each other, and the last one stops the daemon."""
    robot = Robot(
        topics=tuple(Topic(name=f"/{name}", node=name, rate_hz=20.0, size=60, depth=OWN_DEPTH) for name in NAMES),
        settings={
            "governor": {"hold": "1h"},  # no plan but after a reload
            "defaults": {"min_depth": 100, "max_depth": 100, "latency_budget": "none"},
        },
    )
    with live_robot(tmp_path_factory.mktemp("trouble"), robot, nodes="tests.all.chaos.stopping") as (world, url):
        stage = Stage(world, url)
        eventually("the first plan is in force", lambda: is_confirmed(world) and stage.have(100))
        yield stage


def test_a_node_that_hangs_delays_nobodys_plan(stage):
    """While one node is stopped the others take a new plan; when it continues, it follows."""
    stage.send(signal.SIGSTOP)
    try:
        stage.plan(130)
        eventually("the others have the new plan", lambda: stage.have(130, "first", "third"))
    finally:
        stage.send(signal.SIGCONT)
    eventually("the stopped node follows", lambda: stage.have(130))


def test_a_stop_during_a_swap_with_a_node_that_hangs_is_clean(stage):
    """After several stop signals it restores every node that answers, exits 0, and never calls itself stale."""
    generation, told = metrics(stage.url)["arpd_plan_generation"], []
    stage.plan(170)
    eventually("a new plan is made", lambda: metrics(stage.url).get("arpd_plan_generation", 0) > generation)
    stage.send(signal.SIGSTOP)
    try:
        for _ in range(4):
            stage.daemon.send_signal(signal.SIGTERM)
            time.sleep(0.3)
        stale = 'arpd_condition{condition="stale",severity="error",wrong="true"}'
        eventually("it ends", lambda: told.append(metrics(stage.url).get(stale)) or stage.daemon.poll() is not None)
        assert (stage.daemon.returncode, 1.0 in told) == (0, False)
    finally:
        stage.send(signal.SIGCONT)
    for name in ("first", "third"):
        child = stage.world.children[name]
        eventually(
            "it has its own QoS",
            lambda child=child, name=name: child.ask(do="states")[f"/{name}"]["depth"] == OWN_DEPTH,
        )
    log = (stage.world.workdir / "run.log").read_text()
    assert log.count("stopping; ") == 1, "it restores once, however often it is told to stop"
