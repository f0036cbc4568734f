"""A real daemon and publisher beside a process that floods the network with false messages."""

import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from tests.all.chaos.world import DOMAIN, Log, World, status, this_host_only
from tests.scrape import metrics
from tests.waiting import eventually

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]
HERE = Path(__file__).parent
TOPIC = "/honest"
AFTER_S = 3.0
ENOUGH = 50
CAPACITY_MBIT = 100.0


def scraped(daemon):
    """Return the series of a scrape that succeeds."""
    return eventually("the daemon answers a scrape", lambda: metrics(daemon.url))


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    """Run a daemon, then a flood, and during the flood a publisher that gets a plan."""
    with this_host_only(), World(tmp_path_factory.mktemp("liars")) as world:
        yield play(world)


def play(world):
    environment = {
        **os.environ,
        "PYTHONPATH": str(HERE.parents[2]),
        "ROS_DOMAIN_ID": str(DOMAIN),
    }
    rogue = subprocess.Popen(
        [sys.executable, HERE / "rogue.py", TOPIC], env=environment, stdin=subprocess.PIPE, text=True
    )
    try:
        daemon = world.daemon(link={"interface": "lo", "initial_capacity": f"{CAPACITY_MBIT}mbit"})
        log = Log(world, "far", [TOPIC])
        eventually("the daemon ticks", lambda: metrics(daemon.url).get("arpd_ticks_total", 0) > 5)
        print("go", file=rogue.stdin, flush=True)
        eventually("the flood arrives", lambda: refusals(daemon) > 500)
        world.talker(TOPIC)
        eventually("the honest one is confirmed", lambda: metrics(daemon.url).get("arpd_publishers_confirmed") == 1)
        seen, until_s = [], time.monotonic() + AFTER_S
        while time.monotonic() < until_s:
            seen.append(scraped(daemon))
            time.sleep(0.2)
        eventually("the status has a topic", lambda: status(daemon).get("topics"))
        last_status = status(daemon)
        eventually("the honest samples arrive", lambda: len(log.numbers[TOPIC]) > ENOUGH)
        assert rogue.poll() is None
        return SimpleNamespace(
            seen=seen,
            status=last_status,
            log=daemon.log(),
        )
    finally:
        rogue.kill()
        rogue.wait()


def refusals(daemon):
    return sum(value for name, value in metrics(daemon.url).items() if name.startswith("arpd_messages_refused_total"))


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
