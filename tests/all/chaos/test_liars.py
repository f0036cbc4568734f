"""A real daemon and publisher beside a process that floods the network with false messages."""

import sys
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
from scripts.robot.proxy import HTTP_PORT, window
from tests.all.link.hosts import NEEDS_LINK, REPO
from tests.scrape import metrics
from tests.waiting import eventually

pytestmark = [*NEEDS_LINK, pytest.mark.timeout(120)]
TOPIC = "/honest"
AFTER_S = 3.0
ENOUGH = 50
CAPACITY_MBIT = 100.0


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    """Run a daemon without a peer, then a flood, and during the flood a publisher that gets a plan."""
    robot = Robot(
        topics=(Topic(name=TOPIC, node="honest", rate_hz=20.0, size=60),),
        settings={"link": {"initial_capacity": f"{CAPACITY_MBIT}mbit"}},
    )
    side = replace(SIDES["adaptive"], is_governed=False)
    with (
        world_of(robot, side, rate=20e6 / 8, logs=tmp_path_factory.mktemp("liars")) as world,
        window(world.link.robot, HTTP_PORT) as url,
        ExitStack() as stack,
    ):
        world.configure()
        world.start_daemon("run")
        eventually("the daemon ticks", lambda: metrics(url).get("arpd_ticks_total", 0) > 5)
        argv = [sys.executable, "-m", "tests.all.chaos.rogue", TOPIC]
        rogue = world.link.popen("robot", argv, cwd=REPO)
        refused = "arpd_messages_refused_total"
        eventually("the flood arrives", lambda: sum(n for k, n in metrics(url).items() if k.startswith(refused)) > 500)
        assert world.start(stack) == []
        world.begin(3600.0)
        eventually("the honest one is confirmed", lambda: metrics(url).get("arpd_publishers_confirmed") == 1)
        seen, until_s = [], time.monotonic() + AFTER_S
        while time.monotonic() < until_s:
            seen.append(eventually("the daemon answers a scrape", lambda: metrics(url)))
            time.sleep(0.2)
        status = eventually("the daemon answers", world.status)
        sink = world.children[BASE_SINK]
        eventually("the honest samples arrive", lambda: len(sink.ask(do="report")["arrivals"][TOPIC]) > ENOUGH)
        assert rogue.poll() is None
        yield SimpleNamespace(seen=seen, status=status, log=(world.workdir / "run.log").read_text())


def test_an_honest_publisher_is_planned_for_in_a_flood(outcome):
    """During the flood it gets a plan, confirms it and keeps it."""
    # On a busy machine it may miss three announcements by itself.
    there = [seen["arpd_publishers_managed"] == seen["arpd_publishers_confirmed"] == 1 for seen in outcome.seen]
    assert sum(there) >= 0.8 * len(there)
    assert len({seen["arpd_plan_generation"] for seen in outcome.seen}) == 1


def test_nothing_invented_is_planned_for(outcome):
    """No publisher, peer or daemon counts that the graph does not show."""
    last = outcome.seen[-1]
    assert [row["topic"] for row in outcome.status["topics"]] == [TOPIC]
    assert last["arpd_standing_by"] == 0
    assert last["arpd_peer_reports_total"] == 0
    assert last["arpd_plan_generation"] < 10
    assert last["arpd_link_capacity_bytes_per_second"] * 8e-6 <= CAPACITY_MBIT
    assert 0.9 < last["arpd_allowed_ratio"] <= 1.0


def test_every_refusal_is_counted_and_few_are_logged(outcome):
    """Each kind of refusal is counted; the log names each source once a minute."""
    counts = outcome.seen[-1]
    for kind, reason in [
        ("publishers", "rate"),
        ("publishers", "size"),
        ("publishers", "malformed"),
        ("publishers", "quota"),
        ("reports", "unanswered"),
        ("reports", "size"),
        ("reports", "malformed"),
        ("prices", "malformed"),
        ("prices", "size"),
    ]:
        assert counts[f'arpd_messages_refused_total{{kind="{kind}",reason="{reason}"}}'] > 0, (kind, reason)
    assert counts["arpd_endpoints_pending"] > 0
    assert 3 <= outcome.log.count("logged once a minute") <= 60
    assert "Traceback" not in outcome.log
