"""What others on the network say that is not so: real daemon, real publisher, and a process that floods with lies."""

import os
import re
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from tests.chaos.world import Log, World, insist, status, this_host_only

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]
HERE = Path(__file__).parent
TOPIC = "/honest"
BEFORE_S, AFTER_S = 1.5, 3.0
MOST_CORES = 0.5  # more than without the flood; 0.2 were seen, where decoding it all takes a whole one and more
MOST_MB = 150.0  # of growth; 20 to 50 were seen, most of it messages that wait in the middleware
CAPACITY_MBIT = 100.0


def metrics(daemon):
    """Return all series of a scrape by name and labels, none while the daemon does not answer."""
    try:
        with urllib.request.urlopen(f"{daemon.url}/metrics", timeout=5.0) as answer:
            found = re.findall(r"^(arpd_\S+|process_\S+) (\S+)$", answer.read().decode(), re.MULTILINE)
    except OSError:
        return {}
    return {name: float(value) for name, value in found}


class Effort:
    """Ticks between two scrapes, the share of them that came late, and the processor time they took."""

    def __init__(self, daemon):
        self._daemon = daemon
        self._begun = metrics(daemon), time.monotonic()

    def end(self):
        (before, begun_s), after = self._begun, metrics(self._daemon)
        elapsed_s = time.monotonic() - begun_s
        ticks, late, cpu_s = (
            after[name] - before[name]
            for name in ("arpd_ticks_total", "arpd_ticks_late_total", "process_cpu_seconds_total")
        )
        return SimpleNamespace(ticks_hz=ticks / elapsed_s, late=late / ticks, cores=cpu_s / elapsed_s)


@pytest.fixture(scope="module")
def story(tmp_path_factory):
    """Play a daemon at rest, then a flood; a publisher comes during it and is planned for, and the flood goes on."""
    with this_host_only(), World(tmp_path_factory.mktemp("liars")) as world:
        yield play(world)


def play(world):
    environment = {
        **os.environ,
        "PYTHONPATH": str(HERE.parents[1]),
        "ROS_DOMAIN_ID": str(world.node("scout").context.get_domain_id()),
    }
    rogue = subprocess.Popen(
        [sys.executable, HERE / "rogue.py", "/talker", TOPIC], env=environment, stdin=subprocess.PIPE, text=True
    )
    try:
        daemon = world.daemon(link={"interface": "lo", "initial_capacity": f"{CAPACITY_MBIT}mbit"})
        log = Log(world, "far", [TOPIC])
        insist(lambda: metrics(daemon).get("arpd_ticks_total", 0) > 5, "the daemon ticks")
        calm = Effort(daemon)
        time.sleep(BEFORE_S)
        calm, started = calm.end(), metrics(daemon)
        print("go", file=rogue.stdin, flush=True)
        insist(lambda: refusals(daemon) > 500, "the flood arrives")
        flooded = Effort(daemon)
        world.talker(TOPIC)
        insist(lambda: metrics(daemon).get("arpd_publishers_confirmed") == 1, "the honest one is confirmed")
        seen, until_s = [], time.monotonic() + AFTER_S
        while time.monotonic() < until_s:
            seen.append(metrics(daemon))
            time.sleep(0.2)
        insist(lambda: status(daemon).get("topics"), "the daemon tells of a topic")
        told = status(daemon)
        assert rogue.poll() is None
        return SimpleNamespace(
            calm=calm, flooded=flooded.end(), started=started, seen=seen, told=told, log=daemon.log(), heard=log.numbers
        )
    finally:
        rogue.kill()
        rogue.wait()


def refusals(daemon):
    return sum(value for name, value in metrics(daemon).items() if name.startswith("arpd_messages_refused_total"))


def test_an_honest_publisher_is_planned_for_in_a_flood(story):
    """It is found, planned and confirmed while the flood goes on, and stays; its samples go on."""
    # It may miss three announcements by itself where the machine is too busy to run it for as long.
    there = [seen["arpd_publishers_managed"] == seen["arpd_publishers_confirmed"] == 1 for seen in story.seen]
    assert sum(there) >= 0.8 * len(there)
    assert len({seen["arpd_plan_generation"] for seen in story.seen}) == 1
    assert len(story.heard[TOPIC]) > 50


def test_nobody_invented_is_planned_for(story):
    """No publisher, reader, peer or daemon is seen that the graph does not bear out."""
    last = story.seen[-1]
    assert [row["topic"] for row in story.told["topics"]] == [TOPIC]
    assert last["arpd_other_daemons"] == last["arpd_standing_by"] == 0
    assert last["arpd_peer_reports_total"] == 0
    assert last["arpd_plan_generation"] < 10
    assert last["arpd_link_capacity_bytes_per_second"] * 8e-6 <= CAPACITY_MBIT
    assert 0.9 < last["arpd_gate_ratio"] <= 1.0


def test_a_flood_takes_neither_the_ticks_nor_the_memory(story):
    """Ticks go on, at the cost of a part of a core, and the daemon stays as large as its quotas allow."""
    print(f"before {story.calm}, flooded {story.flooded}")
    # Decoding it all takes a whole core and more, and leaves a tick a second. How many come in time depends on what
    # else the machine does, processor time does not.
    assert story.flooded.cores < story.calm.cores + MOST_CORES
    assert story.flooded.ticks_hz > 0.5 * story.calm.ticks_hz
    grown = [
        seen["process_resident_memory_bytes"] - story.started["process_resident_memory_bytes"] for seen in story.seen
    ]
    print(f"grown by {max(grown) * 1e-6:.1f} MB")
    assert max(grown) < MOST_MB * 1e6


def test_every_lie_is_counted_and_few_are_said(story):
    """Each kind of refusal has its count; the log names them once a minute for each source."""
    counts = story.seen[-1]
    for kind, reason in [
        ("publishers", "source"),
        ("publishers", "rate"),
        ("readers", "source"),
        ("reports", "unanswered"),
        ("reports", "size"),
        ("reports", "malformed"),
        ("claims", "size"),
    ]:
        assert counts[f'arpd_messages_refused_total{{kind="{kind}",reason="{reason}"}}'] > 0, (kind, reason)
    assert counts["arpd_endpoints_pending"] > 0
    assert 3 <= story.log.count("said once a minute") <= 60
    assert "Traceback" not in story.log
